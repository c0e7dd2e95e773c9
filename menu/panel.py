"""The panel port: a grid of characters that shows, and six keys that are pressed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, auto
from types import TracebackType
from typing import Protocol, Self

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
