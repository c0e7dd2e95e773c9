"""What JPEG files lose, found in their own pixels, beside what they really lose.

    python tests/bench/bench_jpeg_loss.py PHOTOGRAPH...

Each photograph is made smaller, to half a million pixels, so that nothing of its own file is left,
and kept as a JPEG file again.  Printed are standard deviations, levels: of the differences of
colours that 4:2:0 loses, and of the brightness that two files with noise of their own lose alike.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from camctl.evidence.chroma import NOISE_OF_Y, brightness, chroma_variance
from camctl.evidence.lost_detail import LEVELS, frequencies, lost_details, quantisation
from camctl.evidence.patches import SIDE

Picture = NDArray[np.uint8]

_PIXELS, _NOISE, _CELL = 5e5, 2.0, 2
#: Blur of a picture that a camera interpolated from a mosaic, pixels.
_BLURS = (0.0, 0.7, 1.0)


def photograph(path: Path, blur: float) -> NDArray[np.float32]:
    """Return a small photograph, red first."""
    read = cv2.imread(str(path), cv2.IMREAD_COLOR)
    assert read is not None, path
    factor = max(2, round(math.sqrt(read.shape[0] * read.shape[1] / _PIXELS)))
    size = [length // factor // SIDE * SIDE for length in read.shape[1::-1]]
    small = cv2.resize(read.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    soft = cv2.GaussianBlur(small, (0, 0), blur) if blur else small
    return np.asarray(soft[..., ::-1], np.float32)


def kept(pixels: NDArray[Any], quality: int) -> Picture:
    """Return a picture as a file keeps it."""
    whole = np.clip(np.rint(pixels), 0, LEVELS - 1).astype(np.uint8)
    data = cv2.imencode(".jpg", whole[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)[..., ::-1]


def blocks_of(plane: NDArray[Any], side: int) -> NDArray[Any]:
    """Return (rows / side, columns / side, side, side)."""
    rows, columns = (length // side for length in plane.shape)
    return plane.reshape(rows, side, columns, side).swapaxes(1, 2)


def colours(pixels: NDArray[np.float32]) -> str:
    """Return the real and the found loss of red and of blue."""
    file = kept(pixels, 100)
    error = file - np.rint(pixels)
    inside = blocks_of(np.all((file > 2) & (file < 250), axis=2), _CELL).all(axis=(2, 3))
    cells = [
        np.stack([file[k::2, m::2, colour] for k in (0, 1) for m in (0, 1)]) for colour in range(3)
    ]
    found = chroma_variance(cells)
    shown = []
    for colour in (0, 2):
        real = np.square(blocks_of(error[..., colour], _CELL)).mean(axis=(2, 3))[inside].mean()
        shown.append(f"{math.sqrt(real):.2f} / {math.sqrt(found[colour][inside].mean()):.2f}")
    return " | ".join(shown)


def detail(pixels: NDArray[np.float32], quality: int) -> str:
    """Return the real and the found loss of brightness that files have in common."""
    files = [
        kept(pixels + np.random.default_rng(seed).normal(0, _NOISE, pixels.shape), quality)
        for seed in (1, 2)
    ]
    truth = brightness(np.moveaxis(pixels, 2, 0))
    errors = [blocks_of(brightness(np.moveaxis(each, 2, 0)) - truth, SIDE) for each in files]
    inside = blocks_of(np.all((pixels > 12) & (pixels < 245), axis=2), SIDE).all(axis=(2, 3))
    real = max(0.0, float((errors[0] * errors[1]).mean(axis=(2, 3))[inside].mean()))
    Y = brightness(np.moveaxis(files[0], 2, 0))
    blocks = blocks_of(Y, SIDE).reshape(-1, SIDE, SIDE)
    steps = quantisation([frequencies(blocks[inside.ravel()])])
    found = 0.0
    if steps is not None:
        (lost,) = lost_details([blocks], steps, [np.full(LEVELS, NOISE_OF_Y * _NOISE)])
        found = lost.of_picture(Y, Y)[inside].mean()
    return f"{math.sqrt(real):.2f} / {math.sqrt(found):.2f}"


def main() -> None:
    """Print a row for each photograph and sharpness."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("photographs", nargs="+", type=Path)
    given = parser.parse_args()
    print("real / found | blur | red | blue | quality 75 | 90 | 95")
    print("|---" * 7 + "|")
    for path in given.photographs:
        for blur in _BLURS:
            pixels = photograph(path, blur)
            lost = " | ".join(detail(pixels, quality) for quality in (75, 90, 95))
            print(f"| {path.stem} | {blur} | {colours(pixels)} | {lost} |", flush=True)


if __name__ == "__main__":
    main()
