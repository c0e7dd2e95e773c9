"""Small pictures and histograms of frames and results, by numpy alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.errors import DataError
from camctl.interface.camera import Frame
from camctl.interface.controls import Layout
from camctl.menu.data import Picture
from camctl.system.picture_operations import png_pixels

COLUMNS, ROWS = 240, 180
"""Size of a small picture at most, pixels."""

_FOCUSED = 256
"""Side of the middle of a picture in which the focus is judged, pixels: its gradient takes 1 ms."""

BINS = 64
"""Bins of a histogram of a frame."""


def frame_histogram(frame: Frame, layout: Layout) -> tuple[float, ...]:
    """Return the shares of the samples in `BINS` equal steps from black to white."""
    step = _step(frame.pixels.shape)
    counts = np.zeros(BINS)
    for plane in layout.planes(frame.pixels):
        above = plane[::step, ::step].astype(np.int64) - frame.black
        bins = np.clip(above * BINS // (frame.white - frame.black + 1), 0, BINS - 1)
        counts += np.bincount(bins.ravel(), minlength=BINS)
    return tuple((counts / counts.sum()).tolist())


def focus_value(plane: NDArray[Any]) -> float:
    """Return how sharp the middle of a picture of one channel is: larger is sharper.

    It is the Tenengrad (see `gradient`), over the square of the mean, so that it does not follow
    the light.
    """
    rows, columns = plane.shape
    top, left = max(0, (rows - _FOCUSED) // 2), max(0, (columns - _FOCUSED) // 2)
    middle = plane[top : top + _FOCUSED, left : left + _FOCUSED].astype(np.float32)
    level = float(middle.mean())
    return float(np.mean(np.square(gradient(middle)))) / level**2 if level > 0 else 0.0


def gradient(luma: NDArray[Any]) -> NDArray[np.float32]:
    """Return the length of the gradient of each pixel by the Sobel operator.

    Its mean square is the Tenengrad: Pertuz, Puig and Garcia (2013), "Analysis of focus measure
    operators for shape-from-focus", Pattern Recognition 46(5), 1415-1432.  It says which of two
    pictures of one thing is sharper.
    """
    padded = np.pad(luma, 1, mode="edge")
    rows = padded[:-2] + 2 * padded[1:-1] + padded[2:]
    columns = padded[:, :-2] + 2 * padded[:, 1:-1] + padded[:, 2:]
    across, down = rows[:, 2:] - rows[:, :-2], columns[2:] - columns[:-2]
    return np.asarray(np.hypot(across, down), np.float32)


def frame_picture(frame: Frame, layout: Layout) -> Picture:
    """Return a frame as a small picture for a display."""
    planes = layout.planes(frame.pixels)
    step = _step(planes[0].shape)
    # Without contiguous copies first, the arithmetic would run over the whole frame.
    small = [plane[::step, ::step].astype(np.float32) for plane in planes]
    if layout is Layout.MONO:
        colours = [small[0]] * 3
    elif layout is Layout.RGB:
        colours = small
    else:
        from camctl.pictures.mosaic import colour_of

        places = [(row, column) for row in (0, 1) for column in (0, 1)]
        owners = [colour_of(layout, *place) for place in places]
        colours = [
            np.mean([each for each, owner in zip(small, owners, strict=True) if owner == colour], 0)
            for colour in range(3)
        ]
    light = (np.stack(colours, axis=-1) - frame.black) / (frame.white - frame.black)
    shown = np.clip(light, 0.0, 1.0) ** (1 / 2.2)
    return _picture((255 * shown + 0.5).astype(np.uint8))


def preview_picture(folder: Path) -> Picture:
    """Return the preview of a capture, which is tone-mapped for a display, as a small picture.

    Raises:
        DataError: the file is missing or damaged
    """
    from camctl.pictures.files import PREVIEW, read_preview  # loaded: there is a report

    data = read_preview(folder)
    try:
        preview = png_pixels(data)
    except DataError as error:
        raise DataError(f"cannot read {folder / PREVIEW}: {error}") from error
    step = _step(preview.shape)
    rows, columns = preview.shape[0] // step, preview.shape[1] // step
    blocks = preview[: rows * step, : columns * step].reshape(rows, step, columns, step, -1)
    small = np.rint(blocks.mean(axis=(1, 3))).astype(np.uint8)
    return _picture(np.broadcast_to(small, (rows, columns, 3)))


def sampled_picture(pixels: NDArray[np.uint8], most: int) -> Picture:
    """Return a picture with `most` pixels a side at most, of single pixels with all their noise.

    Args:
        pixels: (rows, columns), or the same with 1 or 3 channels
        most: its longest side
    """
    step = max(1, -(-max(pixels.shape[:2]) // most))
    small = pixels[::step, ::step]
    small = small[..., np.newaxis] if small.ndim == 2 else small
    return _picture(np.broadcast_to(small, (*small.shape[:2], 3)))


def _step(shape: tuple[int, ...]) -> int:
    return max(1, -(-shape[0] // ROWS), -(-shape[1] // COLUMNS))


def _picture(rgb: NDArray[Any]) -> Picture:
    return Picture(rgb.shape[1], rgb.shape[0], np.ascontiguousarray(rgb).tobytes())
