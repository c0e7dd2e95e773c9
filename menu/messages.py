"""What comes into the menu from outside, and what it wants done there, as data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

from camctl.captures.request import CapturePlan
from camctl.captures.sequencer import Progress
from menu.ports import Choice, Cost, Summary


@dataclass(frozen=True)
class Event:
    """What became of the work that was started with `ticket`."""

    ticket: int


@dataclass(frozen=True)
class Predicted(Event):
    """The costs are known, at least one."""

    costs: tuple[Cost, ...]

    def __post_init__(self) -> None:
        if not self.costs:
            raise ValueError("a prediction needs at least one number of exposures")


@dataclass(frozen=True)
class Planned(Event):
    """The settings are known."""

    plan: CapturePlan


@dataclass(frozen=True)
class Progressed(Event):
    """The work goes on."""

    progress: Progress


@dataclass(frozen=True)
class Done(Event):
    """The picture is there."""

    summary: Summary


@dataclass(frozen=True)
class Cancelled(Event):
    """The capture was called off; `line` says what was kept."""

    line: str


@dataclass(frozen=True)
class Failed(Event):
    """The work could not be done; `line` says why and what to do."""

    line: str


@dataclass(frozen=True)
class Predict:
    """Effect: find what each number of exposures costs."""

    ticket: int
    response: str
    dynamic_range: float


@dataclass(frozen=True)
class MakePlan:
    """Effect: find the settings."""

    ticket: int
    choice: Choice


@dataclass(frozen=True)
class Shoot:
    """Effect: take the pictures of `plan`."""

    ticket: int
    plan: CapturePlan


@dataclass(frozen=True)
class Cancel:
    """Effect: call off the capture that was started with `ticket`."""

    ticket: int


@dataclass(frozen=True)
class Quit:
    """Effect: leave the menu."""


Effect: TypeAlias = Predict | MakePlan | Shoot | Cancel | Quit
