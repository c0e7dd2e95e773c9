"""The state of the menu as one immutable value."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum, StrEnum, auto

from camctl.menu.data import (
    CameraEntry,
    Choice,
    Cost,
    Past,
    Plan,
    Progress,
    Reading,
    Rival,
    Settings,
    Summary,
)


class State(StrEnum):
    """The screens of the menu."""

    STARTING = auto()
    OPENING = auto()
    CAMERA_FAILED = auto()
    IDLE = auto()
    RESPONSE = auto()
    RANGE = auto()
    CUSTOM = auto()
    EXPOSURES = auto()
    BUDGET = auto()
    FRONT = auto()
    PLANNING = auto()
    PLAN_FAILED = auto()
    REVIEW = auto()
    TIMER = auto()
    SHOOTING = auto()
    CANCELLING = auto()
    STOPPING = auto()
    CANCELLED = auto()
    CAPTURE_FAILED = auto()
    RESULT = auto()
    MENU = auto()
    SEARCHING = auto()
    SEARCH_FAILED = auto()
    CAMERAS = auto()
    BROWSING = auto()
    BROWSE_FAILED = auto()
    CAPTURES = auto()
    LOOKING = auto()
    LOOK_FAILED = auto()
    PAST = auto()
    RESUMING = auto()
    RESUME_FAILED = auto()
    SERIES = auto()
    SERIES_SHOOTING = auto()
    SERIES_FAILED = auto()
    SEVERAL = auto()
    CALIBRATION = auto()
    CALIBRATING = auto()
    CALIBRATION_STOPPING = auto()
    CALIBRATED = auto()
    CALIBRATION_FAILED = auto()
    SETTINGS = auto()
    ABOUT = auto()
    SAVER = auto()
    CONFIRM = auto()
    QUIT = auto()


class Action(Enum):
    """What a button of a page or an entry of a list does; the value is the text of a button."""

    SET = "Set"
    SHOOT = "Shoot"
    MENU = "Menu"
    TIMER = "Timer"
    RETRY = "Retry"
    AGAIN = "Again"
    BACK = "Back"
    OTHER = "Other camera"
    CAPTURES = "Captures"
    SETTINGS = "Settings"
    ABOUT = "About"
    CUSTOM = "Custom"
    BUDGET = "Time budget"
    FRONT = "Time / accuracy"
    RESUME = "Resume"
    CHANGE = "Change"
    SERIES = "Series"
    START = "Start"
    SEVERAL = "Several cameras"
    CALIBRATE = "Calibration"
    QUIT = "Quit"


class Goal(Enum):
    """What decides the exposures."""

    COUNT = auto()
    BUDGET = auto()
    FRONT = auto()


@dataclass(frozen=True)
class Model:
    """The state of the menu.

    Attributes:
        state: the screen that is shown
        settings: what was selected, kept from one start to the next
        goal: what decides the exposures
        cursor: selected entry of a list that is not kept in the settings
        action: index of the selected button of a page
        offset: first line of a page to show
        costs: what each entry of the list costs; None: not predicted yet
        front: the points of the list *Time / accuracy*, the quickest first
        rivals: what they are compared with, where a page shows it
        point: the one that was chosen, and what its list was for
        reading: the last reading of the exposure meter
        plan: the plan that the review shows and that will be shot
        progress: progress of the running work
        remaining_s: seconds until the self-timer shoots
        summary: result of the capture that is shown
        cameras: the cameras that were found
        camera: the camera that is open; None: none
        marked: ids of cameras that are to take pictures together; (): all
        calibrated: what the last calibration has measured
        captures: the captures in the folder, the newest first
        error: message of the last failure
        note: a remark for the idle screen
        request_id: of the work started last; events of earlier work are ignored
        begun: what taking pictures began with last, and begins with again after it was cancelled
    """

    state: State = State.STARTING
    settings: Settings = field(default_factory=Settings)
    goal: Goal = Goal.COUNT
    cursor: int = 0
    action: int = 0
    offset: int = 0
    costs: tuple[Cost | None, ...] = ()
    front: tuple[Cost, ...] = ()
    rivals: tuple[Rival, ...] = ()
    point: tuple[Cost, Choice] | None = None
    reading: Reading | None = None
    plan: Plan | None = None
    progress: Progress | None = None
    remaining_s: int = 0
    summary: Summary | None = None
    cameras: tuple[CameraEntry, ...] = ()
    camera: CameraEntry | None = None
    marked: tuple[str, ...] = ()
    calibrated: tuple[str, ...] = ()
    captures: tuple[Past, ...] = ()
    error: str = ""
    note: str = ""
    request_id: int = 0
    begun: State = State.PLANNING
