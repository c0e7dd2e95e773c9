"""The menu as two tables: the properties of each state, and the transitions between them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto
from typing import TypeAlias

from camctl.menu.model import Action, State
from camctl.menu.ports import Key, Mood


class Outcome(Enum):
    """What is reported of the work, and of time."""

    DONE = "done"
    PART = "part"
    FAILED = "failed"
    CANCELLED = "cancelled"
    TICK = "tick"
    ELAPSED = "time over"
    UNUSED = "unused"
    NOTE = "note"


Symbol: TypeAlias = Key | Action | Outcome
"""What can cause a transition."""


@dataclass(frozen=True)
class Event:
    """A report on the work that was started with `request_id`.

    Reports on time (`TICK`, `UNUSED`) and remarks (`NOTE`) belong to no work.  `value` of a failure
    is its text for the panel, and `error` the failure itself.
    """

    outcome: Outcome
    request_id: int = 0
    value: object = None
    error: Exception | None = None


class Work(Enum):
    """The kinds of work, each a method of `camctl.menu.ports.Job`."""

    LOAD = auto()
    OPEN = auto()
    METER = auto()
    PREDICT = auto()
    TRACE = auto()
    PLAN = auto()
    SHOOT = auto()
    RESUME = auto()
    SERIES = auto()
    FIND = auto()
    BROWSE = auto()
    LOOK = auto()
    CALIBRATE = auto()


@dataclass(frozen=True)
class Start:
    """Effect: start work; its events carry `request_id`."""

    request_id: int
    work: Work
    argument: object = None


@dataclass(frozen=True)
class Cancel:
    """Effect: cancel the work that was started with `request_id`."""

    request_id: int


Effect: TypeAlias = Start | Cancel


class Kind(Enum):
    """The kinds of screen; each gives the keys a meaning."""

    LIST = "list"  # up, down: select; right, enter: take; left, exit: back
    PAGE = "page"  # up, down: scroll; left, right: select a button; enter: do it; exit: back
    WAIT = "wait"  # exit: stop waiting


KEYS = {
    Kind.LIST: ("enter: take", "exit: back", "up/down: select"),
    Kind.PAGE: ("enter: do it", "left/right: select", "up/down: scroll", "exit: back"),
    Kind.WAIT: ("exit: stop",),
}
"""What the keys do on each kind of screen, the most important first."""


@dataclass(frozen=True)
class StateSpec:
    """The properties of a state.

    Attributes:
        kind: kind of screen
        title: first line of the screen, the longest text first, the last at most 14 characters
        actions: the buttons of a page
        work: what starts on entering the state
        tick_s: interval of the ticks that the state gets, s; 0: none
        cursor: the field of `Settings` that holds the selected entry of a list; "": `Model.cursor`
        mood: what lights beside the panel show
    """

    kind: Kind
    title: tuple[str, ...]
    actions: tuple[Action, ...] = ()
    work: Work | None = None
    tick_s: float = 0.0
    cursor: str = ""
    mood: Mood = Mood.READY


_FAILURE = (Action.RETRY, Action.BACK, Action.OTHER)
_P, _L, _W = Kind.PAGE, Kind.LIST, Kind.WAIT
_BUSY, _ERROR = Mood.BUSY, Mood.ERROR
METER_S, LIVE_S = 1.0, 0.1
"""Interval of the readings of the exposure meter, s, and of looks at a live camera: more are no
longer seen one by one (Card, Moran and Newell, 1983)."""
REOPEN_S = 3.0
"""Interval of the attempts to open a camera that is not there, s."""

STATES: dict[State, StateSpec] = {
    State.STARTING: StateSpec(_W, ("Starting",), work=Work.LOAD, mood=_BUSY),
    State.OPENING: StateSpec(_W, ("Opening camera",), work=Work.OPEN, mood=_BUSY),
    State.CAMERA_FAILED: StateSpec(_P, ("No camera",), _FAILURE, tick_s=REOPEN_S, mood=_ERROR),
    State.IDLE: StateSpec(
        _P, ("Ready",), (Action.SET, Action.SHOOT, Action.MENU), Work.METER, METER_S
    ),
    State.RESPONSE: StateSpec(
        _L, ("Desired response", "Response"), work=Work.PREDICT, cursor="response"
    ),
    State.RANGE: StateSpec(_L, ("Dynamic range",), work=Work.PREDICT, cursor="range"),
    State.CUSTOM: StateSpec(_L, ("Custom range",), work=Work.PREDICT, cursor="stops"),
    State.EXPOSURES: StateSpec(_L, ("Exposures",), work=Work.PREDICT, cursor="count"),
    State.BUDGET: StateSpec(_L, ("Time budget",), work=Work.PREDICT, cursor="budget"),
    State.FRONT: StateSpec(_L, ("Time / accuracy", "Time/accuracy"), work=Work.TRACE),
    State.PLANNING: StateSpec(_W, ("Metering",), work=Work.PLAN, mood=_BUSY),
    State.PLAN_FAILED: StateSpec(_P, ("Planning failed", "Plan failed"), _FAILURE, mood=_ERROR),
    State.REVIEW: StateSpec(_P, ("Review",), (Action.SHOOT, Action.TIMER, Action.BACK)),
    State.TIMER: StateSpec(_W, ("Self-timer",), tick_s=1.0, mood=_BUSY),
    State.SHOOTING: StateSpec(_W, ("Shooting",), work=Work.SHOOT, mood=_BUSY),
    State.CANCELLING: StateSpec(_W, ("Cancelling",), mood=_BUSY),
    State.STOPPING: StateSpec(
        _P, ("Still stopping", "Stopping"), (Action.BACK, Action.QUIT), mood=_BUSY
    ),
    State.CANCELLED: StateSpec(
        _P, ("Cancelled",), (Action.BACK, Action.RETRY, Action.CAPTURES), mood=_ERROR
    ),
    State.CAPTURE_FAILED: StateSpec(
        _P, ("Capture failed",), (*_FAILURE, Action.CAPTURES), mood=_ERROR
    ),
    State.RESULT: StateSpec(_P, ("Done",), (Action.AGAIN, Action.BACK)),
    State.MENU: StateSpec(_L, ("Menu",)),
    State.SEARCHING: StateSpec(_W, ("Finding cameras", "Searching"), work=Work.FIND, mood=_BUSY),
    State.SEARCH_FAILED: StateSpec(
        _P, ("Search failed",), (Action.RETRY, Action.BACK), mood=_ERROR
    ),
    State.CAMERAS: StateSpec(_L, ("Camera",)),
    State.BROWSING: StateSpec(_W, ("Reading captures", "Reading"), work=Work.BROWSE, mood=_BUSY),
    State.BROWSE_FAILED: StateSpec(_P, ("Reading failed",), _FAILURE, mood=_ERROR),
    State.CAPTURES: StateSpec(_L, ("Captures",)),
    State.LOOKING: StateSpec(_W, ("Reading capture", "Reading"), work=Work.LOOK, mood=_BUSY),
    State.LOOK_FAILED: StateSpec(_P, ("Reading failed",), _FAILURE, mood=_ERROR),
    State.PAST: StateSpec(_P, ("Capture",), (Action.BACK, Action.MENU)),
    State.RESUMING: StateSpec(_W, ("Resuming",), work=Work.RESUME, mood=_BUSY),
    State.RESUME_FAILED: StateSpec(_P, ("Resume failed",), _FAILURE, mood=_ERROR),
    State.SERIES: StateSpec(_L, ("Series",)),
    State.SERIES_SHOOTING: StateSpec(_W, ("Series runs", "Series"), work=Work.SERIES, mood=_BUSY),
    State.SERIES_FAILED: StateSpec(
        _P, ("Series failed",), (*_FAILURE, Action.CAPTURES), mood=_ERROR
    ),
    State.SEVERAL: StateSpec(_L, ("Several cameras", "Several")),
    State.CALIBRATION: StateSpec(_L, ("Calibration",)),
    State.CALIBRATING: StateSpec(_W, ("Calibrating",), work=Work.CALIBRATE, mood=_BUSY),
    State.CALIBRATION_STOPPING: StateSpec(_W, ("Ending the step", "Ending"), mood=_BUSY),
    State.CALIBRATED: StateSpec(_P, ("Calibrated",), (Action.BACK, Action.MENU)),
    State.CALIBRATION_FAILED: StateSpec(
        _P, ("Calibration failed", "Failed"), _FAILURE, mood=_ERROR
    ),
    State.SETTINGS: StateSpec(_L, ("Settings",)),
    State.ABOUT: StateSpec(_P, ("About",), (Action.BACK,)),
    State.SAVER: StateSpec(_W, ("Press a key",)),
    State.CONFIRM: StateSpec(_P, ("Quit the menu?", "Quit?"), (Action.BACK, Action.QUIT)),
    State.QUIT: StateSpec(_W, ("Ended",)),
}


def _list(
    here: State, back: State, next: State, more: dict[Symbol, State] | None = None
) -> dict[Symbol, State]:
    stay: dict[Symbol, State] = dict.fromkeys((Key.UP, Key.DOWN), here)
    if STATES[here].work is not None:
        stay |= {Outcome.PART: here, Outcome.DONE: here, Outcome.FAILED: here}
    keys: dict[Symbol, State] = {Key.RIGHT: next, Key.ENTER: next, Key.LEFT: back, Key.EXIT: back}
    return {**stay, **keys, Outcome.UNUSED: State.SAVER, **(more or {})}


def _page(here: State, back: State, more: dict[Symbol, State]) -> dict[Symbol, State]:
    stay: dict[Symbol, State] = dict.fromkeys((Key.UP, Key.DOWN, Key.LEFT, Key.RIGHT), here)
    has_back = Action.BACK in STATES[here].actions
    buttons: dict[Symbol, State] = {Action.BACK: back} if has_back else {}
    return {**stay, Key.EXIT: back, Outcome.UNUSED: State.SAVER, **buttons, **more}


def _failure(here: State, retry: State, back: State) -> dict[Symbol, State]:
    known: dict[Symbol, State] = {
        Action.RETRY: retry,
        Action.OTHER: State.SEARCHING,
        Action.CAPTURES: State.BROWSING,
    }
    return _page(here, back, {a: known[a] for a in STATES[here].actions if a in known})


def _wait(here: State, exit: State, done: State, failed: State) -> dict[Symbol, State]:
    stay: dict[Symbol, State] = dict.fromkeys(Key, here)
    return {**stay, Key.EXIT: exit, Outcome.DONE: done, Outcome.FAILED: failed}


def _capture(here: State, exit: State, failed: State) -> dict[Symbol, State]:
    more: dict[Symbol, State] = {Outcome.PART: here, Outcome.CANCELLED: State.CANCELLED}
    return {**_wait(here, exit, State.RESULT, failed), **more}


_S = State
# A page lists its buttons in place of the enter key, which performs the selected one; an entry of a
# list may have an action in place of the next state.  An event that a state does not list is late
# and changes nothing.
TRANSITIONS: dict[State, dict[Symbol, State]] = {
    _S.STARTING: _wait(_S.STARTING, _S.CONFIRM, _S.OPENING, _S.OPENING),
    _S.OPENING: _wait(_S.OPENING, _S.MENU, _S.IDLE, _S.CAMERA_FAILED),
    _S.CAMERA_FAILED: {
        **_failure(_S.CAMERA_FAILED, _S.OPENING, _S.MENU),
        Outcome.TICK: _S.CAMERA_FAILED,
        Outcome.DONE: _S.IDLE,
        Outcome.FAILED: _S.CAMERA_FAILED,
    },
    _S.IDLE: _page(
        _S.IDLE,
        _S.CONFIRM,
        {
            Action.SET: _S.RESPONSE,
            Action.SHOOT: _S.PLANNING,
            Action.MENU: _S.MENU,
            Outcome.TICK: _S.IDLE,
            Outcome.DONE: _S.IDLE,
            Outcome.FAILED: _S.CAMERA_FAILED,
        },
    ),
    _S.RESPONSE: _list(_S.RESPONSE, _S.IDLE, _S.RANGE),
    _S.RANGE: _list(_S.RANGE, _S.RESPONSE, _S.EXPOSURES, {Action.CUSTOM: _S.CUSTOM}),
    _S.CUSTOM: _list(_S.CUSTOM, _S.RANGE, _S.EXPOSURES),
    _S.EXPOSURES: _list(
        _S.EXPOSURES,
        _S.RANGE,
        _S.PLANNING,
        {Action.BUDGET: _S.BUDGET, Action.FRONT: _S.FRONT},
    ),
    _S.BUDGET: _list(_S.BUDGET, _S.EXPOSURES, _S.PLANNING),
    _S.FRONT: _list(_S.FRONT, _S.EXPOSURES, _S.PLANNING),
    _S.PLANNING: _wait(_S.PLANNING, _S.EXPOSURES, _S.REVIEW, _S.PLAN_FAILED),
    _S.PLAN_FAILED: _failure(_S.PLAN_FAILED, _S.PLANNING, _S.EXPOSURES),
    _S.REVIEW: _page(_S.REVIEW, _S.EXPOSURES, {Action.SHOOT: _S.SHOOTING, Action.TIMER: _S.TIMER}),
    _S.TIMER: {
        **dict.fromkeys(Key, _S.TIMER),
        Key.EXIT: _S.REVIEW,
        Outcome.TICK: _S.TIMER,
        Outcome.ELAPSED: _S.SHOOTING,
    },
    _S.SHOOTING: _capture(_S.SHOOTING, _S.CANCELLING, _S.CAPTURE_FAILED),
    _S.CANCELLING: _capture(_S.CANCELLING, _S.STOPPING, _S.CAPTURE_FAILED),
    _S.STOPPING: {
        **_page(_S.STOPPING, _S.CANCELLING, {Action.QUIT: _S.QUIT}),
        Outcome.UNUSED: _S.STOPPING,
        Outcome.PART: _S.STOPPING,
        Outcome.DONE: _S.RESULT,
        Outcome.CANCELLED: _S.CANCELLED,
        Outcome.FAILED: _S.CAPTURE_FAILED,
    },
    _S.CANCELLED: _failure(_S.CANCELLED, _S.PLANNING, _S.IDLE),
    _S.CAPTURE_FAILED: _failure(_S.CAPTURE_FAILED, _S.PLANNING, _S.IDLE),
    _S.RESULT: _page(_S.RESULT, _S.IDLE, {Action.AGAIN: _S.PLANNING}),
    _S.MENU: _list(
        _S.MENU,
        _S.IDLE,
        _S.IDLE,
        {
            Action.SET: _S.RESPONSE,
            Action.CAPTURES: _S.BROWSING,
            Action.OTHER: _S.SEARCHING,
            Action.SERIES: _S.SERIES,
            Action.CALIBRATE: _S.CALIBRATION,
            Action.SETTINGS: _S.SETTINGS,
            Action.ABOUT: _S.ABOUT,
            Action.QUIT: _S.CONFIRM,
        },
    ),
    _S.SEARCHING: _wait(_S.SEARCHING, _S.MENU, _S.CAMERAS, _S.SEARCH_FAILED),
    _S.SEARCH_FAILED: _failure(_S.SEARCH_FAILED, _S.SEARCHING, _S.MENU),
    _S.CAMERAS: _list(_S.CAMERAS, _S.MENU, _S.OPENING, {Action.SEVERAL: _S.SEVERAL}),
    _S.SEVERAL: _list(
        _S.SEVERAL, _S.CAMERAS, _S.SEVERAL, {Action.CHANGE: _S.SEVERAL, Action.START: _S.OPENING}
    ),
    _S.CALIBRATION: _list(_S.CALIBRATION, _S.MENU, _S.CALIBRATING),
    _S.CALIBRATING: {
        **_wait(_S.CALIBRATING, _S.CALIBRATION_STOPPING, _S.CALIBRATED, _S.CALIBRATION_FAILED),
        Outcome.PART: _S.CALIBRATING,
    },
    _S.CALIBRATION_STOPPING: {
        **_wait(_S.CALIBRATION_STOPPING, _S.CALIBRATION, _S.CALIBRATED, _S.CALIBRATION_FAILED),
        Outcome.CANCELLED: _S.CALIBRATION,
    },
    _S.CALIBRATED: _page(_S.CALIBRATED, _S.CALIBRATION, {Action.MENU: _S.MENU}),
    _S.CALIBRATION_FAILED: _failure(_S.CALIBRATION_FAILED, _S.CALIBRATING, _S.CALIBRATION),
    _S.BROWSING: _wait(_S.BROWSING, _S.MENU, _S.CAPTURES, _S.BROWSE_FAILED),
    _S.BROWSE_FAILED: _failure(_S.BROWSE_FAILED, _S.BROWSING, _S.MENU),
    _S.CAPTURES: _list(_S.CAPTURES, _S.MENU, _S.LOOKING, {Action.RESUME: _S.RESUMING}),
    _S.LOOKING: _wait(_S.LOOKING, _S.BROWSING, _S.PAST, _S.LOOK_FAILED),
    _S.LOOK_FAILED: _failure(_S.LOOK_FAILED, _S.LOOKING, _S.BROWSING),
    _S.PAST: _page(_S.PAST, _S.CAPTURES, {Action.MENU: _S.MENU}),
    _S.RESUMING: _capture(_S.RESUMING, _S.CANCELLING, _S.RESUME_FAILED),
    _S.RESUME_FAILED: _failure(_S.RESUME_FAILED, _S.RESUMING, _S.BROWSING),
    _S.SERIES: _list(
        _S.SERIES,
        _S.MENU,
        _S.SERIES,
        {Action.CHANGE: _S.SERIES, Action.START: _S.SERIES_SHOOTING},
    ),
    _S.SERIES_SHOOTING: _capture(_S.SERIES_SHOOTING, _S.CANCELLING, _S.SERIES_FAILED),
    _S.SERIES_FAILED: _failure(_S.SERIES_FAILED, _S.SERIES_SHOOTING, _S.SERIES),
    _S.SETTINGS: _list(_S.SETTINGS, _S.MENU, _S.SETTINGS, {Action.CHANGE: _S.SETTINGS}),
    _S.ABOUT: _page(_S.ABOUT, _S.MENU, {}),
    _S.SAVER: dict.fromkeys(Key, _S.IDLE),
    _S.CONFIRM: _page(_S.CONFIRM, _S.IDLE, {Action.QUIT: _S.QUIT}),
    _S.QUIT: dict.fromkeys(Key, _S.QUIT),
}
