"""Checks on the pixels of photographs: size, duplicates, alignment, labels, and invalid borders."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.errors import DataError
from camctl.evidence.patches import Patches
from camctl.interface.camera import Pixels
from camctl.photographs.photograph import Photograph
from camctl.system.picture_operations import reduced_by_area, required_opencv

#: Longest side of the grey copies in which alignment is measured, pixels.
_SIDE = 1024
#: A longer exposure is contradicted where patches are darker by this share of full scale, so many
#: times more of them than are brighter by it, and this share of all: a thing that moved is less.
_DARKER, _TIMES_MORE, _DARKER_SHARE = 0.02, 3, 0.03
#: Exposures that differ by less than this factor have no order.
SAME_EXPOSURE = 1.05
_CORRECT = "correct them with --times, one for each file, or leave out a damaged file"
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
        if not 1 / SAME_EXPOSURE < one.exposure / other.exposure < SAME_EXPOSURE:
            raise DataError(
                f"{one.name} and {other.name} are the same photograph, but their exposures differ",
                hint="leave one of them out, or correct its exposure with --times",
            )
    return found


def with_all_stated(photographs: Sequence[Photograph]) -> tuple[list[Photograph], list[str]]:
    """Return photographs with what some do not state of their exposures, and others do.

    It is the value of the others where that is the same in all, else ISO 100 and f/1.  The second
    result has a line for each.
    """
    found, notes = list(photographs), []
    for what, prefix, field, default in (
        ("ISO speed", "ISO ", "iso", 100.0),
        ("f-number", "f/", "f_number", 1.0),
    ):
        values = [getattr(each, field) for each in found]
        silent, stated = (
            [k for k, value in enumerate(values) if not value],
            set(filter(None, values)),
        )
        if not silent or not stated:
            continue
        value = stated.pop() if len(stated) == 1 else default
        changes: dict[str, Any] = {field: value}
        if field == "iso":
            changes["gain"] = value / 100
        for k in silent:
            found[k] = replace(found[k], **changes)
        more = f" (and {len(silent) - 1} more)" if len(silent) > 1 else ""
        notes.append(
            f"{found[silent[0]].name}{more} states no {what}, and others do: {prefix}{value:g} is "
            "assumed"
        )
    return found, notes


def flashes(photographs: Sequence[Photograph]) -> list[str]:
    """Return a line where the flash fired in some photographs, and not in others."""
    fired, dark = (
        [each.name for each in photographs if each.flash_fired is is_fired]
        for is_fired in (True, False)
    )
    if not fired or not dark:
        return []
    odd, verb = (fired, "fired") if len(fired) <= len(dark) else (dark, "did not fire")
    return [
        f"the flash {verb} in {', '.join(odd)} only, where the light is another: leave "
        f"{'it' if len(odd) == 1 else 'them'} out"
    ]


def swapped_error(one: str, other: str) -> DataError:
    """Return the error of two photographs, given by their names, with each other's exposure."""
    return DataError(
        f"the exposures of {one} and {other} are swapped: the one of the shorter exposure is the "
        "brighter one",
        hint=_CORRECT,
    )


def check_order(photographs: Sequence[Photograph], patches: Sequence[Patches], white: int) -> None:
    """Check that a longer exposure is brighter.

    Raises:
        DataError: it is not; names the photographs whose labels were swapped or do not fit
    """
    means = [each.mean(axis=1) / white for each in patches]

    def is_reversed(short: int, long: int) -> bool:
        change = means[long] - means[short]
        darker, brighter = (float(np.mean(sign * change > _DARKER)) for sign in (-1, 1))
        return darker > max(_DARKER_SHARE, _TIMES_MORE * brighter)

    by_label = sorted(range(len(photographs)), key=lambda k: photographs[k].exposure)
    wrong = [
        (short, long)
        for short, long in combinations(by_label, 2)
        if photographs[long].exposure >= SAME_EXPOSURE * photographs[short].exposure
        and is_reversed(short, long)
    ]
    if not wrong:
        return
    by_light = sorted(by_label, key=lambda k: float(means[k].mean()))
    names = [photographs[k].name for k in sorted({k for pair in wrong for k in pair})]
    hint = _CORRECT
    for one, other in wrong:
        swapped = [other if k == one else one if k == other else k for k in by_label]
        if not any(is_reversed(short, long) for short, long in pairwise(swapped)):
            raise swapped_error(photographs[one].name, photographs[other].name)
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


def invalid_border(pixels: Pixels) -> NDArray[np.bool_]:
    """Return which pixels lie in a border of one pure colour, as programs that align leave it.

    A pure colour has samples of 0 and of the largest code only, and is not black or white.
    """
    import cv2

    shape = pixels.shape[:2]
    if pixels.ndim == 2:
        return np.zeros(shape, np.bool_)
    edges = (pixels[:1], pixels[-1:], pixels[:, :1], pixels[:, -1:])
    if max(float(np.mean(_is_pure(edge))) for edge in edges) < _BORDER_SHARE:
        return np.zeros(shape, np.bool_)
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
        raise DataError("no pixel is valid in all photographs", hint="check --mask")
    return found
