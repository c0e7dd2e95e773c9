"""What a capture in each desired response would show of a scene, before anything is shot.

Preview frames from short to long are combined as the frames of a capture are, which gives the
light.  Each response then has a plan of its own, and its picture has the levels, the range and the
noise that the sum of the planned exposures would have.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from camctl.captures.metering import LARGEST_STEP, WAITED_S, meter_light
from camctl.captures.plan import plan_capture
from camctl.captures.response_sheet import PANEL_WIDTH, Panel, response_sheet
from camctl.errors import CaptureError, UsageError
from camctl.evidence.chroma import states_few_chroma_samples
from camctl.evidence.lost_detail import stated_steps
from camctl.evidence.patches import sample_patches
from camctl.exposure.goal import AUTO, CaptureRequest
from camctl.exposure.search.settings import relative_exposures
from camctl.interface.camera import Camera, Frame, PreviewingCamera
from camctl.interface.controls import ExposureControls, ExposureSetting
from camctl.model.effective import EffectiveCamera
from camctl.model.inverse import Posterior, posterior_of
from camctl.model.response.desired import desired_response
from camctl.model.response.names import RESPONSES
from camctl.pictures.accumulator import Accumulator
from camctl.pictures.frame_light import frame_light, parts_of
from camctl.pictures.preview import tone_map
from camctl.pictures.preview_light import ALL, Light, LightReducer
from camctl.pictures.render import DARK, GOOD, SATURATED, Rendering, Tables
from camctl.records.capture_plan import CapturePlan


@dataclass(frozen=True, eq=False)
class ShownResponse:
    """One desired response.

    Attributes:
        name: of the response
        plan: of a capture in it, which was not shot
        dark: share of the samples that would be too dark: by the plan's metered light, as a
            capture predicts it; with a given exposure, which is not metered, in the preview frames
        saturated: share of the samples that would be saturated in every frame, likewise
    """

    name: str
    plan: CapturePlan
    dark: float
    saturated: float


@dataclass(frozen=True, eq=False)
class ResponsePreview:
    """The desired responses beside each other.

    Attributes:
        picture: uint8, (rows, columns, 3), sRGB
        plan: of the response that was asked for; it was not shot
        responses: those that the camera can take, in the order of `RESPONSES`
        settings: of the preview frames
        left_out_s: planned shutter times that are longer than any preview frame, s
    """

    picture: NDArray[np.uint8]
    plan: CapturePlan
    responses: tuple[ShownResponse, ...]
    settings: tuple[ExposureSetting, ...]
    left_out_s: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class PreviewedLight:
    """The light that preview frames show, and what captures would make of it.

    Attributes:
        light: small, E = 1 saturates `exposure`
        exposure: the shortest of the preview frames
        controls: of the camera
    """

    light: Light
    exposure: float
    controls: ExposureControls

    @classmethod
    def of(cls, camera: Camera, settings: tuple[ExposureSetting, ...]) -> Self:
        """Take preview frames, and return the light that they give."""
        controls = camera.controls
        frames = list(_frames(camera, settings))
        pixels = [each.pixels for each in frames]
        total = Accumulator(pixels[0].shape, pixels[0].dtype, len(settings), controls.white)
        for each in pixels:
            total.accumulate(each)
        noise, exposures = controls.frame_noise(settings), relative_exposures(settings)
        responses = controls.responses or (controls.levels,)
        # Down to the light from which on a sample is rounded to its first level.
        least = float(controls.levels.levels[0]) / 2 / max(exposures)
        desired = desired_response("log", 1 / least)
        posteriors = [
            posterior_of(EffectiveCamera.of(each, exposures), desired, noise) for each in responses
        ]
        tables = tuple(map(Tables.of, posteriors))
        light = frame_light(
            parts_of(controls.layout, responses),
            exposures,
            noise if controls.noise else None,
            [sample_patches(controls.layout.planes(each), controls.white) for each in pixels],
            black=controls.black,
            unit=1.0,
            gains=[each.gain for each in settings],
            prior=desired,
            few_chroma_samples=states_few_chroma_samples(each.details for each in frames),
            stated_steps=stated_steps([each.details for each in frames]),
        )
        rendering = Rendering(
            controls.layout,
            tables,
            desired,
            light,
            lambda place, rows: pixels[place][rows],
            len(pixels),
            controls.hot_pixels,
        )
        rows, columns = total.total.shape[:2]
        reducer = LightReducer(rows, columns, rendering.full, 2 * PANEL_WIDTH)
        for render in rendering.strips(total.total):
            reducer.add(render())
        found = reducer.light()
        # What no preview frame shows is as bright as it probably is: longer ones are planned.
        unseen = min(float(each.inverse.E[each.sum.black]) for each in posteriors)
        shown = replace(found, irradiance=np.maximum(found.irradiance, np.float32(unseen)))
        return cls(shown, min(setting.exposure for setting in settings), controls)

    def panel(self, name: str, plan: CapturePlan) -> Panel:
        """Return what a capture by `plan` would make of the light."""
        light = self.light
        posterior, _, sums = self._sums(plan)
        table, inverse = Tables.of(posterior), posterior.inverse
        irradiance, mask = inverse.E.astype(np.float32)[sums], table.mask[sums]
        noise = np.minimum(inverse.deviation[sums] / irradiance, 1.0).astype(np.float32)
        white = light.white.copy()
        white[(mask == SATURATED).all(axis=2)] = ALL

        unlit = _shares(sums <= posterior.sum.black)
        seen = Light(
            irradiance,
            np.where(mask == GOOD, np.maximum(noise, light.noise), light.noise),
            np.maximum(light.saturated, _shares(mask == SATURATED)),
            _shares(mask == DARK),
            np.maximum(unlit, light.unlit),
            white,
        )
        # Preview frames are shorter than the planned ones: noise moves light out of the range.
        metered = plan.light
        stored = (table.code[sums] >> 8).astype(np.uint8)
        return Panel(
            name,
            "",
            plan=plan,
            picture=tone_map(seen),
            stored=stored[..., 0] if stored.shape[2] == 1 else stored,
            dark=float((mask == DARK).mean()) if metered is None else metered.dark,
            saturated=float((mask == SATURATED).mean()) if metered is None else metered.clips,
        )

    def _sums(self, plan: CapturePlan) -> tuple[Posterior, NDArray[np.float32], NDArray[np.intp]]:
        """Return the posterior of a plan, the light for it, and the sums without noise."""
        camera = EffectiveCamera.of(self.controls.levels, relative_exposures(plan.settings))
        posterior = posterior_of(camera, plan.desired, self.controls.frame_noise(plan.settings))
        E = self.light.irradiance * np.float32(plan.settings[0].exposure / self.exposure)
        return posterior, E, posterior.sum.black + np.searchsorted(camera.levels, E, side="right")

    def noisy_picture(self, plan: CapturePlan) -> NDArray[np.uint8]:
        """Return the picture in the desired response with the noise of one capture by `plan`.

        The shape is that of the light, (rows, columns, channels), sRGB as image.tiff.
        """
        posterior, E, sums = self._sums(plan)
        noise = np.random.default_rng(0).standard_normal(E.shape, np.float32)
        E = np.clip(E + posterior.inverse.deviation[sums] * noise, 0.0, 1.0)
        return (255 * plan.desired.u(E) + 0.5).astype(np.uint8)


def preview_responses(camera: Camera, request: CaptureRequest) -> ResponsePreview:
    """Meter, plan each response as a capture would, take preview frames, and show each response.

    Raises:
        UsageError: the camera has no preview, and `request` allows no actuations of the shutter
        CaptureError: the light cannot be metered, or no plan meets the request
    """
    if not (isinstance(camera, PreviewingCamera) or request.spend_shutter):
        raise UsageError(
            f"{camera.info.id} has no preview, and a frame would cost a shutter actuation",
            hint="allow them",
            remedies={"spend_shutter": True},
        )
    scene = meter_light(camera, request)
    plan = plan_capture(camera, request, light=scene)
    plans: dict[str, CapturePlan | str] = {}
    for name in RESPONSES:
        try:
            other = _in_response(request, name, plan)
            plans[name] = plan if other == request else plan_capture(camera, other, light=scene)
        except (UsageError, CaptureError) as error:
            plans[name] = error.what
    possible = [each for each in plans.values() if isinstance(each, CapturePlan)]
    longest = max(setting.exposure for each in (plan, *possible) for setting in each.settings)
    settings = preview_settings(camera.controls, plan.settings[0], longest)
    light = PreviewedLight.of(camera, settings)
    shown, panels = [], []
    for name, each in plans.items():
        if isinstance(each, str):
            panels.append(Panel(name, each))
            continue
        panel = light.panel(name, each)
        panels.append(panel)
        shown.append(ShownResponse(name, each, panel.dark, panel.saturated))
    times = {setting.time_s for each in possible for setting in each.settings}
    left_out = tuple(sorted(time_s for time_s in times if time_s > settings[-1].time_s))
    picture = response_sheet(
        panels, settings, left_out, is_range_given=request.given_range is not None
    )
    return ResponsePreview(picture, plan, tuple(shown), settings, left_out)


def preview_settings(
    controls: ExposureControls, shortest: ExposureSetting, longest: float
) -> tuple[ExposureSetting, ...]:
    """Return the settings of the preview frames, ascending.

    They go from the shortest exposure that is planned to the exposure `longest`, or as near to it
    as a frame of `WAITED_S` comes with the camera's highest gain.
    """
    time, gain = controls.time_s, controls.gain
    most_s = max(shortest.time_s, min(WAITED_S, time.maximum))
    ratio = longest / shortest.exposure
    ratio = min(ratio, most_s / shortest.time_s * gain.maximum / shortest.gain)
    count = max(1, math.ceil(math.log(ratio) / math.log(LARGEST_STEP))) if ratio > 1 else 1
    found = [shortest]
    for place in range(1, count + 1):
        factor = ratio ** (place / count)
        time_s = time.nearest(min(shortest.time_s * factor, most_s))
        each = gain.nearest(max(shortest.gain, shortest.gain * shortest.time_s * factor / time_s))
        setting = replace(shortest, time_s=time_s, gain=each)
        if setting.exposure > found[-1].exposure:
            found.append(setting)
    return tuple(found)


def _in_response(request: CaptureRequest, name: str, plan: CapturePlan) -> CaptureRequest:
    """Return the request for another response; a range that is endless becomes an automatic one."""
    if request.response == name:
        return request
    given = request.given_range
    dynamic_range: float | Literal["auto"] = "auto"
    if given is not None and math.isfinite(given):
        dynamic_range = given
    if request.base_s is not None and dynamic_range == AUTO:
        dynamic_range = plan.desired.dynamic_range
    gamma = request.gamma if name == "gamma" else None
    return replace(
        request, response=name, dynamic_range=dynamic_range, desired_curve=None, gamma=gamma
    )


def _frames(camera: Camera, settings: tuple[ExposureSetting, ...]) -> Iterator[Frame]:
    if isinstance(camera, PreviewingCamera):
        yield from map(camera.preview, settings)
        return
    with closing(camera.shoot(list(settings))) as frames:
        yield from frames


def _shares(flags: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return the share of the channels of each pixel, `ALL` for all of them."""
    return np.asarray(flags.mean(axis=2) * ALL, np.uint8)
