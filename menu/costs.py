"""What choices cost with a camera, and pictures of what they would give."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Self

from camctl.errors import CaptureError, InterruptedCaptureError, UsageError
from camctl.exposure.brackets import OFFERED, bracket
from camctl.exposure.goal import AUTO, CaptureRequest
from camctl.interface.camera import Camera, Frame, PreviewingCamera
from camctl.interface.controls import ExposureSetting
from camctl.menu.data import Cost, Picture, Rival, Traced
from camctl.menu.thumbnails import sampled_picture
from camctl.menu.views import setting_text

if TYPE_CHECKING:  # the idle menu does not load what captures are made with
    from camctl.captures.response_preview import PreviewedLight
    from camctl.exposure.search.front import Front, FrontPoint
    from camctl.records.capture_plan import CapturePlan

_PREVIEW_S, _PREVIEW_AGE_S = 1.0, 30.0
"""Longest preview frame for pictures of choices, s: they are waited for, as the exposure meter is;
and the time for which they serve the next choice, too."""
_PREVIEW_SIDE = 480
"""Pixels of the longest side of such a picture: half a phone's width, two device pixels each."""


class Costs:
    """Costs of choices.

    Args:
        has_pictures: whether they have pictures of what they would give, and rivals
    """

    def __init__(self, *, has_pictures: bool) -> None:
        self._has_pictures = has_pictures
        self._previewed: PreviewedLight | None = None
        self._previewed_until_s = -math.inf

    def forget(self) -> None:
        """Forget the light of the camera, which is no longer open."""
        self._previewed_until_s = -math.inf

    def of(self, camera: Camera, request: CaptureRequest, cancelled: Callable[[], bool]) -> Cost:
        """Return the cost of the plan of a request; raises `CameraError`."""
        is_relative = not isinstance(camera, PreviewingCamera) and request.base_s is None
        if is_relative:  # any base exposure shows the relative ones
            if AUTO in (request.response, request.dynamic_range):
                return Cost(problem="known once the light is metered")
            base_s = camera.controls.time_s.nearest(1 / 60)
            request = replace(request, base_s=base_s)
        try:
            plan = planned(camera, request, cancelled)
        except (UsageError, CaptureError) as error:
            return Cost(problem=error.what)
        shutter_s = plan.shutter_s / plan.base_s if is_relative else plan.shutter_s
        draw = None
        if (light := self._previewed_light(camera, plan)) is not None:
            shown = light.panel(plan.response, plan).stored
            draw = None if shown is None else partial(sampled_picture, shown, _PREVIEW_SIDE)
        return Cost(
            len(plan.settings),
            shutter_s,
            None if is_relative else plan.wall_s,
            plan.effective_levels,
            plan.noise is not None,
            is_relative,
            draw=draw,
        )

    def trace(
        self, camera: Camera, request: CaptureRequest, cancelled: Callable[[], bool]
    ) -> Traced:
        """Return the most accurate settings for each time, and brackets to compare them with.

        The brackets are there for a page only, as are the pictures.

        Raises:
            UsageError: the noise of the camera is unknown
        """
        plan = planned(camera, request, cancelled)
        light = self._previewed_light(camera, plan)
        front = plan.front
        if front is None:
            raise UsageError(
                "the noise of this camera is unknown, and with it what accuracy costs",
                remedies={"calibrate_noise": None},
            )

        def point_cost(point: FrontPoint) -> Cost:
            draw = None
            if light is not None:
                draw = partial(_noisy_picture, light, replace(plan, settings=point.settings))
            return Cost(
                point.n,
                sum(setting.time_s for setting in point.settings),
                point.time_s,
                point.levels,
                noise_known=True,
                dynamic_range=plan.dynamic_range,
                is_recommended=point == front.recommended,
                frames=tuple(map(setting_text, point.settings)),
                draw=draw,
            )

        points = tuple(map(point_cost, front.points))
        return Traced(points, () if not self._has_pictures else tuple(_rivals(front, cancelled)))

    def _previewed_light(self, camera: Camera, plan: CapturePlan) -> PreviewedLight | None:
        """Return the light for pictures of choices, of preview frames that are not old."""
        if not self._has_pictures or not isinstance(camera, PreviewingCamera):
            return None
        if time.monotonic() > self._previewed_until_s:
            from camctl.captures.response_preview import PreviewedLight, preview_settings

            shortest = plan.settings[0]
            longest = shortest.exposure * max(1.0, _PREVIEW_S / shortest.time_s)
            settings = preview_settings(camera.controls, shortest, longest)
            self._previewed = PreviewedLight.of(camera, settings)
            self._previewed_until_s = time.monotonic() + _PREVIEW_AGE_S
        return self._previewed


def planned(camera: Camera, request: CaptureRequest, cancelled: Callable[[], bool]) -> CapturePlan:
    """Return the plan; raises `InterruptedCaptureError` once `cancelled` returns True."""
    from camctl.captures.plan import plan_capture

    def stop_if_cancelled(_: float) -> None:
        if cancelled():
            raise InterruptedCaptureError("the menu went on")

    return plan_capture(camera, request, progress=stop_if_cancelled)


class RememberedPreviews:
    """A `camctl.PreviewingCamera` that takes each preview of an open camera once.

    So several plans come from the same light.  It does not close that camera.
    """

    def __init__(self, camera: PreviewingCamera) -> None:
        self.info, self.controls, self.clock = camera.info, camera.controls, camera.clock
        self.shoot, self._take = camera.shoot, camera.preview
        self._frames: dict[ExposureSetting, Frame] = {}

    def preview(self, setting: ExposureSetting) -> Frame:
        if setting not in self._frames:
            self._frames[setting] = self._take(setting)
        return self._frames[setting]

    def close(self) -> None:
        self._frames.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _noisy_picture(light: PreviewedLight, plan: CapturePlan) -> Picture:
    return sampled_picture(light.noisy_picture(plan), _PREVIEW_SIDE)


def _rivals(front: Front, cancelled: Callable[[], bool]) -> Iterator[Rival]:
    """Yield what brackets that cameras offer bring, but for those beyond the camera."""
    for count, stops in OFFERED:
        if cancelled():
            return
        with suppress(CaptureError):
            settings = bracket(front.controls, front.limit_s, count, stops)
            yield Rival(count, stops, front.time_of(settings), front.levels_of(settings))
