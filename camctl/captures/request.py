"""What a person asks of a capture, and what was decided from it."""

from __future__ import annotations

from dataclasses import dataclass

from camctl.controls import ExposureSetting
from camctl.response.desired import DesiredResponse, desired_response, tabulated_desired


@dataclass(frozen=True)
class CaptureRequest:
    """What a person picks; everything else is looked up, metered or measured.

    Attributes:
        response: desired response, "linear", "gamma", "log", or "auto": what suits the metered
            histogram
        dynamic_range: desired dynamic range, > 1
        count: number of exposures
        ratios: exposures given instead of looked up, relative to each other; `count` is then theirs
        base_s: shutter time of the shortest exposure, s; None: metered
        compensation_stops: shift of the shortest exposure, in stops
        levels_wanted: number of levels G of the desired camera; None: as many as the frames hold
        tolerance: take the fewest exposures, `count` at most, that leave no more than so many of
            `levels_wanted` missing
        time_budget_s: keep the shutter open no longer than this in all, s
        use_aperture: let the aperture take part where time and gain do not reach
        mains_hz: frequency of the mains that the lamps hang on (50 or 60), None: daylight
        spend_shutter: meter with full exposures on a camera that has no preview
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


@dataclass(frozen=True)
class Metering:
    """How much light there is.

    Attributes:
        limit_s: shutter time at which the highlights would lie just below saturation, s
        setting: the setting nearest to it that was looked through
        highlight: brightness of the highlights there, as a share of white minus black
        clipped: share of the samples that are saturated there
        frames: previews or actuations that it took
    """

    limit_s: float
    setting: ExposureSetting
    highlight: float
    clipped: float
    frames: int


@dataclass(frozen=True)
class CapturePlan:
    """The very exposures that will be shot, and what they should give.

    Attributes:
        response: desired response
        dynamic_range: desired dynamic range
        ratios: the exposures wanted, relative to the shortest
        settings: what the camera will be set to, in the order of shooting, ascending exposure
        exposures: the exposures of `settings` relative to the smallest, same order
        base_s: shutter time of the smallest exposure, s
        shutter_s: time that the shutter is open in all, s
        levels_wanted: number of levels G of the desired camera
        xi: how many of them are missing with `exposures`
        effective_levels: how many equal steps in the desired response are as accurate
        metering: how the shortest exposure was found; None where it was given
        curve: pairs (irradiance, u) of a desired response that follows the scene; None for the
            others, which their name defines
        warnings: what a person should know before pressing the button, one line each
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

    @property
    def desired(self) -> DesiredResponse:
        """The desired camera that was planned for."""
        if self.curve is None:
            return desired_response(self.response, self.dynamic_range)
        irradiance, u = zip(*self.curve, strict=True)
        return tabulated_desired(irradiance, u, name=self.response)
