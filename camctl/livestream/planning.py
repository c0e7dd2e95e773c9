"""The exposures of a live camera: chosen within the time of a result, and when they do not fit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.captures.metering import OUTLIER_SHARE, TARGET_SHARE, meter_light
from camctl.captures.plan import plan_for
from camctl.errors import CaptureError, UsageError
from camctl.evidence.noise import fit_noise
from camctl.evidence.patches import sample_patches
from camctl.evidence.ratio_check import MOST
from camctl.exposure.goal import AUTO, CURVE, DEFAULT_COUNT, XI, CaptureRequest
from camctl.exposure.light import LAMP_SHARE, Light, Metering
from camctl.exposure.search.best import Search
from camctl.exposure.search.ranges import STOPS
from camctl.exposure.search.settings import at_most
from camctl.exposure.search.wall_time import predicted_wall_s
from camctl.findings import Detail, Finding
from camctl.interface.camera import Camera, Frame
from camctl.interface.controls import (
    Choices,
    Control,
    ExposureControls,
    ExposureSetting,
    Layout,
    Steps,
)
from camctl.interface.cycle import ComposingCamera
from camctl.livestream.tables import SumTable
from camctl.model.noise import NoiseModel
from camctl.model.response.camera import FloatArray
from camctl.pictures.render import DARK
from camctl.records.capture_plan import MUCH, CapturePlan

#: Samples of which the histogram is made, about: 1e-4 of them are 26.
_SAMPLES = 1 << 18
#: Change of the highlights, stops, from which other exposures are worth their exchange: the range
#: of a picture is chosen in whole stops.
_STOPS = 0.5
#: Change of the share of samples that are darker than the range.
_DARK_SHARE = MUCH
#: Factor by which the shortest exposure is shortened where the highlights are not known.
_SHORTENING = 4.0
#: Looks in a row that have to show another light.
_LOOKS = 2


@dataclass(frozen=True, eq=False)
class Look:
    """The light of a window.

    Attributes:
        irradiance: ascending, E = 1 saturates the base exposure
        shares: of the samples that have it
        highlight: E that no more than `OUTLIER_SHARE` of the samples exceed
        clipped: share of the samples that are saturated in every frame
        dark: share of the samples that are darker than the desired range
        unseen: share of the samples in which no light can be told from black
    """

    irradiance: FloatArray
    shares: FloatArray
    highlight: float
    clipped: float
    dark: float
    unseen: float = 0.0

    @property
    def is_cut(self) -> bool:
        """Whether highlights are saturated in every frame."""
        return self.clipped > OUTLIER_SHARE

    @property
    def is_well_placed(self) -> bool:
        """Whether the highlights are just below saturation; lamps may be above it."""
        is_low = self.highlight < TARGET_SHARE / 2**_STOPS
        return not is_low and self.clipped <= 2 * LAMP_SHARE

    @classmethod
    def at(
        cls, total: NDArray[np.unsignedinteger], layout: Layout, tables: Sequence[SumTable]
    ) -> Look:
        """Return the light of the sum of a window."""
        planes = layout.planes(total)
        step = max(1, math.isqrt(total.size // _SAMPLES))
        colours = {Layout.MONO: "G", Layout.RGB: "RGB"}.get(layout, layout.value.upper())
        lights, counts, highlights, clipped, dark, unseen = [], [], [], 0, 0, 0
        for plane, colour in zip(planes, colours, strict=True):
            table = tables["RGB".index(colour) if len(tables) > 1 else 0]
            found = np.bincount(plane[::step, ::step].ravel(), minlength=table.E.size)
            found = found[: table.E.size].astype(np.float64)
            above = np.cumsum(found[::-1])[::-1]
            brightest = int(np.flatnonzero(above > OUTLIER_SHARE * above[0])[-1])
            highlights.append(float(table.E[brightest]))
            clipped += found[-1]
            dark += found[table.below].sum()
            unseen += found[table.mask == DARK].sum()
            kept = found > 0
            lights.append(table.E[kept])
            counts.append(found[kept])
        light, number = np.concatenate(lights), np.concatenate(counts)
        order, samples = np.argsort(light, kind="stable"), number.sum()
        return cls(
            light[order],
            number[order] / samples,
            max(highlights),
            float(clipped / samples),
            float(dark / samples),
            float(unseen / samples),
        )

    def light(self, controls: ExposureControls, settings: Sequence[ExposureSetting]) -> Light:
        """Return the light for a plan, as `camctl.captures.metering.meter_light` does."""
        ordered = sorted(settings, key=controls.exposure)
        shortest, longest = ordered[0], ordered[-1]
        # How bright saturated light is, is not known.
        factor = _SHORTENING if self.is_cut else 1.0
        irradiance = np.where(
            self.irradiance >= self.highlight, factor * self.irradiance, self.irradiance
        )
        whole = self.highlight / TARGET_SHARE * factor
        times = controls.time_s
        limit_s = min(max(shortest.time_s / whole, times.minimum), times.maximum)
        unit = shortest.time_s / limit_s
        span = controls.exposure(longest) / controls.exposure(shortest)
        darkest = float(controls.levels.levels[0]) / span / unit
        return Light(
            Metering(limit_s, shortest, min(self.highlight, 1.0), self.clipped, len(settings)),
            np.maximum(irradiance / unit, darkest / 2),
            self.shares,
            darkest,
            brightest=min(1.0, factor * self.highlight / unit),
            last=longest,
        )


class Following:
    """Says when exposures have to be chosen anew."""

    def __init__(self) -> None:
        self._accepted: Look | None = None
        self._others = 0
        self._is_final = False

    def accept(self, look: Look | None, *, is_final: bool = False) -> None:
        """The exposures were chosen for this light.

        Args:
            look: as the exposures show it; None: the next one that is looked at
            is_final: whether there are none that suit it better
        """
        self._accepted, self._others, self._is_final = look, 0, is_final

    def is_other(self, look: Look) -> bool:
        """Return whether another light was seen often enough."""
        if self._accepted is None:
            self.accept(look)
            return False
        accepted = self._accepted
        change = math.log2(max(look.highlight, 1e-12) / max(accepted.highlight, 1e-12))
        is_other = (
            abs(change) > _STOPS
            or look.is_cut != accepted.is_cut
            or abs(look.dark - accepted.dark) > _DARK_SHARE
            or (not self._is_final and not look.is_well_placed)
        )
        self._others = self._others + 1 if is_other else 0
        return self._others >= _LOOKS


DEFAULT_FPS = 10.0
"""Results a second where nobody says how many: with fewer, pictures are no longer seen as movement
(Card, Moran and Newell, The Psychology of Human-Computer Interaction, 1983: 0.1 s)."""

#: Cameras send some frames fewer than they announce: NTSC rates are 0.1 % lower.
_RATE_TOLERANCE = 0.02


class LivePlanner:
    """Chooses the exposures of a cycle.

    Args:
        camera: an open camera
        request: what the user asks for
        fps: results a second at least; None: `DEFAULT_FPS`, or as many as the camera has

    Attributes:
        request: with the number of exposures
        controls: of the camera, with times that leave enough results a second

    Raises:
        UsageError: the camera sends fewer frames, or no camera meets the request
    """

    def __init__(self, camera: Camera, request: CaptureRequest, fps: float | None) -> None:
        controls = camera.controls
        interval_s = _below(camera, ())[0].frame_interval_s
        if fps is None:
            fps = min(DEFAULT_FPS, 1 / interval_s if interval_s else DEFAULT_FPS)
        elif not 0 < fps < 1e6:
            raise UsageError(f"invalid rate {fps:g}: expected results a second, such as 10")
        elif interval_s * fps > 1 + _RATE_TOLERANCE:
            raise UsageError(
                f"{fps:g} results a second need as many frames, and the camera sends "
                f"{1 / interval_s:.3g}",
                hint="ask for fewer results, or set a higher frame rate of the camera",
            )
        self.fps = fps
        self.controls = replace(controls, time_s=_up_to(camera, 1 / fps))
        by_light = request.accuracy is None and request.time_budget_s is None
        if request.count is None and by_light:
            # Each frame of a camera that composes its frames has several exposures.
            count = 1 if isinstance(camera, ComposingCamera) else DEFAULT_COUNT
            request = replace(request, count=count)
        if request.objective is None and by_light:
            # The search by accuracy takes seconds, in which the light changes.
            request = replace(request, objective=XI)
        self.request = request
        self._search = Search(self.controls, request, None, None)
        self._camera = camera

    def first(self) -> CapturePlan:
        """Return a plan by metering frames, no longer than those of the stream may be.

        Raises as `plan_capture` does.
        """
        return self._plan(meter_light(self._camera, self._search.request, self.controls))

    def again(self, light: Light) -> CapturePlan:
        """Return a plan for the light that the stream shows; raises as `plan_capture` does."""
        if self.request.base_s is not None:
            return self._plan(None)
        return self._plan(light.limited(self._search.request, self._camera.controls))

    def _plan(self, light: Light | None) -> CapturePlan:
        try:
            plan = plan_for(self.controls, self._search, light, self._camera.controls)
        except CaptureError as error:
            raise type(error)(
                f"{error.what}, with {self.fps:g} results a second",
                hint=error.hint,
                remedies=error.remedies,
            ) from error
        longest = _longest_s(self._camera, plan.settings)
        if longest * self.fps > 1 + _RATE_TOLERANCE:
            raise UsageError(
                f"an exposure of {longest:.3g} s leaves fewer than {self.fps:g} results a second",
                hint="ask for fewer results, or for shorter exposures",
            )
        return replace(plan, findings=self._findings(plan))

    def _findings(self, plan: CapturePlan) -> tuple[Finding, ...]:
        """Return those of a plan, and one on exposures that the rate shortens.

        A camera that composes its frames may have shortened its own before.
        """
        of_camera = self._camera.controls.findings
        before, own = (
            next((each for each in some if each.code == "base_shortened"), None)
            for some in (of_camera, [each for each in plan.findings if each not in of_camera])
        )
        if own is None or self.controls.time_s == self._camera.controls.time_s:
            return plan.findings
        details = own.details | {"results_per_second": self.fps}
        if before is not None and before.value is not None and own.value is not None:
            stops = float(before.details["stops"] or 0.0) + math.log2(before.value / own.value)
            details |= {"stops": stops}
        others = (each for each in plan.findings if each.code != "base_shortened")
        return (*others, own.model_copy(update={"details": details}))

    def light_findings(self, look: Look, dynamic_range: float) -> list[Finding]:
        """Return what of the light is out of reach of a range, and what would reach it."""
        details: dict[str, Detail] = {"dynamic_range": dynamic_range, "photographs": False}
        found = []
        if look.clipped > MUCH:
            found.append(Finding(code="light_above_range", value=look.clipped, details=details))
        if look.dark > MUCH:
            remedies, more = self._wider(look, dynamic_range)
            found.append(
                Finding(
                    code="light_below_range",
                    value=look.dark,
                    details=details | more,
                    remedies=remedies,
                )
            )
        return found

    def _wider(self, look: Look, dynamic_range: float) -> tuple[dict[str, Any], dict[str, Detail]]:
        """Return what shows more of the dark: another range, or where light is not seen, time."""
        if look.unseen <= MOST * look.dark:
            if self.request.response == CURVE:
                return {"desired_curve": None}, {}
            if self.request.base_s is not None:
                return {"base_s": False, "dynamic_range": AUTO}, {}
            if self.request.dynamic_range != AUTO:
                return {"dynamic_range": AUTO}, {}
            for larger in (each for each in STOPS if each > dynamic_range):
                left = float(look.shares[look.irradiance < 1 / larger].sum())
                if left <= MOST * look.dark:
                    return {"dynamic_range": larger}, {"left": left} if left > MUCH else {}
        if self.controls.time_s.maximum < self._camera.controls.time_s.maximum:
            return {"fps": None}, {}
        return {}, {}

    def rate(self, settings: Sequence[ExposureSetting]) -> float:
        """Return the results a second of a cycle: those of a round, over the time that it takes."""
        controls, each = _below(self._camera, settings)
        once, twice = (predicted_wall_s(controls, (*each,) * rounds) for rounds in (1, 2))
        return len(each) / (twice - once)


def _below(
    camera: Camera, settings: Sequence[ExposureSetting]
) -> tuple[ExposureControls, Sequence[ExposureSetting]]:
    """Return controls and settings of the camera each of whose frames completes a result."""
    while isinstance(camera, ComposingCamera):
        settings, camera = camera.settings_below(settings), camera.camera
    return camera.controls, settings


def _longest_s(camera: Camera, settings: Sequence[ExposureSetting]) -> float:
    """Return the shutter time of the longest frame of a cycle, s."""
    return max(setting.time_s for setting in _below(camera, settings)[1])


def _up_to(camera: Camera, longest_s: float) -> Control:
    """Return the shutter times whose frames are no longer than a limit, or the shortest alone."""
    times = camera.controls.time_s
    if isinstance(camera, ComposingCamera):
        assert isinstance(times, Choices)  # it has planned sets of exposures alone
        longest_of = {each: _longest_s(camera, [ExposureSetting(each)]) for each in times.values}
        limit_s = longest_s * (1 + _RATE_TOLERANCE)
        short = tuple(each for each in times.values if longest_of[each] <= limit_s)
        return Choices(short or (times.minimum,))
    longest = at_most(times, longest_s)
    if isinstance(times, Choices):
        return Choices(tuple(each for each in times.values if each <= longest))
    return Steps(times.minimum, longest, times.step)


def measured_noise(controls: ExposureControls, frames: Sequence[Frame]) -> NoiseModel | None:
    """Return the noise that the frames of a window show; None where they do not show it."""
    planes = [controls.layout.planes(frame.pixels) for frame in frames]
    patches = [sample_patches(each, controls.white) for each in planes]
    exposures = [controls.exposure(frame.applied) for frame in frames]
    shortest = min(exposures)
    gains = [frame.applied.gain for frame in frames]
    relative = [each / shortest for each in exposures]
    every = np.ones(len(patches[0]), np.bool_)
    fit = fit_noise(controls.levels, patches, relative, gains, controls.black, every)
    if fit is None:
        return None
    inverse, square = fit.noise.tolist()
    electrons = 1 / inverse if inverse > 0 else None
    conversion = electrons or 1.0
    read = (max(square, 0.0) + fit.compression_levels**2) ** 0.5
    return NoiseModel(conversion, ((1.0, read * conversion),), photon_noise=electrons is not None)
