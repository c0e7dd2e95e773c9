"""The plan of a capture: the settings that will be shot, and the result that they should give."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from camctl.exposure.goal import XI, build_desired
from camctl.findings import Finding
from camctl.interface.controls import ExposureSetting
from camctl.messages.plain import sentence
from camctl.model.noise import NoiseModel
from camctl.model.response.desired import DesiredResponse
from camctl.records.scene_light import PlannedLight


def relative_exposures(settings: Sequence[ExposureSetting]) -> tuple[float, ...]:
    """Return the stated exposures of settings relative to the smallest, in their order."""
    smallest = min(setting.exposure for setting in settings)
    return tuple(setting.exposure / smallest for setting in settings)


@dataclass(frozen=True)
class Metering:
    """How much light there is.

    Attributes:
        limit_s: shutter time at which the highlights that may not clip would be just below
            saturation, s
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
        exposures: the stated exposures of `settings` relative to the smallest, same order; what
            follows counts in the true ones, where they were measured
        base_s: shutter time of the smallest exposure, s
        shutter_s: total exposure time, s
        levels_wanted: number of levels G of the desired camera
        xi: number of those levels that are missing with `exposures`
        effective_levels: number of equal steps in the desired response that would be as accurate,
            with the camera's noise where it is known
        metering: how the shortest exposure was metered; None where it was given
        curve: samples (irradiance, u) of the responses "curve" and "auto"; None for the others,
            which name, range and gamma define
        findings: what to know before shooting
        gamma: exponent of the response "gamma"; None: 1/2
        objective: what the exposures were chosen by, "accuracy" or "xi"
        wall_s: predicted time from the request of the first frame until the last one is here, s;
            None in plans of earlier versions
        is_wall_known: False where the camera's own times are not known yet, so that `wall_s` is a
            lower bound
        effective_levels_noise_free: effective levels by quantisation alone; None in plans of
            earlier versions
        noise: the noise of the camera; None where it is unknown
        light: how much of the scene's light the picture will hold; None where it was not metered
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
    findings: tuple[Finding, ...] = ()
    gamma: float | None = None
    wall_s: float | None = None
    is_wall_known: bool = True
    effective_levels_noise_free: float | None = None
    noise: NoiseModel | None = None
    objective: str = XI
    light: PlannedLight | None = None

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings as plain sentences, one line each."""
        return tuple(sentence(finding) for finding in self.findings)

    @property
    def desired(self) -> DesiredResponse:
        """The desired response that was planned for."""
        return build_desired(self.response, self.dynamic_range, self.gamma, self.curve)
