"""Checks on the pixels of photographs: size, duplicates, alignment, labels, and invalid borders."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.camera import Pixels
from camctl.captures.exposure_check import NeighbourCheck, lamp_factor
from camctl.captures.photographs import Photograph
from camctl.errors import DataError
from camctl.exposure.patches import Patches
from camctl.picture_operations import reduced_by_area, required_opencv

#: Longest side of the grey copies in which alignment is measured, pixels.
_SIDE = 1024
#: Tiles on each side of a picture, of which each has a shift of its own.
_TILES = 3
#: A shift counts from so many pixels of the grey copy, where its correlation is at least this much
#: and above that without a shift by this share.
_SHIFTED, _SURE, _BETTER = 1.0, 0.25, 1.15
#: Tiles with a sure result that are needed, and the share of them that must be shifted.
_LEAST_TILES, _SHIFTED_SHARE = 2, 0.4
#: No shift, as columns and rows.
_ALIGNED = (0.0, 0.0)
#: Brightness that is compared, as shares of full scale.
_DARKEST, _BRIGHTEST = 0.04, 0.96
#: A median brightness lower by this share of full scale contradicts a longer exposure.
_DARKER = 0.02
#: Exposures that differ by less than this factor have no order.
_SAME_EXPOSURE = 1.05
#: Pixels of one pure colour along a border, as share of its length, that make it an invalid one.
_BORDER_SHARE = 0.05


@dataclass(frozen=True, eq=False)
class Sight:
    """What is kept of one photograph for the checks.

    Attributes:
        photograph: its name and exposure
        digest: SHA-256 of its pixels
        grey: grey copy, float32, up to `_SIDE` pixels a side, 0 to 1
        scale: pixels of the photograph in one of the copy
        is_even: all samples are equal, as where everything is saturated
    """

    photograph: Photograph
    digest: bytes
    grey: NDArray[np.float32]
    scale: float
    is_even: bool = False

    @classmethod
    def of(cls, photograph: Photograph, pixels: Pixels, white: int) -> Sight:
        """Return that of a photograph's pixels; raises `UsageError` without OpenCV."""
        required_opencv("merging photographs")
        digest = hashlib.sha256(np.ascontiguousarray(pixels).data).digest()
        grey = pixels[..., 1] if pixels.ndim == 3 else pixels
        scale = max(1.0, max(grey.shape) / _SIDE)
        size = (max(1, round(grey.shape[1] / scale)), max(1, round(grey.shape[0] / scale)))
        small = reduced_by_area(grey, size)
        copy = np.float32(1 / white) * np.asarray(small, np.float32)
        is_even = bool((pixels == pixels.flat[0]).all())
        return cls(photograph, digest, copy, scale, is_even)


def duplicates(sights: Sequence[Sight]) -> dict[int, int]:
    """Return by position the photographs that are the same as an earlier one, with its position.

    Raises:
        DataError: the two state different exposures
    """
    first: dict[bytes, int] = {}
    found = {}
    for position, sight in enumerate(sights):
        earlier = first.setdefault(sight.digest, position)
        if earlier == position or sight.is_even:
            continue
        found[position] = earlier
        one, other = sights[earlier].photograph, sight.photograph
        if not 1 / _SAME_EXPOSURE < one.exposure / other.exposure < _SAME_EXPOSURE:
            raise DataError(
                f"{one.name} and {other.name} are the same photograph, but their exposures differ",
                hint="leave one of them out, or correct its exposure with --times",
            )
    return found


def unstated(photographs: Sequence[Photograph]) -> list[str]:
    """Return a line for what some photographs do not state of their exposures, and others do."""
    found = []
    for what, taken_for, stated in (
        ("ISO speed", "ISO 100", [each.iso for each in photographs]),
        ("f-number", "f/1", [each.f_number for each in photographs]),
    ):
        silent = [each.name for each, value in zip(photographs, stated, strict=True) if not value]
        if 0 < len(silent) < len(photographs):
            more = f" (and {len(silent) - 1} more)" if len(silent) > 1 else ""
            found.append(
                f"{silent[0]}{more} states no {what}, and others do: {taken_for} is assumed"
            )
    return found


