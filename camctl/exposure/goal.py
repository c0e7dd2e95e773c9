"""What is asked of a picture: a goal; and of a capture: a goal and how to shoot it.

Every front end has these defaults: the command line, Python, merge, table and menu.  Reading them
loads no mathematics: that is imported where a goal is made.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias

from camctl.errors import DataError, UsageError, unknown_name
from camctl.model.response.names import RANGES, RESPONSES

if TYPE_CHECKING:
    from camctl.model.response.desired import DesiredResponse

AUTO: Final = "auto"
CURVE: Final = "curve"
XI, ACCURACY = "xi", "accuracy"
OBJECTIVES = (XI, ACCURACY)

RANGE_WITHOUT_LIGHT = RANGES["medium"]
"""The range "auto" where no light is metered: `solve`, a table, a given base exposure."""

DEFAULT_COUNT = 3
"""Number of exposures where xi chooses them, which cannot tell what time is worth."""

MAX_CLIP_PERCENT = 50.0
"""Largest share of the samples that may be clipped, in percent."""

MIN_TIME_BUDGET_S = 1e-9
"""Shortest time budget, s: far below the shutter times of cameras."""

MAX_COMPENSATION_STOPS = 64.0
"""No camera has so many stops between its shortest and its longest exposure."""

MAINS_HZ = 50.0, 60.0
"""Frequencies of public mains, Hz (IEC 60196)."""

MIN_ACCURACY = 1.0
"""Fewest effective levels that can be asked for: one level does not show the light."""

Range: TypeAlias = float | Literal["auto", "low", "medium", "high"]


@dataclass(frozen=True)
class Goal:
    """What a picture is to be.

    Attributes:
        response: desired response: "linear", "gamma", "log" (constant contrast), "curve" (given
            by `desired_curve`), or "auto" (follows the metered histogram)
        dynamic_range: desired dynamic range, > 1, or "low", "medium", "high"; "auto": the range of
            the metered light, as far as the camera is accurate over it, and `RANGE_WITHOUT_LIGHT`
            where none is metered; a curve has its own, and this one is not used
        count: number of exposures, 1 to 64, by xi to 16; None: chosen by accuracy, as many as are
            best within a time budget or reach an accuracy soonest, otherwise as many as pay: with
            more time, accuracy grows no faster than by averaging; chosen by xi, 3
        gamma: exponent of the response "gamma", 0.01 to 100; None: 1/2
        desired_curve: samples (irradiance, u) of the response "curve", at least two, in ascending
            order of irradiance (> 0); both are scaled to end at 1, and u to begin at 0
        clip_percent: percentage of the samples, the brightest, that may be saturated in every
            frame; None: lamps and reflections, at most 0.5 % and at least two stops brighter than
            the rest, but nothing where the frames are photographs already taken
        levels_wanted: number of levels G of the desired camera; None: as many as the frames hold
        tolerance: take the fewest exposures, `count` at most, that leave no more than this number
            of `levels_wanted` missing
        time_budget_s: longest predicted time from the request of the frames until the last one is
            here, s; see `camctl.exposure.search.wall_time`
        objective: what the exposures are chosen by: "accuracy", least predicted error with the
            camera's noise; "xi", as in the paper; None: accuracy where the noise is known and
            nothing is asked that only xi answers (`tolerance`, `levels_wanted`, `use_aperture`)
        accuracy: effective levels, noise included, to reach in the least time

    Raises:
        UsageError: a value is out of its range, or two fields contradict each other
    """

    response: str = "log"
    dynamic_range: Range = AUTO
    count: int | None = None
    gamma: float | None = None
    desired_curve: tuple[tuple[float, float], ...] | None = None
    clip_percent: float | None = None
    levels_wanted: float | None = None
    tolerance: float | None = None
    time_budget_s: float | None = None
    objective: str | None = None
    accuracy: float | None = None

    def __post_init__(self) -> None:
        self._normalise()
        self._check_response()
        self._check_numbers()
        self._check_combinations()

    @property
    def given_range(self) -> float | None:
        """The desired dynamic range; None where the metered light decides it ("auto")."""
        if self.desired_curve is not None:
            return build_desired(CURVE, math.inf, None, self.desired_curve).dynamic_range
        return None if isinstance(self.dynamic_range, str) else self.dynamic_range

    @property
    def desired(self) -> DesiredResponse | None:
        """The desired response; None where the metered light decides it or its range ("auto")."""
        if self.response == AUTO or self.given_range is None:
            return None
        return self.over(self.given_range)

    def over(self, dynamic_range: float) -> DesiredResponse:
        """Return the desired response over a range; not for the response "auto"."""
        return build_desired(self.response, dynamic_range, self.gamma, self.desired_curve)

    @property
    def clip(self) -> float | None:
        """Share of the samples that may be saturated; None: lamps and reflections."""
        return None if self.clip_percent is None else self.clip_percent / 100

    @property
    def most_exposures(self) -> int:
        """The number of exposures, or how many there are where the goal does not say it."""
        return DEFAULT_COUNT if self.count is None else self.count

    def _normalise(self) -> None:
        """Turn numbers of any type into plain ones, the name of a range into its number."""
        if isinstance(self.dynamic_range, str):
            if self.dynamic_range not in (AUTO, *RANGES):
                raise unknown_name("dynamic range", self.dynamic_range, (AUTO, *RANGES))
            self._set("dynamic_range", RANGES.get(self.dynamic_range, AUTO))
        elif isinstance(self.dynamic_range, Real):
            self._set("dynamic_range", float(self.dynamic_range))
        else:
            raise UsageError(f"invalid dynamic_range {self.dynamic_range!r}: expected a number")
        if self.desired_curve is not None:
            try:
                pairs = tuple((float(E), float(u)) for E, u in self.desired_curve)
            except (TypeError, ValueError):
                raise UsageError(
                    "invalid desired curve: expected pairs of irradiance and brightness"
                ) from None
            self._set("desired_curve", pairs)
        if self.count is not None and not isinstance(self.count, Integral):
            raise UsageError(f"invalid number of exposures {self.count!r}: expected a whole number")
        self._check_types(
            "gamma", "clip_percent", "levels_wanted", "tolerance", "time_budget_s", "accuracy"
        )

    def _set(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    def _check_types(self, *names: str) -> None:
        """Raise `UsageError` where one of the fields is neither a number nor None."""
        for name in names:
            value = getattr(self, name)
            if value is not None and not isinstance(value, Real):
                raise UsageError(f"invalid {name} {value!r}: expected a number")

    def _check_response(self) -> None:
        if self.response not in (*RESPONSES, CURVE, AUTO):
            raise unknown_name("response", self.response, (*RESPONSES, CURVE, AUTO))
        if self.gamma is not None and self.response in (CURVE, AUTO):
            raise UsageError(
                f"gamma {self.gamma:g} does not apply to the response '{self.response}'",
                hint="choose the response 'gamma', or leave gamma out",
            )
        if self.desired_curve is not None and self.response != CURVE:
            raise UsageError(
                f"a desired curve does not apply to the response '{self.response}'",
                hint=f"choose the response '{CURVE}'",
            )
        if self.desired_curve is None and self.response == CURVE:
            raise UsageError(
                f"the response '{CURVE}' needs a desired curve",
                hint="give pairs of irradiance and brightness",
            )
        # Where the light decides the range, any range shows whether the other fields are right.
        given = self.dynamic_range
        dynamic_range = RANGES["high"] if isinstance(given, str) else given
        if self.response == AUTO:
            from camctl.model.response.desired import check_range

            check_range(dynamic_range)
            if math.isinf(dynamic_range):
                raise UsageError("an automatic response needs a finite dynamic range")
            return
        try:
            self.over(dynamic_range)
        except DataError as error:
            raise UsageError(error.what, hint=error.hint, remedies=error.remedies) from error

    def _check_numbers(self) -> None:
        from camctl.model.effective import check_count

        check_count(self.most_exposures)
        if self.objective is not None and self.objective not in OBJECTIVES:
            raise unknown_name("objective", self.objective, OBJECTIVES)
        if self.time_budget_s is not None:
            _check_positive("time budget in seconds", self.time_budget_s)
            if self.time_budget_s < MIN_TIME_BUDGET_S:
                raise UsageError(
                    f"invalid time budget {self.time_budget_s:g} s: expected at least "
                    f"{MIN_TIME_BUDGET_S:g} s"
                )
        if self.accuracy is not None and not MIN_ACCURACY <= self.accuracy < math.inf:
            raise UsageError(
                f"invalid accuracy {self.accuracy:g}: expected a number of effective levels from "
                f"{MIN_ACCURACY:g}"
            )
        if self.levels_wanted is not None:
            from camctl.exposure.objective import check_levels_wanted

            check_levels_wanted(self.levels_wanted)
        if self.clip_percent is not None and not 0 <= self.clip_percent <= MAX_CLIP_PERCENT:
            raise UsageError(
                f"invalid share of clipped samples {self.clip_percent:g} %: expected 0 to "
                f"{MAX_CLIP_PERCENT:g} %"
            )
        if self.tolerance is not None and not self.tolerance >= 0:
            raise UsageError(
                f"invalid tolerance {self.tolerance:g}: expected a number of levels from 0"
            )

    def _check_combinations(self) -> None:
        if self.objective == XI and self.accuracy is not None:
            raise UsageError(
                "an accuracy cannot be reached with the objective 'xi'",
                hint="choose the objective 'accuracy', or leave the accuracy out",
                remedies={"objective": ACCURACY, "accuracy": False},
            )
        if self.accuracy is not None or self.objective == ACCURACY:
            self._refuse_beside("a choice by accuracy", "tolerance", "levels_wanted")
        if self.tolerance is not None:
            if self.levels_wanted is None:
                raise UsageError(
                    "a tolerance needs the number of desired levels",
                    hint="give it as levels_wanted",
                    remedies={"levels_wanted": None},
                )
            if self.time_budget_s is not None or self.response == AUTO:
                raise UsageError(
                    "a tolerance cannot be combined with a time budget or an automatic response",
                    hint="leave one of them out",
                )

    def _refuse_beside(self, what: str, *names: str) -> None:
        """Raise `UsageError` where one of the fields is given beside `what`."""
        for name in names:
            if getattr(self, name) not in (None, False):
                raise UsageError(
                    f"{what} cannot be combined with {name.replace('_', ' ')}",
                    hint="leave one of them out",
                )


@dataclass(frozen=True)
class CaptureRequest(Goal):
    """A goal, and how to shoot it; everything else is looked up, metered or measured.

    The fields of the goal, with their defaults, are the fields of `Goal`.

    Attributes:
        ratios: the exposures, relative to each other, instead of looked-up ones; `count` is not
            used then
        base_s: shutter time of the shortest exposure, s; None: metered
        compensation_stops: shift of the shortest exposure, in stops, -64 to 64
        use_aperture: change the aperture where shutter time and gain do not reach
        estimate_ratios: compute the pictures with exposures estimated from the pixels, where these
            are more certain than what the camera states
        mains_hz: frequency of the mains that feeds the lamps (50 or 60); None: daylight
        spend_shutter: meter with full exposures on a camera that has no preview
        deghost: show places where things moved as one of the frames shows them

    Raises:
        UsageError: a value is out of its range, or two fields contradict each other
    """

    ratios: tuple[float, ...] | None = None
    base_s: float | None = None
    compensation_stops: float = 0.0
    use_aperture: bool = False
    estimate_ratios: bool = False
    mains_hz: float | None = None
    spend_shutter: bool = False
    deghost: bool = False

    def __post_init__(self) -> None:
        self._set("ratios", _plain_numbers(self.ratios))
        self._check_types("base_s", "compensation_stops", "mains_hz")
        super().__post_init__()

    @property
    def given_range(self) -> float | None:
        """The desired dynamic range; None where the metered light decides it ("auto")."""
        given = super().given_range
        return RANGE_WITHOUT_LIGHT if given is None and self.base_s is not None else given

    def _check_numbers(self) -> None:
        super()._check_numbers()
        if self.ratios is not None:
            if not all(isinstance(ratio, Real) for ratio in self.ratios):
                raise UsageError(
                    f"invalid ratios {self.ratios!r}: expected numbers such as (1, 2, 4)"
                )
            if not self.ratios:
                raise UsageError("no exposure ratios: expected at least one, such as 1,2,4")
            for ratio in self.ratios:
                _check_positive("exposure ratio", ratio)
        if self.base_s is not None:
            _check_positive("base exposure in seconds", self.base_s)
        if self.mains_hz is not None and self.mains_hz not in MAINS_HZ:
            raise UsageError(
                f"invalid mains frequency {self.mains_hz:g} Hz: expected 50 or 60",
                hint="give the frequency of the mains, not of the flicker, which is twice as high",
            )
        if not abs(self.compensation_stops) <= MAX_COMPENSATION_STOPS:
            raise UsageError(
                f"invalid compensation {self.compensation_stops:g}: expected "
                f"-{MAX_COMPENSATION_STOPS:g} to {MAX_COMPENSATION_STOPS:g} stops"
            )

    def _check_combinations(self) -> None:
        super()._check_combinations()
        if self.accuracy is not None or self.objective == ACCURACY:
            self._refuse_beside("a choice by accuracy", "ratios", "use_aperture")
        if self.tolerance is not None:
            self._refuse_beside("a tolerance", "ratios")
        if self.response == AUTO:
            self._refuse_beside("an automatic response", "ratios")
        if self.base_s is not None:
            for name, value in (
                ("an automatic response", self.response == AUTO),
                ("a share of clipped samples", self.clip_percent is not None),
            ):
                if value:
                    raise UsageError(
                        f"{name} needs metering, and the base exposure is given",
                        hint="leave the base exposure out, or this",
                        remedies={"base_s": False},
                    )


def _plain_numbers(values: Any) -> Any:
    """Return an iterable of numbers as a tuple, those of numpy as plain ones; else as it is."""
    if values is None or isinstance(values, str):
        return values
    with suppress(TypeError):
        return tuple(each.item() if hasattr(each, "item") else each for each in values)
    return values


def _check_positive(name: str, value: float) -> None:
    """Raise `UsageError` unless a number is positive and finite."""
    if not 0 < value < math.inf:
        raise UsageError(f"invalid {name} {value:g}: expected a positive, finite number")


def build_desired(
    response: str,
    dynamic_range: float,
    gamma: float | None,
    curve: Sequence[tuple[float, float]] | None,
) -> DesiredResponse:
    """Return the desired response that these fields of a goal or a plan describe.

    Raises:
        UsageError: an invalid name, range or exponent, or an exponent for another response
        DataError: an invalid curve
    """
    from camctl.model.response.desired import desired_response
    from camctl.model.response.tabulated import tabulated_desired

    if curve is not None:
        irradiance, u = zip(*curve, strict=True) if curve else ((), ())
        return tabulated_desired(irradiance, u, name=response)
    return desired_response(response, dynamic_range, gamma=gamma)
