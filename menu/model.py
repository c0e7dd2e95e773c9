"""All that the menu knows at one moment."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, StrEnum, auto

from camctl.captures.request import CapturePlan
from camctl.captures.sequencer import Progress
from menu.ports import Choice, Cost, Summary


class State(StrEnum):
    """Where in the menu somebody is."""

    RESPONSE = auto()
    RANGE = auto()
    PREDICTING = auto()
    PREDICTION_FAILED = auto()
    EXPOSURES = auto()
    PLANNING = auto()
    PLAN_FAILED = auto()
    REVIEW = auto()
    SHOOTING = auto()
    CANCELLING = auto()
    CANCELLED = auto()
    SHOT_FAILED = auto()
    RESULT = auto()
    QUIT = auto()


class Action(Enum):
    """What a page offers to do; its value is the word on the panel."""

    SHOOT = "Shoot"
    RETRY = "Retry"
    AGAIN = "Again"
    BACK = "Back"
    MENU = "Menu"
    QUIT = "Quit"


@dataclass(frozen=True)
class Entry:
    """One line of a list: its name for the controller, for the panel, and what it means."""

    name: str
    label: str
    gloss: str
    value: float = 0.0


RESPONSES = (
    Entry("log", "Constant contrast", "equal steps of contrast"),
    Entry("linear", "Linear", "equal steps of light"),
    Entry("gamma", "Gamma 1/2", "between the two, as displays"),
)
RANGES = (
    Entry("high", "High 1:16,000", "sun and deep shade", 16000.0),
    Entry("medium", "Medium 1:1,000", "a room by day", 1000.0),
    Entry("low", "Low 1:256", "even light", 256.0),
)


@dataclass(frozen=True)
class Model:
    """All that the menu knows.

    Attributes:
        state: where it is
        response: selected entry of `RESPONSES`
        range: selected entry of `RANGES`
        count: number of exposures selected
        costs: what each number of exposures costs, once known
        base_s: shortest exposure of the last plan, s, once known
        plan: what the review shows and what will be shot
        progress: of the work that is running
        summary: of the last capture
        trouble: the line of the last failure
        action: selected action of a page
        offset: first line of a page that is wanted on the panel
        ticket: of the work started last; events with another one come too late
    """

    state: State = State.RESPONSE
    response: int = 0
    range: int = 1
    count: int = 3
    costs: tuple[Cost, ...] = ()
    base_s: float | None = None
    plan: CapturePlan | None = None
    progress: Progress | None = None
    summary: Summary | None = None
    trouble: str = ""
    action: int = 0
    offset: int = 0
    ticket: int = 0

    @property
    def choice(self) -> Choice:
        """What is picked now."""
        return Choice(RESPONSES[self.response].name, RANGES[self.range].value, self.count)

    @property
    def row(self) -> int:
        """Position of `count` among `costs`."""
        return [cost.count for cost in self.costs].index(self.count)
