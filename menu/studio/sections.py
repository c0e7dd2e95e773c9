"""The sections of the page, in the order of its bar.

To add one: a line in `SECTIONS`, its routes in a module beside this one, and ``static/NAME.js``.
"""

from __future__ import annotations

from camctl.menu.model import State
from camctl.menu.studio.section import Section

SECTIONS = (
    Section(
        "live",
        "Camera",
        (State.IDLE, State.STARTING, State.OPENING, State.CAMERA_FAILED, State.SAVER),
    ),
    Section("look", "Look", (State.RESPONSE, State.RANGE, State.CUSTOM)),
    Section("time", "Time", (State.FRONT, State.EXPOSURES, State.BUDGET)),
    Section(
        "shoot",
        "Shoot",
        (
            State.PLANNING,
            State.PLAN_FAILED,
            State.REVIEW,
            State.TIMER,
            State.SHOOTING,
            State.CANCELLING,
            State.STOPPING,
            State.CANCELLED,
            State.CAPTURE_FAILED,
            State.RESUMING,
            State.RESUME_FAILED,
        ),
    ),
    Section(
        "captures",
        "Captures",
        (
            State.BROWSING,
            State.CAPTURES,
            State.BROWSE_FAILED,
            State.LOOKING,
            State.LOOK_FAILED,
            State.PAST,
            State.RESULT,
        ),
    ),
    Section(
        "settings",
        "Settings",
        (
            State.SETTINGS,
            State.MENU,
            State.SEARCHING,
            State.CAMERAS,
            State.SEARCH_FAILED,
            State.ABOUT,
            State.CONFIRM,
            State.QUIT,
        ),
    ),
)
