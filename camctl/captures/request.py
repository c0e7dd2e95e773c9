"""What a user asks of a capture (`CaptureRequest`), and the plan made from it (`CapturePlan`)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any

import numpy as np

from camctl.controls import ExposureSetting
from camctl.errors import DataError, UsageError, unknown_name
from camctl.exposure.effective import check_count
from camctl.response.desired import (
    RESPONSES,
    DesiredResponse,
    desired_response,
    tabulated_desired,
)

AUTO = "auto"
CURVE = "curve"


@dataclass(frozen=True)
class CaptureRequest:
    """What a user asks of a capture; everything else is looked up, metered or measured.

    Attributes:
        response: desired response: "linear", "gamma", "log" (constant contrast), "curve" (given
            by `desired_curve`), or "auto" (follows the metered histogram)
        dynamic_range: desired dynamic range, > 1; a curve has its own, and this one is not used
        count: number of exposures, 1 to 16
        ratios: the exposures, relative to each other, instead of looked-up ones; `count` is not
            used then
        base_s: shutter time of the shortest exposure, s; None: metered
        compensation_stops: shift of the shortest exposure, in stops
        levels_wanted: number of levels G of the desired camera; None: as many as the frames hold
        tolerance: take the fewest exposures, `count` at most, that leave no more than this number
            of `levels_wanted` missing
        time_budget_s: longest total exposure time of all frames, s
        use_aperture: change the aperture where shutter time and gain do not reach
        mains_hz: frequency of the mains that feeds the lamps (50 or 60); None: daylight
        spend_shutter: meter with full exposures on a camera that has no preview
        gamma: exponent of the response "gamma", 0.01 to 100; None: 1/2
        desired_curve: samples (irradiance, u) of the response "curve", at least two, in ascending
            order of irradiance (> 0); both are scaled to end at 1, and u to begin at 0

    Raises:
        UsageError: a value is out of its range, or two fields contradict each other
    """

    response: str = "log"
    dynamic_range: float = 1000.0
    count: int = 3
    ratios: tuple[float, ...] | None = None
    base_s: float | None = None
    compensation_stops: float = 0.0
    levels_wanted: float | None = None
    tolerance: float | None = None
    time_budget_s: float | None = None
    use_aperture: bool = False
    mains_hz: float | None = None
    spend_shutter: bool = False
    gamma: float | None = None
    desired_curve: tuple[tuple[float, float], ...] | None = None

    def __post_init__(self) -> None:
        self._normalise()
        self._check_types()
        self._check_response()
        self._check_numbers()
        self._check_combinations()

    @property
    def desired(self) -> DesiredResponse | None:
        """The desired response; None where the metered light decides it (response "auto")."""
        if self.response == AUTO:
            return None
        return build_desired(self.response, self.dynamic_range, self.gamma, self.desired_curve)

    def _normalise(self) -> None:
        """Turn lists and arrays into the tuples of plain numbers that a report can hold."""
        if self.ratios is not None and not isinstance(self.ratios, str):
            with suppress(TypeError):
                object.__setattr__(self, "ratios", tuple(_plain(ratio) for ratio in self.ratios))
        if self.desired_curve is not None:
            try:
                pairs = tuple((float(E), float(u)) for E, u in self.desired_curve)
            except (TypeError, ValueError):
                raise UsageError(
                    "invalid desired curve: expected pairs of irradiance and brightness"
                ) from None
            object.__setattr__(self, "desired_curve", pairs)

    def _check_types(self) -> None:
        if not isinstance(self.count, Integral):
            raise UsageError(f"invalid number of exposures {self.count!r}: expected a whole number")
        for name in (
            "dynamic_range",
            "base_s",
            "compensation_stops",
            "levels_wanted",
            "tolerance",
            "time_budget_s",
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
        if self.response == AUTO and not 1 < self.dynamic_range < math.inf:
            raise UsageError(
                f"invalid dynamic range {self.dynamic_range:g}: expected a finite number above 1"
            )
        if self.response == AUTO:
            return
        try:
            build_desired(self.response, self.dynamic_range, self.gamma, self.desired_curve)
        except DataError as error:
            raise UsageError(error.what, hint=error.hint) from error

    def _check_numbers(self) -> None:
        check_count(self.count)
        if self.ratios is not None:
            if not self.ratios:
                raise UsageError("no exposure ratios: expected at least one, such as 1,2,4")
            for ratio in self.ratios:
                _check_positive("exposure ratio", ratio)
        for name, value in (
            ("base exposure in seconds", self.base_s),
            ("number of levels", self.levels_wanted),
            ("time budget in seconds", self.time_budget_s),
            ("mains frequency", self.mains_hz),
        ):
            if value is not None:
                _check_positive(name, value)
        if not math.isfinite(self.compensation_stops):
            raise UsageError(
                f"invalid compensation {self.compensation_stops}: expected a finite number of stops"
            )
        if self.tolerance is not None and not self.tolerance >= 0:
            raise UsageError(
                f"invalid tolerance {self.tolerance:g}: expected a number of levels from 0"
            )

    def _check_combinations(self) -> None:
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
        if self.response == AUTO and self.base_s is not None:
            raise UsageError(
                "an automatic response needs metering, and the base exposure is given",
                hint="leave the base exposure (--base) out, or choose another response",
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


def relative_exposures(settings: Sequence[ExposureSetting]) -> tuple[float, ...]:
    """Return the exposures of settings relative to the smallest, in the order of `settings`."""
    smallest = min(setting.exposure for setting in settings)
    return tuple(setting.exposure / smallest for setting in settings)


@dataclass(frozen=True)
class Metering:
    """How much light there is.

    Attributes:
        limit_s: shutter time at which the highlights would be just below saturation, s
        setting: the setting of the last metering frame, the nearest to `limit_s`
        highlight: brightness of the highlights in it, as a share of white minus black
        clipped: share of its samples that are saturated
        frames: number of metering frames (previews, or exposures of the shutter)
    """

    limit_s: float
    setting: ExposureSetting
    highlight: float
    clipped: float
    frames: int


@dataclass(frozen=True)
class CapturePlan:
    """The settings that will be shot, and the result that they should give.

    Attributes:
        response: name of the desired response
        dynamic_range: desired dynamic range
        ratios: the requested exposures, relative to the shortest
        settings: the settings of the camera in the order of shooting, ascending exposure
        exposures: the exposures of `settings` relative to the smallest, same order
        base_s: shutter time of the smallest exposure, s
        shutter_s: total exposure time, s
        levels_wanted: number of levels G of the desired camera
        xi: number of those levels that are missing with `exposures`
        effective_levels: number of equal steps in the desired response that would be as accurate
        metering: how the shortest exposure was metered; None where it was given
        curve: samples (irradiance, u) of the responses "curve" and "auto"; None for the others,
            which name, range and gamma define
        warnings: what to know before shooting, one line each
        gamma: exponent of the response "gamma"; None: 1/2
    """

    response: str
    dynamic_range: float
    ratios: tuple[float, ...]
    settings: tuple[ExposureSetting, ...]
    exposures: tuple[float, ...]
    base_s: float
    shutter_s: float
    levels_wanted: float
    xi: float
    effective_levels: float
    metering: Metering | None = None
    curve: tuple[tuple[float, float], ...] | None = None
    warnings: tuple[str, ...] = ()
    gamma: float | None = None

    @property
    def desired(self) -> DesiredResponse:
        """The desired response that was planned for."""
        return build_desired(self.response, self.dynamic_range, self.gamma, self.curve)