def check_order(photographs: Sequence[Photograph], patches: Sequence[Patches], white: int) -> None:
    """Check that a longer exposure is brighter.

    Raises:
        DataError: it is not; names the photographs whose labels were swapped or do not fit
    """
    brightness = [float(np.mean(each)) / white for each in patches]
    by_label = sorted(range(len(photographs)), key=lambda k: photographs[k].exposure)
    wrong = [
        (short, long)
        for short, long in combinations(by_label, 2)
        if photographs[long].exposure >= _SAME_EXPOSURE * photographs[short].exposure
        and brightness[short] - brightness[long] > _DARKER
    ]
    if not wrong:
        return
    by_light = sorted(by_label, key=lambda k: brightness[k])
    names = [photographs[k].name for k in sorted({k for pair in wrong for k in pair})]
    hint = "correct them with --times, one for each file"
    for one, other in wrong:
        swapped = [other if k == one else one if k == other else k for k in by_label]
        if all(
            brightness[short] - brightness[long] <= _DARKER for short, long in pairwise(swapped)
        ):
            raise DataError(
                f"the exposures of {photographs[one].name} and {photographs[other].name} are "
                f"swapped: the one of the shorter exposure is the brighter one",
                hint=hint,
            )
    if by_light == by_label[::-1]:
        raise DataError(
            "the exposures of the photographs are in the reverse order: the longer they are, the "
            "darker is the picture",
            hint=hint,
        )
    raise DataError(
        f"the exposures do not fit the brightness of {', '.join(names[:4])}"
        + (" and others" if len(names) > 4 else ""),
        hint=hint,
    )


def misaligned(sights: Sequence[Sight]) -> list[str]:
    """Return a line for each photograph that is shifted or turned against its neighbour."""
    order = sorted(range(len(sights)), key=lambda k: sights[k].photograph.exposure)
    shifts = [_shift(sights[one].grey, sights[other].grey) for one, other in pairwise(order)]
    found: dict[str, str] = {}
    for place, shift in enumerate(shifts):
        if shift is None or shift == _ALIGNED:
            continue
        one, other = order[place], order[place + 1]
        # The shorter one is the shifted one if the longer one fits the photograph before it.
        if place and _shift(sights[order[place - 1]].grey, sights[other].grey) == _ALIGNED:
            one, other, shift = other, one, (-shift[0], -shift[1])
        columns, rows = (each * sights[one].scale for each in shift)
        name = sights[other].photograph.name
        found.setdefault(
            name,
            f"{name} is shifted against {sights[one].photograph.name} by about {columns:+.0f} "
            f"columns and {rows:+.0f} rows, and the picture will be blurred: align the "
            "photographs first",
        )
    return list(found.values())


def _shift(before: NDArray[np.float32], after: NDArray[np.float32]) -> tuple[float, float] | None:
    """Return by how much `after` is shifted, (columns, rows); None: nothing can be said."""
    shifts, sure = [], 0
    for rows, columns in _tiles(before.shape):
        result = _tile_shift(before[rows, columns], after[rows, columns])
        if result is None:
            continue
        sure += 1
        if np.hypot(*result) >= _SHIFTED:
            shifts.append(result)
    if sure < _LEAST_TILES:
        return None
    if len(shifts) < max(_LEAST_TILES, _SHIFTED_SHARE * sure):
        return _ALIGNED
    # A tile may have contours of one direction only; a picture that is turned has no common shift.
    whole = _tile_shift(before, after)
    if whole is not None and np.hypot(*whole) >= _SHIFTED:
        return whole
    columns, rows = np.median(shifts, axis=0).tolist()
    return columns, rows


def _tiles(shape: tuple[int, ...]) -> list[tuple[slice, slice]]:
    edges = [np.linspace(0, length, _TILES + 1).astype(int).tolist() for length in shape]
    return [
        (slice(top, bottom), slice(left, right))
        for top, bottom in pairwise(edges[0])
        for left, right in pairwise(edges[1])
    ]


