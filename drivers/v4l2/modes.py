"""What a video node offers: who it is, ranges of controls, sizes of frames."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from camctl.errors import UsageError


@dataclass(frozen=True)
class Identity:
    """What a node says of itself."""

    driver: str
    card: str
    bus: str
    is_capture: bool


@dataclass(frozen=True)
class ControlRange:
    """What a control can be set to."""

    id: int
    name: str
    kind: int
    minimum: int
    maximum: int
    step: int
    default: int
    is_read_only: bool

    def nearest(self, value: int) -> int:
        """Return the value on the control's grid that is nearest to `value`."""
        inside = min(max(value, self.minimum), self.maximum)
        count = round((inside - self.minimum) / self.step)
        return min(self.minimum + count * self.step, self.maximum)


@dataclass(frozen=True)
class Size:
    """A frame's size, pixels."""

    width: int
    height: int

    def __str__(self) -> str:
        return f"{self.width}x{self.height}"


@dataclass(frozen=True)
class SizeGrid:
    """Sizes that a camera offers in one format: a list, or all on a grid between two."""

    listed: tuple[Size, ...]
    smallest: Size = Size(0, 0)
    step: Size = Size(1, 1)

    @property
    def largest(self) -> Size:
        """The size with the most pixels."""
        return max(self.listed, key=lambda size: (size.width * size.height, size.width))

    def has(self, size: Size) -> bool:
        """Say whether the camera offers `size`."""
        if size in self.listed:
            return True
        if not self.smallest.width:
            return False
        return all(
            low <= value <= high and (value - low) % step == 0
            for value, low, high, step in (
                (size.width, self.smallest.width, self.largest.width, self.step.width),
                (size.height, self.smallest.height, self.largest.height, self.step.height),
            )
        )


_USUAL_INTERVAL_S = 1 / 30
_SAME_RATE = 0.01


def parse_size(text: str) -> tuple[int, int]:
    """Return (width, height) of "WIDTHxHEIGHT"; raises `UsageError`."""
    match = re.fullmatch(r"\s*([1-9]\d{0,5})\s*[xX×]\s*([1-9]\d{0,5})\s*", text, re.ASCII)
    if match is None:
        raise UsageError(f"a size of '{text}'", hint="write WIDTHxHEIGHT, such as 640x480")
    return int(match[1]), int(match[2])


def parse_rate(text: str) -> float:
    """Return frames a second; raises `UsageError`."""
    try:
        return float(text)
    except ValueError:
        raise UsageError(f"an fps of '{text}'", hint="give a number, such as 30") from None


def parse_whole(name: str, text: str) -> int:
    """Return the whole number that an option is; raises `UsageError`."""
    if not re.fullmatch(r"\d{1,6}", text.strip(), re.ASCII):
        raise UsageError(f"{name} of '{text}'", hint="give a whole number")
    return int(text)


def choose_size(grid: SizeGrid, wanted: tuple[int, int] | None, path: str) -> Size:
    """Return the size wanted, or the largest; raises `UsageError` where it is not offered."""
    if wanted is None:
        return grid.largest
    size = Size(*wanted)
    if not grid.has(size):
        known = ", ".join(str(each) for each in grid.listed)
        raise UsageError(f"{path} has no frames of {size}", hint=f"it offers {known}")
    return size


def choose_interval(offered: Sequence[float], fps: float | None, path: str) -> float:
    """Return a frame interval, s: the one asked for, or the longest.

    The longest, because no exposure may last longer than the interval: who has light enough asks
    for a higher rate.  Only those count that OpenCV can ask for: the nearest to some whole number
    of frames a second.  Raises `UsageError` where the rate asked for is not offered.
    """
    if fps is not None and not (math.isfinite(fps) and 0 < fps <= 10_000):
        raise UsageError(f"an fps of {fps:g}", hint="give a positive number, such as 30")
    usable = [
        interval_s
        for interval_s in offered
        if min(offered, key=lambda each: abs(each - 1 / whole_rate(interval_s))) == interval_s
    ]
    if not usable:
        return 1 / fps if fps is not None else _USUAL_INTERVAL_S
    if fps is None:
        return max(usable)
    nearest = min(usable, key=lambda interval_s: abs(math.log(interval_s * fps)))
    if abs(nearest * fps - 1) > _SAME_RATE:
        known = ", ".join(f"{1 / interval_s:.4g}" for interval_s in sorted(usable, reverse=True))
        raise UsageError(f"{path} has no {fps:g} frames a second", hint=f"it offers {known}")
    return nearest


def whole_rate(interval_s: float) -> int:
    """Return the whole number of frames a second nearest to a rate: all that OpenCV can ask for."""
    return max(1, round(1 / interval_s))
