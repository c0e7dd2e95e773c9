"""The interfaces of the menu: the job behind it, the panel in front, and their data."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import Enum, auto
from types import TracebackType
from typing import Protocol, Self

from camctl.captures.request import CapturePlan
from camctl.captures.sequencer import Progress


@dataclass(frozen=True)
class Choice:
    """What the user selected.

    Attributes:
        response: desired response, one of `camctl.response.desired.RESPONSES`
        dynamic_range: desired dynamic range, brightest over darkest
        count: number of exposures
    """

    response: str
    dynamic_range: float
    count: int


@dataclass(frozen=True)
class Cost:
    """The price and the benefit of one number of exposures.

    Attributes:
        count: number of exposures
        exposures: relative to the shortest, ascending
        total_exposure: sum of `exposures`
        effective_levels: number of equal steps in the desired response that are as accurate
    """

    count: int
    exposures: tuple[float, ...]
    total_exposure: float
    effective_levels: float


@dataclass(frozen=True)
class Summary:
    """The result of a capture.

    Attributes:
        effective_levels: achieved with the exposures that the camera applied
        saturated: fraction of the samples that are saturated in every frame, 0 to 1
        folder: folder of the files
        notes: warnings, one line each
    """

    effective_levels: float
    saturated: float
    folder: str
    notes: tuple[str, ...] = ()


class Job(Protocol):
    """The work behind the menu.  Methods are called from one worker thread, one at a time.

    All raise `camctl.errors.CamctlError` for what cannot be done.
    """

    def predict(self, response: str, dynamic_range: float) -> Iterable[Cost]:
        """Return the cost of each number of exposures, ascending, at least one.

        If they take time to compute, return an iterator that yields each as it is found: the menu
        then shows progress, and stops iterating when the user leaves.
        """
        ...

    def plan(self, choice: Choice) -> CapturePlan:
        """Return the exact settings that will be shot for `choice`, metered where needed."""
        ...

    def shoot(
        self,
        plan: CapturePlan,
        on_progress: Callable[[Progress], None],
        cancelled: Callable[[], bool],
    ) -> Summary:
        """Shoot exactly the settings of `plan`.

        Once `cancelled` returns True, stop, keep the frames shot so far, and raise
        `camctl.errors.InterruptedCaptureError` with one line that states where they are.
        """
        ...


SMALLEST = (20, 4)
"""(columns, rows) of the smallest panel that the menu can be shown on."""


class Key(Enum):
    """The keys that every panel has."""

    UP = auto()
    DOWN = auto()
    LEFT = auto()
    RIGHT = auto()
    ENTER = auto()
    EXIT = auto()


@dataclass(frozen=True)
class Highlight:
    """The characters of the selected entry: `width` of them in one row, counted from 0."""

    row: int
    column: int
    width: int


class Panel(Protocol):
    """A display with keys, on a screen or at the end of a cable.

    A panel is a context manager: entering opens it, leaving closes it and restores what it changed.
    All methods raise `camctl.errors.CamctlError` when the panel is disconnected.
    """

    @property
    def size(self) -> tuple[int, int]:
        """(columns, rows) that can be shown now, at least `SMALLEST`; may change while open."""
        ...

    def show(self, lines: Sequence[str], highlight: Highlight | None = None) -> None:
        """Show `lines`, one for each row, each as long as a row.

        The text alone marks the selected entry; a panel that can also emphasise it finds its place
        in `highlight`.
        """
        ...

    def key(self, timeout_s: float) -> Key | None:
        """Return the next key; None after `timeout_s` without one, or earlier."""
        ...

    def __enter__(self) -> Self:
        """Open the panel and return it."""
        ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the panel."""
        ...
