"""Which part of photographs is valid: within a border of one pure colour, or by a mask."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.errors import CameraProtocolError, DataError
from camctl.findings import Finding, Place
from camctl.interface.camera import Pixels
from camctl.photographs.files import PhotographFiles
from camctl.stills.separate import read_apart
from camctl.system.input_files import read_input

#: Largest file of a mask that is read.
_MOST_BYTES = 1 << 28
#: Rows and columns among which the largest rectangle is searched, by a loop over all places.
_MOST_LINES = 1024
#: Pixels of one pure colour along a border, as share of its length, that make it an invalid one.
_BORDER_SHARE = 0.05


@dataclass(frozen=True, eq=False)
class ValidArea:
    """The part of photographs that is valid.

    Attributes:
        rows: that hold it
        columns: likewise
        invalid: which pixels of these are not valid; None: all are
        nearest: row and column of the valid pixel of the same colour next to each invalid one
        facts: a finding of the pixels that the mask excludes, if any
    """

    rows: slice
    columns: slice
    invalid: NDArray[np.bool_] | None
    nearest: tuple[NDArray[np.intp], NDArray[np.intp]] | None
    facts: tuple[Finding, ...]

    @classmethod
    def of(cls, files: PhotographFiles, mask: str | None) -> ValidArea:
        """Return the valid part of photographs.

        Args:
            files: of them
            mask: file of a picture that is black where they are not valid; None: a border of one
                pure colour is not

        Raises:
            DataError: the mask cannot be read, does not fit, or leaves nothing
        """
        shape = files.format.shape[:2]
        step = 2 if files.format.layout.is_mosaic else 1  # colours of the pattern stay in place
        inner = files.shown_by_all
        if mask is not None:
            masked = _read_mask(mask, shape)
            masked |= _outside(inner, shape)
            return cls._of_mask(masked, step)
        invalid, by = np.zeros(shape, np.bool_), "border"
        for position in range(len(files.photographs)):
            transparent = files.invalid(position)
            if transparent is not None:
                invalid |= transparent
                by = "alpha"
            elif (border := invalid_border(files.pixels(position))) is not None:
                invalid |= border
        if not invalid[inner].any():
            rows, columns = (_from_even(each, step) for each in inner)
            return cls(rows, columns, None, None, ())
        invalid |= _outside(inner, shape)
        rows, columns = (_from_even(each, step) for each in _largest_inside(~invalid))
        fact = _masked(invalid, rows, columns, by=by)
        return cls(rows, columns, None, None, (fact,))

    @classmethod
    def _of_mask(cls, invalid: NDArray[np.bool_], step: int) -> ValidArea:
        used = [np.flatnonzero(~invalid.all(axis=axis)) for axis in (1, 0)]
        rows, columns = (_from_even(slice(each[0], each[-1] + 1), -step) for each in used)
        inner = invalid[rows, columns]
        facts = (_masked(invalid, rows, columns, by="mask"),) if invalid.any() else ()
        if not inner.any():
            return cls(rows, columns, None, None, facts)
        return cls(rows, columns, inner, _nearest(inner, step), facts)

    def seen(self, pixels: Pixels) -> Pixels:
        """Return the valid part, invalid pixels with the samples of the nearest valid ones.

        Black ones would look like a part of the scene.
        """
        cut = self._cut(pixels)
        if self.invalid is not None and self.nearest is not None:
            cut[self.invalid] = cut[self.nearest]
        return cut

    def shown(self, pixels: Pixels, black: int) -> Pixels:
        """Return the valid part, invalid pixels without light."""
        cut = self._cut(pixels)
        if self.invalid is not None:
            cut[self.invalid] = black
        return cut

    def _cut(self, pixels: Pixels) -> Pixels:
        """Return the rectangle, in memory of its own if pixels of it are not valid."""
        part = pixels[self.rows, self.columns]
        cut: NDArray[Any] = np.ascontiguousarray(part) if self.invalid is None else part.copy()
        return cut


def _largest_inside(valid: NDArray[np.bool_]) -> tuple[slice, slice]:
    """Return (rows, columns) of about the largest rectangle in which all is valid."""
    step = max(1, round(max(valid.shape) / _MOST_LINES))
    rows, columns = (length // step for length in valid.shape)
    whole = valid[: rows * step, : columns * step].reshape(rows, step, columns, step)
    found = largest_rectangle(np.asarray(whole.all(axis=(1, 3))))
    return slice(found[0].start * step, found[0].stop * step), slice(
        found[1].start * step, found[1].stop * step
    )


def _outside(inner: tuple[slice, slice], shape: Sequence[int]) -> NDArray[np.bool_]:
    found = np.ones(tuple(shape), np.bool_)
    found[inner] = False
    return found


def _from_even(lines: slice, step: int) -> slice:
    """Return lines from a multiple of a step on: the next one, or the one before if negative."""
    start = -(-lines.start // step) * step if step > 0 else lines.start // -step * -step
    return slice(start, lines.stop)


def _masked(invalid: NDArray[np.bool_], rows: slice, columns: slice, by: str) -> Finding:
    """Return which part is used, and which share of its pixels is left out."""
    part = invalid[rows, columns]
    place = None
    if part.size < invalid.size:
        place = Place(top=rows.start, left=columns.start, bottom=rows.stop, right=columns.stop)
    return Finding(code="masked", value=float(part.mean()), place=place, details={"by": by})


def _nearest(invalid: NDArray[np.bool_], step: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return row and column of a valid pixel of the same colour near each invalid one.

    Blocks of `step` x `step` pixels count as invalid if one of their pixels is.
    """
    import cv2

    rows, columns = (-(-length // step) for length in invalid.shape)
    padded = np.ones((rows * step, columns * step), np.bool_)
    padded[: invalid.shape[0], : invalid.shape[1]] = invalid
    blocks = padded.reshape(rows, step, columns, step).any(axis=(1, 3))
    if blocks.all():
        raise DataError(
            "the mask leaves no whole block of the colour pattern",
            hint="give another mask",
            remedies={"mask": None},
        )
    zeros = np.asarray(blocks, np.uint8)
    _, labels = cv2.distanceTransformWithLabels(
        zeros, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    valid = np.argwhere(~blocks)
    places = np.zeros((int(labels.max()) + 1, 2), np.intp)
    places[labels[~blocks]] = valid
    row, column = np.nonzero(invalid)
    near = places[labels[row // step, column // step]] * step
    return near[:, 0] + row % step, near[:, 1] + column % step


def invalid_border(pixels: Pixels) -> NDArray[np.bool_] | None:
    """Return which pixels lie in a border of one pure colour, as programs that align leave it.

    None where there is no border.  A pure colour has samples of 0 and of the largest code only, and
    is not black or white.
    """
    import cv2

    if pixels.ndim == 2:
        return None
    edges = (pixels[:1], pixels[-1:], pixels[:, :1], pixels[:, -1:])
    if max(float(np.mean(_is_pure(edge))) for edge in edges) < _BORDER_SHARE:
        return None
    pure = _is_pure(pixels)
    _, labels = cv2.connectedComponents(pure.astype(np.uint8), connectivity=8)
    touching = np.unique(np.concatenate((labels[0], labels[-1], labels[:, 0], labels[:, -1])))
    return np.isin(labels, touching[touching > 0])


def _is_pure(pixels: Pixels) -> NDArray[np.bool_]:
    """Return which pixels, (rows, columns, 3), have a pure colour."""
    is_top, is_zero = pixels == np.iinfo(pixels.dtype).max, pixels == 0
    return np.asarray((is_top | is_zero).all(axis=2) & is_top.any(axis=2) & is_zero.any(axis=2))


def largest_rectangle(valid: NDArray[np.bool_]) -> tuple[slice, slice]:
    """Return (rows, columns) of the largest rectangle in which all is valid.

    Raises:
        DataError: nothing is valid
    """
    heights = np.zeros(valid.shape[1], np.intp)
    best, found = 0, (slice(0, 0), slice(0, 0))
    for row in range(valid.shape[0]):
        heights = np.where(valid[row], heights + 1, 0)
        stack: list[tuple[int, int]] = []  # start column and height, ascending
        for column, height in enumerate((*heights.tolist(), 0)):
            start = column
            while stack and stack[-1][1] >= height:
                start, high = stack.pop()
                if high * (column - start) > best:
                    best = high * (column - start)
                    found = (slice(row + 1 - high, row + 1), slice(start, column))
            stack.append((start, height))
    if not best:
        raise DataError(
            "no pixel is valid in all photographs",
            hint="give a mask of what is valid",
            remedies={"mask": None},
        )
    return found


def _read_mask(path: str, shape: Sequence[int]) -> NDArray[np.bool_]:
    """Return which pixels a mask leaves out."""
    try:
        pixels = read_apart(read_input(path, "mask", most_bytes=_MOST_BYTES), path).pixels
    except CameraProtocolError as error:
        raise DataError(
            error.what.replace("the camera's file", "mask", 1), hint="give a PNG file"
        ) from error
    if pixels.shape[:2] != tuple(shape):
        raise DataError(
            f"mask {path} has {pixels.shape[1]} x {pixels.shape[0]} pixels, and the photographs "
            f"have {shape[1]} x {shape[0]}",
            hint="give a mask of their size",
        )
    black = pixels == 0 if pixels.ndim == 2 else (pixels == 0).all(axis=2)
    if black.all():
        raise DataError(f"mask {path} is black everywhere", hint="white is what is valid")
    return np.asarray(black, np.bool_)
