"""The state of the menu as one immutable value."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, StrEnum, auto

from camctl.captures.request import CapturePlan
from camctl.captures.sequencer import Progress
from menu.ports import Choice, Cost, Summary


class State(StrEnum):
    """The screens of the menu."""

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
    CAPTURE_FAILED = auto()
    RESULT = auto()
    QUIT = auto()


class Action(Enum):
    """The buttons at the bottom of a page; the value is the text on the panel."""

    SHOOT = "Shoot"
    RETRY = "Retry"
    AGAIN = "Again"
    BACK = "Back"
    MENU = "Menu"
    QUIT = "Quit"


@dataclass(frozen=True)
class Entry:
    """One line of a list.

    Attributes:
        name: what the controller calls it
        label: what the panel calls it
        description: what it is for, shown on wide panels
        value: its number, for dynamic ranges
    """

    name: str
    label: str
    description: str
    value: float = 0.0


RESPONSES = (
    Entry("log", "Constant contrast", "equal steps of contrast"),
    Entry("linear", "Linear", "equal steps of light"),
    Entry("gamma", "Gamma 1/2", "between the two, as in displays"),
)
RANGES = (
    Entry("high", "High 1:16,000", "sun and deep shade", 16000.0),
    Entry("medium", "Medium 1:1,000", "a room in daylight", 1000.0),
    Entry("low", "Low 1:256", "even light", 256.0),
)


@dataclass(frozen=True)
class Model:
    """The state of the menu.

    Attributes:
        state: the screen that is shown
        response: index of the selected entry of `RESPONSES`
        range: index of the selected entry of `RANGES`
        count: selected number of exposures
        costs: what each number of exposures costs, empty until predicted
        base_s: shortest exposure of the last plan, s; None until known
        plan: the plan that the review shows and that will be shot
        progress: progress of the running work
        summary: result of the last capture
        error: message of the last failure
        action: index of the selected action of a page
        offset: first line of a page to show
        request_id: of the work started last; events of earlier work are ignored
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
    error: str = ""
    action: int = 0
    offset: int = 0
    request_id: int = 0

    @property
    def choice(self) -> Choice:
        """The selected response, dynamic range and number of exposures."""
        return Choice(RESPONSES[self.response].name, RANGES[self.range].value, self.count)

    @property
    def cost_index(self) -> int:
        """Index of `count` in `costs`."""
        return [cost.count for cost in self.costs].index(self.count)
