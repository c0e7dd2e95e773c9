"""The plan of a capture: the settings that will be shot, and the result that they should give."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any

from pydantic import Field

from camctl.exposure.goal import XI, build_desired
from camctl.exposure.light import Metering
from camctl.findings import Finding
from camctl.interface.controls import ExposureSetting
from camctl.messages.plain import sentence
from camctl.model.noise import NoiseModel
from camctl.model.response.desired import DesiredResponse
from camctl.records.html import plan_html

MUCH = 0.05
"""Share of the samples outside the range from which a capture has a finding."""

NEARLY_MUCH = 0.03
"""Metered share from which so many samples may be brighter than the range in the picture."""


@dataclass(frozen=True)
class PlannedLight:
    """The metered light of a scene, and how much of it the picture will hold.

    Attributes:
        span: ratio of the highlights to the light that the darkest hundredth is below
        is_open: whether the shadows are darker than metering could tell: then the scene spans more
        clips: share of the samples that will be saturated in every frame
        clips_stops: how far the brightest of them are above the range, stops
        dark: share of the samples that will be darker than the range, or than the frames can show,
            where the unseen ones are just too dark for the metering; at most `unseen` more are
        needed: the range that would hold the light; larger than the planned one where the camera
            does not hold it at the accuracy asked for
        needed_levels: effective levels that `needed` would have; None where it is planned, or
            where they are not known
        unseen: share of the samples that metering could not tell from black
        is_cut: whether the brightest light saturates the camera's shortest exposure: then, too, the
            scene spans more
    """

    span: float
    is_open: bool
    clips: float
    clips_stops: float
    dark: float
    needed: float
    needed_levels: float | None = None
    unseen: float = 0.0
    is_cut: bool = False

    @property
    def needs_advice(self) -> bool:
        """Whether so much is outside the range that a change of the request may be advised."""
        return self.dark > MUCH or self.unseen > MUCH or self.clips > NEARLY_MUCH


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
        wall_s: predicted time from the request of the first frame until the last one is here, s
        is_wall_known: False where the camera's own times are not known yet, so that `wall_s` is a
            lower bound
        effective_levels_noise_free: effective levels by quantisation alone
        noise: the noise of the camera; None where it is unknown
        light: how much of the scene's light the picture will hold; None where it was not metered
        scene: the light itself, where much of it is outside the range, so that advice can be asked
            for; it is not part of a report
        front: what accuracy costs in time there (`camctl.exposure.search.front.Front`), where the
            settings are a point of it; it is not part of a report
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
    scene: Annotated[Any, Field(exclude=True)] = field(default=None, compare=False, repr=False)
    front: Annotated[Any, Field(exclude=True)] = field(default=None, compare=False, repr=False)

    def _repr_html_(self) -> str:
        """Return the plan for a notebook."""
        return plan_html(self)

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings as plain sentences, one line each."""
        return tuple(sentence(finding) for finding in self.findings)

    @property
    def desired(self) -> DesiredResponse:
        """The desired response that was planned for."""
        return build_desired(self.response, self.dynamic_range, self.gamma, self.curve)
