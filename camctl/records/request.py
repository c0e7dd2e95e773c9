"""What a user asks of a capture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any, Literal

import numpy as np

from camctl.errors import DataError, UsageError, unknown_name
from camctl.model.effective import check_count
from camctl.model.response.desired import (
    RANGES,
    RESPONSES,
    DesiredResponse,
    check_range,
    desired_response,
)
from camctl.model.response.tabulated import tabulated_desired

MAX_COMPENSATION_STOPS = 64.0
"""No camera has so many stops between its shortest and its longest exposure."""

MAX_CLIP_PERCENT = 50.0
"""Largest share of the samples that may be clipped, in percent."""

AUTO = "auto"
CURVE = "curve"

MIN_TIME_BUDGET_S = 1e-9
"""Shortest time budget, s: far below the shutter times of cameras."""

MIN_ACCURACY = 1.0
"""Fewest effective levels that can be asked for: one level knows nothing of the light."""

XI, ACCURACY = "xi", "accuracy"
OBJECTIVES = (XI, ACCURACY)

DEFAULT_COUNT = 3
"""Number of exposures where neither a request nor what it asks for decides it."""


@dataclass(frozen=True)
class CaptureRequest:
    """What a user asks of a capture; everything else is looked up, metered or measured.

    Attributes:
        response: desired response: "linear", "gamma", "log" (constant contrast), "curve" (given
            by `desired_curve`), or "auto" (follows the metered histogram)
        dynamic_range: desired dynamic range, > 1, or "auto": the range of the metered light, as
            far as the camera is accurate over it, which is the default of the command line but not
            of this class; a curve has its own, and this one is not used
        clip_percent: percentage of the samples, the brightest, that may be saturated in every
            frame; None: lamps and reflections, at most 0.5 % and at least two stops brighter than
            the rest
        count: number of exposures, 1 to 16; None: as many as are best within a time budget or reach
            an accuracy (up to 6, chosen by accuracy), otherwise 3
        ratios: the exposures, relative to each other, instead of looked-up ones; `count` is not
            used then
        base_s: shutter time of the shortest exposure, s; None: metered
        compensation_stops: shift of the shortest exposure, in stops, -64 to 64
        levels_wanted: number of levels G of the desired camera; None: as many as the frames hold
        tolerance: take the fewest exposures, `count` at most, that leave no more than this number
            of `levels_wanted` missing
        time_budget_s: longest predicted time from the request of the frames until the last one is
            here, s; see `camctl.captures.wall_time`
        objective: what the exposures are chosen by: "accuracy", least predicted error with the
            camera's noise; "xi", as in the paper; None: accuracy where the noise is known and
            nothing is asked that only xi answers (`tolerance`, `levels_wanted`, `use_aperture`)
        accuracy: effective levels, noise included, to reach in the least time
        use_aperture: change the aperture where shutter time and gain do not reach
        estimate_ratios: compute the pictures with exposures estimated from the pixels, where these
            are more certain than what the camera states
        mains_hz: frequency of the mains that feeds the lamps (50 or 60); None: daylight
        spend_shutter: meter with full exposures on a camera that has no preview
        gamma: exponent of the response "gamma", 0.01 to 100; None: 1/2
        desired_curve: samples (irradiance, u) of the response "curve", at least two, in ascending
            order of irradiance (> 0); both are scaled to end at 1, and u to begin at 0

    Raises:
        UsageError: a value is out of its range, or two fields contradict each other
    """

    response: str = "log"
    dynamic_range: float | Literal["auto"] = 1000.0
    count: int | None = None
    ratios: tuple[float, ...] | None = None
    base_s: float | None = None
    compensation_stops: float = 0.0
    levels_wanted: float | None = None
    tolerance: float | None = None
    time_budget_s: float | None = None
    objective: str | None = None
    accuracy: float | None = None
    use_aperture: bool = False
    estimate_ratios: bool = False
    mains_hz: float | None = None
    spend_shutter: bool = False
    gamma: float | None = None
    desired_curve: tuple[tuple[float, float], ...] | None = None
    clip_percent: float | None = None

    def __post_init__(self) -> None:
        self._normalise()
        self._check_types()
        self._check_response()
        self._check_numbers()
        self._check_combinations()

    @property
    def desired(self) -> DesiredResponse | None:
        """The desired response; None where the metered light decides it or its range ("auto")."""
        if self.response == AUTO or self.given_range is None:
            return None
        return build_desired(self.response, self.given_range, self.gamma, self.desired_curve)

    @property
    def given_range(self) -> float | None:
        """The desired dynamic range; None where the metered light decides it ("auto")."""
        if self.desired_curve is not None:
            return build_desired(CURVE, math.inf, None, self.desired_curve).dynamic_range
        return None if isinstance(self.dynamic_range, str) else self.dynamic_range

    @property
    def clip(self) -> float | None:
        """Share of the samples that may be saturated; None: lamps and reflections."""
        return None if self.clip_percent is None else self.clip_percent / 100

    @property
    def most_exposures(self) -> int:
        """The number of exposures, or how many there are where the request does not say it."""
        return DEFAULT_COUNT if self.count is None else self.count

    def _normalise(self) -> None:
        """Turn lists and arrays into the tuples of plain numbers that a report can hold."""
        if type(self.dynamic_range) is int:
            object.__setattr__(self, "dynamic_range", float(self.dynamic_range))
        if self.ratios is not None and not isinstance(self.ratios, str):
            with suppress(TypeError):
                object.__setattr__(self, "ratios", tuple(_plain(ratio) for ratio in self.ratios))
        if isinstance(self.dynamic_range, Real):
            object.__setattr__(self, "dynamic_range", float(self.dynamic_range))
        if self.desired_curve is not None:
            try:
                pairs = tuple((float(E), float(u)) for E, u in self.desired_curve)
            except (TypeError, ValueError):
                raise UsageError(
                    "invalid desired curve: expected pairs of irradiance and brightness"
                ) from None
            object.__setattr__(self, "desired_curve", pairs)

    def _check_types(self) -> None:
        if self.count is not None and not isinstance(self.count, Integral):
            raise UsageError(f"invalid number of exposures {self.count!r}: expected a whole number")
        if isinstance(self.dynamic_range, str) and self.dynamic_range != AUTO:
            raise UsageError(
                f"invalid dynamic_range {self.dynamic_range!r}: expected a number or '{AUTO}'"
            )
        for name in (
            *(() if self.dynamic_range == AUTO else ("dynamic_range",)),
            "clip_percent",
            "base_s",
            "compensation_stops",
            "levels_wanted",
            "tolerance",
            "time_budget_s",
            "accuracy",
            "mains_hz",
            "gamma",
        ):
            value = getattr(self, name)
            if value is not None and not isinstance(value, Real):
                raise UsageError(f"invalid {name} {value!r}: expected a number")
        if self.ratios is not None and not all(isinstance(ratio, Real) for ratio in self.ratios):
            raise UsageError(f"invalid ratios {self.ratios!r}: expected numbers such as (1, 2, 4)")

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
            check_range(dynamic_range)
            if math.isinf(dynamic_range):
                raise UsageError("an automatic response needs a finite dynamic range")
            return
        try:
            build_desired(self.response, dynamic_range, self.gamma, self.desired_curve)
        except DataError as error:
            raise UsageError(error.what, hint=error.hint) from error

    def _check_numbers(self) -> None:
        check_count(self.most_exposures)
        if self.objective is not None and self.objective not in OBJECTIVES:
            raise unknown_name("objective", self.objective, OBJECTIVES)
        if self.ratios is not None:
            if not self.ratios:
                raise UsageError("no exposure ratios: expected at least one, such as 1,2,4")
            for ratio in self.ratios:
                _check_positive("exposure ratio", ratio)
        for name, value in (
            ("base exposure in seconds", self.base_s),
            ("time budget in seconds", self.time_budget_s),
            ("mains frequency", self.mains_hz),
        ):
            if value is not None:
                _check_positive(name, value)
        if self.time_budget_s is not None and self.time_budget_s < MIN_TIME_BUDGET_S:
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
            from camctl.exposure.objective import check_levels_wanted  # loads the mathematics

            check_levels_wanted(self.levels_wanted)
        if not abs(self.compensation_stops) <= MAX_COMPENSATION_STOPS:
            raise UsageError(
                f"invalid compensation {self.compensation_stops:g}: expected "
                f"-{MAX_COMPENSATION_STOPS:g} to {MAX_COMPENSATION_STOPS:g} stops"
            )
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
                hint="choose the objective 'accuracy', or leave the accuracy (--accuracy) out",
            )
        if self.accuracy is not None or self.objective == ACCURACY:
            for name in ("ratios", "tolerance", "levels_wanted", "use_aperture"):
                if getattr(self, name) is not None and getattr(self, name) is not False:
                    raise UsageError(
                        f"a choice by accuracy cannot be combined with {name.replace('_', ' ')}",
                        hint="leave one of them out",
                    )
        if self.tolerance is not None:
            if self.levels_wanted is None:
                raise UsageError(
                    "a tolerance needs the number of desired levels",
                    hint="give it with levels_wanted (--levels)",
                )
            if self.time_budget_s is not None or self.response == AUTO:
                raise UsageError(
                    "a tolerance cannot be combined with a time budget or an automatic response",
                    hint="leave one of them out",
                )
            if self.ratios is not None:
                raise UsageError(
                    "a tolerance cannot be combined with given exposure ratios",
                    hint="leave one of them out",
                )
        if self.response == AUTO and self.ratios is not None:
            raise UsageError(
                "an automatic response cannot be combined with given exposure ratios",
                hint="choose another response, or leave the ratios out",
            )
        if self.base_s is not None:
            for name, value in (
                ("an automatic response", self.response == AUTO),
                ("an automatic range", self.given_range is None),
                ("a share of clipped samples", self.clip_percent is not None),
            ):
                if value:
                    raise UsageError(
                        f"{name} needs metering, and the base exposure is given",
                        hint="leave the base exposure (--base) out, or this",
                    )


def _plain(value: Any) -> Any:
    """Return a number of numpy as one of Python; anything else as it is."""
    return value.item() if isinstance(value, np.generic) else value


def _check_positive(name: str, value: float) -> None:
    if not 0 < value < math.inf:
        raise UsageError(f"invalid {name} {value:g}: expected a positive, finite number")


def build_desired(
    response: str,
    dynamic_range: float,
    gamma: float | None,
    curve: Sequence[tuple[float, float]] | None,
) -> DesiredResponse:
    """Return the desired response that these fields of a request or a plan describe.

    Raises:
        UsageError: an invalid name, range or exponent, or an exponent for another response
        DataError: an invalid curve
    """
    if curve is not None:
        irradiance, u = zip(*curve, strict=True) if curve else ((), ())
        return tabulated_desired(irradiance, u, name=response)
    return desired_response(response, dynamic_range, gamma=gamma)
