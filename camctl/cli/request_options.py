"""The options of a request: one table of the fields of a `CaptureRequest`, and what reads them.

An option that was not given leaves the default to `camctl.exposure.goal.Goal`.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from camctl.cli.configuration import yield_to_given
from camctl.cli.options import Decorator, all_of, option
from camctl.cli.parameter_types import (
    PATH,
    SCENE,
    SENSOR,
    AnyType,
    DynamicRange,
    FrameSize,
    ListOf,
    Name,
    NameOrFile,
    Number,
    Ratios,
    Seconds,
    SettingOf,
    Truth,
    WholeNumber,
)
from camctl.errors import UsageError
from camctl.exposure.goal import AUTO, CURVE, DEFAULT_COUNT, RANGE_WITHOUT_LIGHT, Goal
from camctl.messages.command_line import OPTIONS
from camctl.model.response.names import RANGES, RESPONSES

if TYPE_CHECKING:
    from camctl.exposure.goal import CaptureRequest
    from camctl.model.response.desired import DesiredResponse

MOST_FOR_TOLERANCE = 6
"""Exposures that a tolerance may take where their number is not given."""

COUNT = WholeNumber(least=1, most=64)
SEARCHED = WholeNumber(least=1, most=16)
LEVELS = Number("a number of levels from 1 to 1e7", least=1, most=1e7)
TOLERANCE = Number("a number of levels of at least 0", least=0)
STOPS = Number("a number of stops from -64 to 64, such as -1 or 0.5", least=-64, most=64)
OBJECTIVE = Name("objective", ("xi", "accuracy"))
RESPONSE = Name("response", RESPONSES)

_RANGES = "|".join(RANGES)
_METER = "Meter with full exposures on a camera that has no preview."


@dataclass(frozen=True)
class RequestOption:
    """The option of one field of a request.

    Attributes:
        help: its text on the help page
        metavar: what stands for its value there; "": it has none
        type: parses the value; None: the option is a flag
        more: other arguments of `click.option`
    """

    help: str
    metavar: str = ""
    type: AnyType | None = None
    more: dict[str, Any] = field(default_factory=dict)


REQUEST_OPTIONS: Final[dict[str, RequestOption]] = {
    "response": RequestOption(
        "How brightness depends on light: log gives equal contrast in shadows and highlights; or a "
        "text file of two columns, irradiance and u (desired brightness), which has its own range."
        f"  [default: {Goal.response}]",
        "|".join((*RESPONSES, "FILE")),
        NameOrFile("response", RESPONSES),
    ),
    "gamma": RequestOption(
        "Exponent of a gamma response, brightness = light^Q; implies --response gamma.  "
        "[default: 0.5]",
        "Q",
        Number("an exponent from 0.01 to 100", least=0.01, most=100),
    ),
    "dynamic_range": RequestOption(
        "Dynamic range of the picture, brightest over darkest light: 256, 1,000, 16,000, or any "
        "NUMBER.  [default: medium]",
        f"{_RANGES}|NUMBER",
        DynamicRange(),
    ),
    "count": RequestOption(
        "Number of exposures.  [default: as many as pay: beyond them, more time brings no more "
        f"than averaging frames does; {DEFAULT_COUNT} where they are chosen by xi]",
        "N",
        COUNT,
    ),
    "objective": RequestOption(
        "Choose exposures by the levels that they miss (xi), or by the least predicted error with "
        "the camera's noise (accuracy): the fastest set among those within 0.5 % of the most "
        "effective levels.",
        "xi|accuracy",
        OBJECTIVE,
    ),
    "accuracy": RequestOption(
        "Reach so many effective levels, noise included, in the least time; the number of "
        "exposures, up to 16, is then chosen too, unless -n is given.",
        "LEVELS",
        Number("a number of effective levels from 1", least=1),
    ),
    "tolerance": RequestOption(
        "Take the fewest exposures, at most 6 or -n, with at most X desired levels missing; needs "
        "--levels.",
        "X",
        TOLERANCE,
    ),
    "time_budget_s": RequestOption(
        "Longest time from the first frame's request until the last frame has arrived; the number "
        "of exposures, up to 16, is then chosen too, unless -n is given.",
        "SECONDS",
        Seconds(),
    ),
    "ratios": RequestOption(
        "Exposures, relative to each other, instead of a search.", "A,B,...", Ratios()
    ),
    "base_s": RequestOption(
        "Shutter time of the shortest exposure, for example 0.004 or 1/250; auto meters it so that "
        "highlights are just below saturation.  [default: auto]",
        "auto|SECONDS",
        Seconds(auto=True),
    ),
    "compensation_stops": RequestOption(
        "Make the shortest exposure longer (or shorter: -1 halves it).  [default: 0]",
        "STOPS",
        STOPS,
    ),
    "clip_percent": RequestOption(
        "Share of the picture, the brightest, that may be saturated in every frame.  [default: "
        "lamps and reflections: at most 0.5 %, if the rest is two stops darker]",
        "PERCENT",
        Number("a percentage from 0 to 50", least=0, most=50),
    ),
    "levels_wanted": RequestOption(
        "Desired number of brightness levels in the picture.  [default: all that the frames "
        "hold together]",
        "G",
        LEVELS,
    ),
    "mains_hz": RequestOption(
        "Frequency in Hz of the mains that power the lamps: prefer whole flicker periods.",
        "50|60",
        Name("mains frequency", ("50", "60")),
    ),
    "use_aperture": RequestOption(
        "Also change the aperture where shutter time and gain do not reach."
    ),
    "spend_shutter": RequestOption(_METER, more={"flag_value": True}),
    "estimate_ratios": RequestOption(
        "Estimate the true exposures from the pixels of the frames, and compute the pictures with "
        "them; for shutters that are not exact, and for light that changes a little."
    ),
}
"""The fields of a request; `messages.command_line.OPTIONS` has their names as options."""

STUDY_OPTIONS: Final[dict[str, RequestOption]] = {
    "counts": RequestOption("Numbers of exposures.", "N,...", ListOf(SEARCHED, unique=True)),
    "responses": RequestOption("Desired responses.", "NAME,...", ListOf(RESPONSE, unique=True)),
    "scene": RequestOption("Scene before the simulated camera.", "NAME|FILE", SCENE),
    "sensor": RequestOption("Sensor of the simulated camera.", "NAME|FILE.json", SENSOR),
    "size": RequestOption(
        "Size of a frame in pixels.  [default: the sensor's, or the radiance map's]",
        "WIDTHxHEIGHT",
        FrameSize(),
    ),
    "workers": RequestOption(
        "Number of processes; the Dask cluster that $DASK_SCHEDULER_ADDRESS names takes their "
        "place.  [default: one per processor]",
        "N",
        WholeNumber(least=1, most=256),
    ),
}
"""Options that several studies and tables have."""

NAMES: Final = {
    "count": "-n --exposures",
    "counts": "-n --exposures",
    "levels_wanted": "--levels",
    "mains_hz": "--mains",
    "objective": "--objective",
    "tolerance": "--tolerance",
}
"""Names of options that have two, or another one where they are no setting of --set."""

#: Light of a scene decides the range unless it is given, and may decide the response.
WITH_LIGHT: Final = {
    "dynamic_range": RequestOption(
        "Dynamic range of the picture, brightest over darkest light: 256, 1,000, 16,000, or any "
        "NUMBER; auto takes what the scene holds.  [default: auto]",
        f"{_RANGES}|auto|NUMBER",
        DynamicRange(auto=True),
    ),
    "response": RequestOption(
        "How brightness depends on light: log gives equal contrast in shadows and highlights, auto "
        "gives most levels to the brightnesses that are most frequent in the scene; or a text file "
        "of two columns, irradiance and u (desired brightness), which has its own range.  "
        f"[default: {Goal.response}]",
        "|".join((*RESPONSES, AUTO, "FILE")),
        NameOrFile("response", (*RESPONSES, AUTO)),
    ),
}

SETTINGS: Final[dict[str, tuple[str, AnyType]]] = {
    "aperture": ("use_aperture", Truth()),
    "levels": ("levels_wanted", LEVELS),
    "mains": ("mains_hz", Name("mains frequency", ("50", "60"))),
    "objective": ("objective", OBJECTIVE),
    "table": ("table", PATH),
    "tolerance": ("tolerance", TOLERANCE),
}
"""Settings of --set, and the field of the request that each is."""

_SET = option(
    "--set NAME=VALUE",
    "Setting of the request that is needed less often; may be given several times: mains=50 "
    "or 60 prefers whole flicker periods, aperture=yes also changes the aperture, "
    "objective=xi or accuracy says what exposures are chosen by, table=FILE looks them up there, "
    "levels=G desires G brightness levels, and tolerance=X takes the fewest exposures that leave "
    "X of them out.",
    SettingOf(SETTINGS),
    field="settings",
    multiple=True,
)


class RequestOptions(dict[str, Any]):
    """The options of a request that were given, by the fields of the request."""

    @property
    def table(self) -> Path | None:
        """File of the exposure table that was given."""
        return self.get("table")

    def fields(self) -> dict[str, Any]:
        """Return the fields of a `CaptureRequest`, with what they imply.

        Raises:
            UsageError: two of the options contradict each other
            DataError: the file of a desired response is invalid
        """
        values = {name: value for name, value in self.items() if name != "table"}
        if "mains_hz" in values:
            values["mains_hz"] = float(values["mains_hz"])
        if self._is_curve():
            from camctl.model.response.measured import read_columns, read_desired

            file = values["response"]
            values["dynamic_range"] = read_desired(file).dynamic_range
            values["desired_curve"] = tuple(zip(*read_columns(file, "u"), strict=True))
            values["response"] = CURVE
        elif "gamma" in values and values.setdefault("response", "gamma") != "gamma":
            raise UsageError(
                f"--gamma cannot be combined with --response {values['response']}",
                hint="leave one of them out",
            )
        if "ratios" in values:
            self._check_ratios(values)
        elif "tolerance" in values:
            values.setdefault("count", MOST_FOR_TOLERANCE)
        if self.table is not None:
            values.setdefault("dynamic_range", RANGE_WITHOUT_LIGHT)
        return values

    def request(self) -> CaptureRequest:
        """Return the request; raise as `fields` does, or `UsageError` for its values."""
        from camctl.exposure.goal import CaptureRequest

        return CaptureRequest(**self.fields())

    def desired(self) -> DesiredResponse:
        """Return the desired response where no light is metered; raise as `fields` does."""
        if self._is_curve():
            from camctl.model.response.measured import read_desired

            return read_desired(self["response"])
        named = {name: self.fields().get(name) for name in ("response", "gamma", "dynamic_range")}
        goal = Goal(**{name: value for name, value in named.items() if value is not None})
        return goal.over(goal.given_range or RANGE_WITHOUT_LIGHT)

    def _is_curve(self) -> bool:
        """Return whether the response is a file, which nothing else of a response goes with."""
        if self.get("response", AUTO) in (*RESPONSES, AUTO):
            return False
        for name in ("gamma", "dynamic_range"):
            if name in self:
                raise UsageError(
                    f"--response FILE cannot be combined with {OPTIONS[name]}",
                    hint="the file defines response and range",
                )
        return True

    def _check_ratios(self, values: dict[str, Any]) -> None:
        """Let given ratios say the number of exposures."""
        count = len(values["ratios"])
        if values.setdefault("count", count) != count:
            raise UsageError(
                f"--ratios has {count} exposures but -n is {values['count']}", hint="leave -n out"
            )
        for name in ("table", "tolerance", "time_budget_s", "objective", "accuracy"):
            if name in self:
                raise UsageError(
                    f"--ratios cannot be combined with {OPTIONS[name].rstrip('=')}",
                    hint="leave one of them out",
                )
        if values.get("response") == AUTO:
            raise UsageError(
                "--ratios cannot be combined with --response auto", hint="name a response"
            )


def request_options(*fields: str, has_light: bool = False, **more: Any) -> Decorator:
    """Return a decorator that adds options of `REQUEST_OPTIONS`, and passes them as `request`.

    Args:
        fields: of the request; "settings" is --set
        has_light: light of a scene decides what is not given
        more: other help texts, by field
    """
    table = {**REQUEST_OPTIONS, **(WITH_LIGHT if has_light else {}), **more}

    def decorate(function: Any) -> Any:
        @functools.wraps(function)
        def call(*arguments: Any, **values: Any) -> Any:
            given = {name: values.pop(name) for name in fields}
            yield_to_given(given, click.get_current_context())
            given |= _once(given.pop("settings", ()))
            request = RequestOptions(
                (name, value)
                for name, value in given.items()
                if value is not None and value is not False
            )
            return function(*arguments, request=request, **values)

        return all_of(*(_option(name, table[name]) for name in fields if name != "settings"))(
            _SET(call) if "settings" in fields else call
        )

    return decorate


def _once(settings: tuple[tuple[str, Any], ...]) -> dict[str, Any]:
    """Return the settings of --set by field; raise `UsageError` where one is given twice."""
    if len(dict(settings)) < len(settings):
        raise UsageError("a setting of --set is given twice", hint="give it once")
    return dict(settings)


def _option(name: str, asked: RequestOption, **more: Any) -> Decorator:
    names = NAMES.get(name) or OPTIONS.get(name, f"--{name.replace('_', '-')}")
    return option(
        f"{names} {asked.metavar}".strip(),
        asked.help,
        asked.type,
        field=name,
        **asked.more,
        **more,
    )


def named(field: str, text: str = "", kind: AnyType | None = None, **more: Any) -> Decorator:
    """Return the option of a request or of several studies, as one argument of a command.

    Args:
        field: of `REQUEST_OPTIONS` or `STUDY_OPTIONS`
        text: another help text
        kind: another type
        more: other arguments of `click.option`
    """
    asked = {**REQUEST_OPTIONS, **STUDY_OPTIONS}[field]
    return _option(field, replace(asked, help=text or asked.help, type=kind or asked.type), **more)
