"""What the state machine exchanges with the worker: events come in, effects go out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

from camctl.captures.request import CapturePlan
from camctl.captures.sequencer import Progress
from menu.ports import Choice, Cost, Summary


@dataclass(frozen=True)
class Event:
    """A report on the work that was started with `request_id`."""

    request_id: int


@dataclass(frozen=True)
class Predicted(Event):
    """The costs of all numbers of exposures are computed; there is at least one."""

    costs: tuple[Cost, ...]

    def __post_init__(self) -> None:
        if not self.costs:
            raise ValueError("a prediction needs the cost of at least one number of exposures")


@dataclass(frozen=True)
class Planned(Event):
    """The settings of the camera are chosen."""

    plan: CapturePlan


@dataclass(frozen=True)
class Progressed(Event):
    """The work has made progress."""

    progress: Progress


@dataclass(frozen=True)
class Done(Event):
    """The capture is complete."""

    summary: Summary


@dataclass(frozen=True)
class Cancelled(Event):
    """The capture was cancelled; `message` states what was kept."""

    message: str


@dataclass(frozen=True)
class Failed(Event):
    """The work failed; `message` states why and what to do."""

    message: str


@dataclass(frozen=True)
class Predict:
    """Effect: compute what each number of exposures costs."""

    request_id: int
    response: str
    dynamic_range: float


@dataclass(frozen=True)
class MakePlan:
    """Effect: meter and choose the settings."""

    request_id: int
    choice: Choice


@dataclass(frozen=True)
class Shoot:
    """Effect: shoot the settings of `plan`."""

    request_id: int
    plan: CapturePlan


@dataclass(frozen=True)
class Cancel:
    """Effect: cancel the capture that was started with `request_id`."""

    request_id: int


@dataclass(frozen=True)
class Quit:
    """Effect: end the menu."""


Effect: TypeAlias = Predict | MakePlan | Shoot | Cancel | Quit
