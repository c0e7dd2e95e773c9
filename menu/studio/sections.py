"""The sections of the page, in the order of its bar.

To add one: a line in `SECTIONS`, its routes in a module beside this one, and ``static/NAME.js``.
"""

from __future__ import annotations

from camctl.menu.model import State
from camctl.menu.studio import captures, merging, pictures, profiles
from camctl.menu.studio.section import Section

SECTIONS = (
    Section(
        "live",
        "Camera",
        (State.IDLE, State.STARTING, State.OPENING, State.CAMERA_FAILED, State.SAVER),
        get={"picture": pictures.seen_picture},
    ),
    Section(
        "look",
        "Look",
        (State.RESPONSE, State.RANGE, State.CUSTOM),
        returns=True,
        get={"picture": pictures.cost_picture},
    ),
    Section(
        "time",
        "Time",
        (State.FRONT, State.EXPOSURES, State.BUDGET),
        returns=True,
        get={"picture": pictures.point_picture},
    ),
    Section(
        "shoot",
        "Plan",
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
            State.SERIES_SHOOTING,
            State.SERIES_FAILED,
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
        returns=True,
        get={
            "files": captures.files,
            "file": captures.file,
            "small": captures.small,
            "light": captures.light,
            "layer": captures.layer,
            "layers": captures.layers,
        },
        post={"delete": captures.delete},
    ),
    Section(
        "merge",
        "Merge",
        get={"responses": merging.responses},
        post={"begin": merging.begin, "file": merging.file, "merge": merging.merge},
    ),
    Section(
        "settings",
        "Settings",
        (
            State.SETTINGS,
            State.SERIES,
            State.MENU,
            State.SEARCHING,
            State.CAMERAS,
            State.SEVERAL,
            State.SEARCH_FAILED,
            State.CALIBRATION,
            State.CALIBRATING,
            State.CALIBRATION_STOPPING,
            State.CALIBRATED,
            State.CALIBRATION_FAILED,
            State.ABOUT,
            State.CONFIRM,
            State.QUIT,
        ),
        returns=True,
        get={"profiles": profiles.profiles, "plot": profiles.plot},
    ),
)
