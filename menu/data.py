"""What the menu knows of cameras, costs, plans and results: plain values, without numpy.

The first screen is there before the controller is loaded, so that nothing here imports it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Settings:
    """What is kept from one start to the next; the defaults are those of a request.

    Attributes:
        response: index of the entry of `camctl.menu.entries.RESPONSES`
        range: index of the entry of `camctl.menu.entries.RANGES`
        stops: index of the entry of `camctl.menu.entries.STOPS`, for the custom range
        count: index of the entry of `camctl.menu.entries.COUNTS`
        budget: index of the entry of `camctl.menu.entries.BUDGETS`
        timer: index of the entry of `camctl.menu.entries.TIMERS`
        saver: index of the entry of `camctl.menu.entries.SAVERS`
        mains: index of the entry of `camctl.menu.entries.MAINS`
        metering: index of the entry of `camctl.menu.entries.METERINGS`
        interval: index of the entry of `camctl.menu.entries.INTERVALS`
        repeat: index of the entry of `camctl.menu.entries.REPEATS`
        camera: id of the camera that was chosen last; "": the camera of the command line
    """

    response: int = 0
    range: int = 3
    stops: int = 6
    count: int = 0
    budget: int = 3
    timer: int = 1
    saver: int = 1
    mains: int = 0
    metering: int = 0
    interval: int = 4
    repeat: int = 2
    camera: str = ""


@dataclass(frozen=True)
class Loaded:
    """What was found at the start: the settings, and a remark on them, "" if they are right."""

    settings: Settings
    remark: str = ""
    unfinished: int = 0


@dataclass(frozen=True)
class CameraEntry:
    """A camera that can be opened, and what it is called."""

    id: str
    name: str


@dataclass(frozen=True)
class Choice:
    """What the user selected.

    Attributes:
        response: desired response, one of `camctl.model.response.desired.RESPONSES`, or "auto"
        dynamic_range: desired dynamic range, brightest over darkest; None: the range of the scene
        count: number of exposures; None: as many as pay
        time_budget_s: longest time of the capture, s
        mains_hz: frequency of the mains that feeds the lamps; None: daylight
        spend_shutter: a camera without preview may meter with full exposures
    """

    response: str
    dynamic_range: float | None
    count: int | None = None
    time_budget_s: float | None = None
    mains_hz: float | None = None
    spend_shutter: bool = False


@dataclass(frozen=True)
class SeriesChoice:
    """A series that the user selected.

    Attributes:
        choice: of each picture
        count: number of pictures
        interval_s: from the start of one to the start of the next, s; None: at once
    """

    choice: Choice
    count: int
    interval_s: float | None


@dataclass(frozen=True)
class Picture:
    """A small picture: `rgb` holds 3 bytes a pixel, row by row."""

    columns: int
    rows: int
    rgb: bytes = field(repr=False)


@dataclass(frozen=True)
class Cost:
    """The price and the benefit of one choice with the camera that is open.

    Attributes:
        count: number of exposures
        shutter_s: total exposure time, s; relative to the shortest exposure if `is_relative`
        wall_s: about how long the capture takes, s; None: unknown
        effective_levels: number of equal steps in the desired response that are as accurate, with
            the camera's noise where it is known
        noise_known: whether the noise is known
        is_relative: the light was not metered
        dynamic_range: the one that is planned
        is_recommended: beyond it more time pays no more than averaging does
        problem: why the choice is impossible; the other fields are not used then
        frames: text of each setting, where they are listed
        draw: returns what the scene would look like; None: it is not known
    """

    count: int = 0
    shutter_s: float = 0.0
    wall_s: float | None = None
    effective_levels: float = 0.0
    noise_known: bool = False
    is_relative: bool = False
    dynamic_range: float = 0.0
    is_recommended: bool = False
    problem: str = ""
    frames: tuple[str, ...] = ()
    draw: Callable[[], Picture] | None = None


@dataclass(frozen=True)
class Rival:
    """A bracket that cameras offer, to compare the points of the front with.

    Attributes:
        count: frames
        stops: between one frame and the next
        wall_s: about how long it takes, s
        effective_levels: as those of `Cost`
    """

    count: int
    stops: int
    wall_s: float
    effective_levels: float


@dataclass(frozen=True)
class Traced:
    """What accuracy costs in time.

    Attributes:
        points: of ascending time and accuracy
        rivals: brackets of fixed steps, where a page shows them
    """

    points: tuple[Cost, ...]
    rivals: tuple[Rival, ...] = ()


@dataclass(frozen=True)
class Reading:
    """What the exposure meter shows.

    Attributes:
        time_s: shutter time at which the highlights are just below saturation, s
        clipped: share of the samples that are saturated in the metering frame
        histogram: shares of the samples by brightness, dark to bright
        picture: the metering frame
        free_bytes: free space where captures are kept
        camera: the camera that was metered
        is_late: it has no preview, and the light is metered when the capture is planned
        remark: why the light cannot be measured; "" where it can
        rate: pictures a second of the effective camera, live; None: it is a metering frame
        battery_percent, free_images, lens, mode: charge of the camera's battery, room on its card,
            lens and mode dial, after it was opened or took pictures; None: it does not state them
        focus: how sharp the middle of the picture is, see `camctl.menu.thumbnails.focus_value`
        focus_percent: the same, of the sharpest since the camera was opened; None: unknown
    """

    time_s: float = 0.0
    clipped: float = 0.0
    histogram: tuple[float, ...] = ()
    picture: Picture | None = None
    free_bytes: int = 0
    camera: CameraEntry | None = None
    is_late: bool = False
    remark: str = ""
    rate: float | None = None
    battery_percent: int | None = None
    free_images: int | None = None
    lens: str | None = None
    mode: str | None = None
    focus: float | None = None
    focus_percent: int | None = None


@dataclass(frozen=True)
class Plan:
    """The settings that will be shot, and the result that they should give.

    Attributes:
        frames: text of each setting and its exposure relative to the shortest
        shutter_s: total exposure time, s
        wall_s: predicted time of the capture, s; None: unknown
        is_wall_known: whether it is more than a lower bound
        effective_levels: as in `Cost`
        effective_levels_noise_free: the same by quantisation alone
        noise_known: whether the noise is known
        xi, levels_wanted: number of desired levels that are missing, and of all of them
        dynamic_range: the desired one, as planned
        warnings: what to know before shooting, one line each
        needed_bytes, free_bytes: space that the capture takes, and that is free
        handle: what the job shoots
    """

    frames: tuple[tuple[str, float], ...]
    shutter_s: float
    wall_s: float | None
    is_wall_known: bool
    effective_levels: float
    effective_levels_noise_free: float | None
    noise_known: bool
    xi: float
    levels_wanted: float
    dynamic_range: float
    warnings: tuple[str, ...] = ()
    needed_bytes: int = 0
    free_bytes: int = 0
    handle: object = field(default=None, repr=False)


@dataclass(frozen=True)
class Progress:
    """How far a capture is: `done` of `total` in a stage; `share` of its time is over, 0 to 1.

    A calibration has the name of its step as the stage, and in `lines` the results so far.
    """

    done: int
    total: int
    stage: str
    share: float = 0.0
    lines: tuple[str, ...] = ()


@dataclass(frozen=True)
class Calibrated:
    """What a calibration has measured, one line for each step."""

    lines: tuple[str, ...]


@dataclass(frozen=True)
class Summary:
    """The result of a capture.

    Attributes:
        effective_levels: achieved with the exposures that the camera applied, with its noise where
            that is known
        effective_levels_noise_free: the same by quantisation alone
        noise_known: whether the noise is known
        planned_levels: the effective levels that were planned; None: they cannot be compared, as
            the plan knew no noise
        saturated: share of the samples that are saturated in every frame, 0 to 1
        folder: folder of the files
        notes: warnings, one line each
        untrustworthy_because: why the pictures are wrong; "" where nothing shows that they are
        histogram: shares of the samples in equal steps of ln E, dark to bright
        picture: a small version of the picture
    """

    effective_levels: float
    effective_levels_noise_free: float | None
    noise_known: bool
    planned_levels: float | None
    saturated: float
    folder: str
    notes: tuple[str, ...] = ()
    untrustworthy_because: str = ""
    histogram: tuple[float, ...] = ()
    picture: Picture | None = None


@dataclass(frozen=True)
class Past:
    """A capture in the folder of captures: its name, and whether frames are missing."""

    name: str
    is_complete: bool
