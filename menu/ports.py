"""The interfaces of the menu: the job behind it, and the panel in front of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum, auto
from types import TracebackType
from typing import Protocol, Self

from camctl.errors import CamctlError
from camctl.menu.data import (
    Calibrated,
    CameraEntry,
    Choice,
    Cost,
    Loaded,
    Past,
    Picture,
    Plan,
    Progress,
    Reading,
    SeriesChoice,
    Settings,
    Summary,
    Traced,
)


class PanelDisconnectedError(CamctlError):
    """The panel is not there now, and may come back: the menu opens it again until it does."""


class Key(Enum):
    """The keys that every panel has."""

    UP = auto()
    DOWN = auto()
    LEFT = auto()
    RIGHT = auto()
    ENTER = auto()
    EXIT = auto()


class Mood(Enum):
    """What lights beside a panel show."""

    READY = auto()
    BUSY = auto()
    ERROR = auto()


@dataclass(frozen=True)
class Line:
    """A line of a screen, in several lengths.

    Attributes:
        texts: the longest first; a panel shows the longest one that fits
        note: what stands beside it, in several lengths as well, where there is room for both
    """

    texts: tuple[str, ...]
    note: tuple[str, ...] = ()


@dataclass(frozen=True)
class Screen:
    """What a panel shows, independent of its size.

    Attributes:
        title: the first line
        lines: entries of a list, or the first lines of a page
        paragraphs: text that is wrapped to the panel; below a list only where there is room
        detail: what the selected entry costs; the last line of a small panel
        selected: index of the selected entry of `lines`; None: it is no list
        offset: first line of a page to show
        actions: the buttons of a page
        action: index of the selected one
        keys: what the keys do, the most important first
        share: progress, 0 to 1; None: no bar
        histogram: shares of the samples, dark to bright
        picture: a small picture
        folder: of the capture whose result is shown, for panels that hand over its files; ""
        mood: what lights beside the panel show
        is_dark: the screen saver; panels switch their light off
    """

    title: Line
    lines: tuple[Line, ...] = ()
    paragraphs: tuple[str, ...] = ()
    detail: Line | None = None
    selected: int | None = None
    offset: int = 0
    actions: tuple[str, ...] = ()
    action: int = 0
    keys: tuple[str, ...] = ()
    share: float | None = None
    histogram: tuple[float, ...] = ()
    picture: Picture | None = None
    folder: str = ""
    mood: Mood = Mood.READY
    is_dark: bool = False


class Panel(Protocol):
    """A display with keys, on a screen or at the end of a cable.

    A panel is a context manager: entering opens it, leaving closes it and restores what it changed.
    A third-party panel is named in the entry-point group ``camctl.panels``: a callable that takes
    the part of ``--panel NAME:ADDRESS`` after the colon, or nothing.  Panels of characters arrange
    a screen with `camctl.menu.layout.grid`, panels of pixels draw it with
    `camctl.menu.drawing.draw`.

    All methods raise `PanelDisconnectedError` when the panel was unplugged; the menu then closes it
    and opens it again until that succeeds.  Any other error ends the menu.
    """

    def show(self, screen: Screen) -> int:
        """Show `screen`; return the largest `Screen.offset` that still brings new lines.

        It is called when the screen changes; a panel that changes its size shows the last screen
        again by itself.
        """

    def key(self, timeout_s: float) -> Key | None:
        """Return the next key; None after `timeout_s` without one, or earlier."""

    def __enter__(self) -> Self:
        """Open the panel and return it."""

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the panel."""


class Job(Protocol):
    """The work behind the menu.  Methods are called from one worker thread, one at a time.

    All raise `camctl.CamctlError` for what cannot be done.  What a camera needs is done
    again by the next call of `open`, such as after it was unplugged.
    """

    def load(self) -> Loaded:
        """Return the settings that were kept, or defaults and why."""

    def save(self, settings: Settings) -> None:
        """Keep the settings, durably."""

    def find_cameras(self) -> tuple[CameraEntry, ...]:
        """Return the cameras that can be opened."""

    def open(self, camera_id: str) -> CameraEntry:
        """Open a camera, "" for the camera of the command line; the camera before is closed."""

    def meter(self) -> Reading:
        """Return what the exposure meter shows now, within a second or so."""

    def predict(self, choices: Sequence[Choice], cancelled: Callable[[], bool]) -> Iterator[Cost]:
        """Yield the cost of each choice; end early where `cancelled` returns True."""

    def trace(self, choice: Choice, cancelled: Callable[[], bool]) -> Traced:
        """Return what accuracy costs in time."""
        ...

    def plan(self, choice: Choice, cancelled: Callable[[], bool]) -> Plan:
        """Return the exact settings that will be shot for `choice`, metered where needed."""

    def shoot(
        self,
        plan: Plan,
        on_progress: Callable[[Progress], None],
        cancelled: Callable[[], bool],
    ) -> Summary:
        """Shoot exactly the settings of `plan`.

        Once `cancelled` returns True, stop, keep the frames shot so far, and raise
        `camctl.InterruptedCaptureError` with one line that states where they are.
        """

    def resume(
        self,
        past: Past,
        on_progress: Callable[[Progress], None],
        cancelled: Callable[[], bool],
    ) -> Summary:
        """Shoot the missing frames of a capture, as `shoot` does."""

    def series(
        self,
        series: SeriesChoice,
        on_progress: Callable[[Progress], None],
        cancelled: Callable[[], bool],
    ) -> Summary:
        """Take a series, as `shoot` does; return the last complete picture and what to know."""

    def calibrate(
        self,
        scene: str,
        on_progress: Callable[[Progress], None],
        cancelled: Callable[[], bool],
    ) -> Calibrated:
        """Measure the camera, see `camctl.menu.entries.CALIBRATIONS`; keep the results."""
        ...

    def captures(self) -> tuple[Past, ...]:
        """Return the captures in the folder, the newest first."""

    def look(self, past: Past) -> Summary:
        """Return the result of a complete capture."""

    def close(self) -> None:
        """Close the camera, if one is open."""