def _tile_shift(
    before: NDArray[np.float32], after: NDArray[np.float32]
) -> tuple[float, float] | None:
    """Return the shift of one tile, (columns, rows); None where it shows too little.

    Both are turned into ranks of brightness, which do not depend on the exposure, of what neither
    saturates; the shift is the one of the best phase correlation, and it counts where the tiles
    then agree clearly better.
    """
    import cv2

    if min(before.shape) < 24:
        return None
    usable = (np.minimum(before, after) > _DARKEST) & (np.maximum(before, after) < _BRIGHTEST)
    if np.mean(usable) < 0.3:
        return None
    one, other = (_detail(each, usable) for each in (before, after))
    window = cv2.createHanningWindow(one.shape[::-1], cv2.CV_32F)
    (columns, rows), _ = cv2.phaseCorrelate(one, other, window)
    limit = min(before.shape) / 4
    still = _correlation(one, other, 0, 0)
    if max(abs(columns), abs(rows)) > limit:
        return (0.0, 0.0) if still > _SURE else None
    moved = _correlation(one, other, round(columns), round(rows))
    if max(moved, still) < _SURE:
        return None
    return (columns, rows) if moved > _BETTER * max(still, 0.0) else (0.0, 0.0)


def _detail(grey: NDArray[np.float32], usable: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the fine structure of a tile in ranks of brightness; 0 where it is not usable."""
    import cv2

    values = np.sort(grey[usable])
    ranks = np.searchsorted(values, grey).astype(np.float32) / values.size
    fine = ranks - cv2.GaussianBlur(ranks, (0, 0), 4)
    eroded = cv2.erode(usable.astype(np.uint8), np.ones((5, 5), np.uint8))
    return np.asarray(np.where(eroded > 0, fine, 0), np.float32)


def _correlation(
    one: NDArray[np.float32], other: NDArray[np.float32], columns: int, rows: int
) -> float:
    """Return the correlation of one tile with the other shifted back."""
    height, width = one.shape
    ours = one[max(0, -rows) : height - max(0, rows), max(0, -columns) : width - max(0, columns)]
    theirs = other[max(0, rows) : height + min(0, rows), max(0, columns) : width + min(0, columns)]
    norm = float(np.sqrt(np.sum(ours**2) * np.sum(theirs**2)))
    return float(np.sum(ours * theirs)) / norm if norm else 0.0


def wrong_exposures(
    photographs: Sequence[Photograph], patches: Sequence[Patches], check: NeighbourCheck
) -> list[str]:
    """Return a line for each pair of neighbours whose brightness contradicts their exposures."""
    order = sorted(range(len(photographs)), key=lambda k: photographs[k].exposure)
    found = []
    for one, other in pairwise(order):
        before, after = photographs[one], photographs[other]
        result = check.compare(
            patches[one],
            patches[other],
            after.exposure / before.exposure,
            lamp_factor((before.time_s, after.time_s), None),
        )
        if result.contradicts and result.is_of_whole_picture and result.measured is not None:
            found.append(
                f"{after.name} is {result.measured:.3g} times as bright as {before.name}, and its "
                f"exposure is {result.expected:.3g} times as long: one of the two exposures is "
                "wrong, or the light has changed"
            )
    return found


def invalid_border(pixels: Pixels) -> NDArray[np.bool_]:
    """Return which pixels lie in a border of one pure colour, as programs that align leave it.

    A pure colour has samples of 0 and of the largest code only, and is not black or white.
    """
    import cv2

    shape = pixels.shape[:2]
    if pixels.ndim == 2:
        return np.zeros(shape, np.bool_)
    top = np.iinfo(pixels.dtype).max
    is_top, is_zero = pixels == top, pixels == 0
    count = is_top.sum(axis=2)
    pure = (is_top | is_zero).all(axis=2) & (count > 0) & (count < 3)
    edges = [pure[0], pure[-1], pure[:, 0], pure[:, -1]]
    if max(float(np.mean(edge)) for edge in edges) < _BORDER_SHARE:
        return np.zeros(shape, np.bool_)
    _, labels = cv2.connectedComponents(pure.astype(np.uint8), connectivity=8)
    touching = np.unique(np.concatenate((labels[0], labels[-1], labels[:, 0], labels[:, -1])))
    return np.isin(labels, touching[touching > 0])


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
        raise DataError("no pixel is valid in all photographs", hint="check --mask")
    return found


def blackened(pixels: Pixels, invalid: NDArray[np.bool_], black: int) -> Pixels:
    """Return pixels without light where they are invalid."""
    changed: NDArray[Any] = pixels.copy()
    changed[invalid] = black
    return changed
