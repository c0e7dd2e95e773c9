"""What the menu has done for it: the job port and the data that goes through it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import Enum, auto
from types import TracebackType
from typing import Protocol, Self

from camctl.captures.request import CapturePlan
from camctl.captures.sequencer import Progress

__all__ = ["CapturePlan", "Choice", "Cost", "Job", "Progress", "Summary"]


@dataclass(frozen=True)
class Choice:
    """What a person picked.

    Attributes:
        response: desired response, one of `camctl.exposure.response.RESPONSES`
        dynamic_range: desired dynamic range, brightest over darkest
        count: number of exposures
    """

    response: str
    dynamic_range: float
    count: int


@dataclass(frozen=True)
class Cost:
    """What one number of exposures costs and gives.

    Attributes:
        count: number of exposures
        exposures: relative to the shortest, ascending
        shutter_time: time that the shutter is open in all, in units of the shortest exposure
        effective_levels: how many equal steps in the desired response are as accurate
    """

    count: int
    exposures: tuple[float, ...]
    shutter_time: float
    effective_levels: float


@dataclass(frozen=True)
class Summary:
    """What a capture gave.

    Attributes:
        effective_levels: achieved with the exposures that the camera applied
        saturated: share of the samples that no exposure caught below saturation, 0 to 1
        folder: where the files are
        notes: what else a person should know, one line each
    """

    effective_levels: float
    saturated: float
    folder: str
    notes: tuple[str, ...] = ()


class Job(Protocol):
    """The work behind the menu.  Methods are called from one worker thread, one at a time.

    All raise `camctl.errors.CamctlError` where something cannot be done.
    """

    def predict(self, response: str, dynamic_range: float) -> Iterable[Cost]:
        """Return what each number of exposures costs, ascending by number, at least one.

        Where they take time, an iterator that yields each as it is found lets the menu show how far
        it is, and stop when nobody waits any more.
        """
        ...

    def plan(self, choice: Choice) -> CapturePlan:
        """Return the very settings that will be shot for `choice`, metered where need be."""
        ...

    def shoot(
        self,
        plan: CapturePlan,
        on_progress: Callable[[Progress], None],
        cancelled: Callable[[], bool],
    ) -> Summary:
        """Shoot exactly the settings of `plan`.

        Once `cancelled` returns True it stops, keeps what was shot, and raises
        `camctl.errors.InterruptedCaptureError` with one line that says where that is.
        """
        ...


SMALLEST = (20, 4)


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
    """The characters of one row that are the selected entry, counted from 0."""

    row: int
    column: int
    width: int


class Panel(Protocol):
    """What every panel, on a screen or on a cable, stands behind.

    A panel is a context manager: entering opens it, leaving gives everything back as it was.  All
    methods raise `camctl.errors.CamctlError` when the panel is gone.
    """

    @property
    def size(self) -> tuple[int, int]:
        """(columns, rows) that can be shown now, at least `SMALLEST`; may change while open."""
        ...

    def show(self, lines: Sequence[str], highlight: Highlight | None = None) -> None:
        """Show `lines`, one for each row, each as long as a row.

        The selected entry can be told from the text alone; a panel that can do more about it finds
        its place in `highlight`.
        """
        ...

    def key(self, timeout_s: float) -> Key | None:
        """Return the next key; None after `timeout_s` without one, or sooner."""
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
