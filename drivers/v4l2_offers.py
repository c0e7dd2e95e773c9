"""What a video node offers: who it is, ranges of controls, sizes of frames."""

from __future__ import annotations

from dataclasses import dataclass


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
