"""The job behind the menu, carried out with a camera."""

from __future__ import annotations

import math
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeVar

from camctl.captures.metering import MeteringFrames, meter
from camctl.errors import (
    CamctlError,
    CameraError,
    CaptureError,
    InterruptedCaptureError,
    StorageError,
    UsageError,
)
from camctl.exposure.brackets import OFFERED, bracket
from camctl.exposure.goal import AUTO, CaptureRequest
from camctl.interface.backends import list_cameras
from camctl.interface.camera import Camera, CameraCondition, Frame, PreviewingCamera, StatingCamera
from camctl.interface.controls import ExposureSetting
from camctl.menu.capture_list import list_captures, next_folder
from camctl.menu.data import (
    CameraEntry,
    Choice,
    Cost,
    Loaded,
    Past,
    Picture,
    Plan,
    Progress,
    Reading,
    Rival,
    SeriesChoice,
    Settings,
    Summary,
    Traced,
)
from camctl.menu.live_view import LiveView, Sight
from camctl.menu.settings_file import load_settings, save_settings
from camctl.menu.thumbnails import focus_value, frame_histogram, frame_picture, sampled_picture
from camctl.menu.views import (
    entry_of,
    needed_bytes,
    plan_view,
    progress_view,
    setting_text,
    summary_view,
)
from camctl.messages.menu import error_text
from camctl.system.files import check_space
from camctl.system.memory import return_free_memory

if TYPE_CHECKING:  # the idle menu does not load what captures are made with
    from camctl.captures.response_preview import PreviewedLight
    from camctl.exposure.search.front import Front, FrontPoint
    from camctl.records.capture_plan import CapturePlan
    from camctl.records.report import CaptureReport

OpenCamera = Callable[[str], tuple[Camera, Mapping[str, Any]]]
"""Returns an open camera for an id, "" the default one, and what a report keeps of it."""

_Result = TypeVar("_Result")

_PREVIEW_S, _PREVIEW_AGE_S = 1.0, 30.0
"""Longest preview frame for pictures of choices, s: they are waited for, as the exposure meter is;
and the time for which they serve the next choice, too."""
_PREVIEW_SIDE = 480
"""Pixels of the longest side of such a picture: half a phone's width, two device pixels each."""


class CameraJob:
    """A `camctl.menu.ports.Job` on a camera.

    Args:
        open_camera: opens a camera by its id
        parent: the folder in which each capture gets a folder of its own
        settings_path: file of the menu's settings
        request: what the menu does not ask for, such as the shift of the exposure
        sight: shows what the camera sees in all its size, beside the small pictures of readings
    """

    def __init__(
        self,
        open_camera: OpenCamera,
        parent: Path,
        settings_path: Path,
        *,
        request: CaptureRequest | None = None,
        sight: Sight | None = None,
    ) -> None:
        self._open_camera = open_camera
        self._parent = parent
        self._settings_path = settings_path
        self._request = replace(request or CaptureRequest(), ratios=None)
        self._camera: Camera | None = None
        self._source: Mapping[str, Any] = {}
        self._camera_id = ""
        self._entry = CameraEntry("", "")
        self._condition = CameraCondition()
        self._sight = sight
        self._previewed: PreviewedLight | None = None
        self._previewed_until_s = -math.inf
        self._view = LiveView(sight)
        self._best_focus = 0.0

    def load(self) -> Loaded:
        """Return the settings of the file, and how many captures are unfinished."""
        settings, remark = load_settings(self._settings_path)
        unfinished = [past for past in self.captures() if not past.is_complete]
        return Loaded(settings, remark, len(unfinished))

    def save(self, settings: Settings) -> None:
        save_settings(self._settings_path, settings)

    def find_cameras(self) -> tuple[CameraEntry, ...]:
        found = tuple(entry_of(info) for info in list_cameras())
        known = {each.id for each in found}
        return found if not self._entry.id or self._entry.id in known else (self._entry, *found)

    def open(self, camera_id: str) -> CameraEntry:
        self.close()
        self._camera_id = camera_id
        self._camera, self._source = self._open_camera(camera_id)
        self._entry = entry_of(self._camera.info)
        self._best_focus = 0.0
        self._ask_condition()
        return_free_memory()
        return self._entry

    def _ask_condition(self) -> None:
        """Ask for battery and card: not between captures, since a body is left in peace then."""
        self._condition = CameraCondition()
        if isinstance(self._camera, StatingCamera):
            with suppress(CameraError):
                self._condition = self._camera.condition()

    def close(self) -> None:
        """Close the camera; errors of one that was unplugged are left out."""
        self._view.end()
        self._previewed_until_s = -math.inf
        camera, self._camera = self._camera, None
        if camera is not None:
            with suppress(CameraError):
                camera.close()

    def _with_camera(
        self, act: Callable[[Camera], _Result], *, keeps_view: bool = False
    ) -> _Result:
        """Call `act` with the camera; it is opened again after it failed.

        The live view ends first, unless `keeps_view`.
        """
        if not keeps_view:
            self._view.end()
        if self._camera is None:
            self.open(self._camera_id)
        assert self._camera is not None  # it was opened
        try:
            return act(self._camera)
        except CamctlError as error:
            if isinstance(error, CameraError) or isinstance(error.__cause__, CameraError):
                self.close()
            raise

    def meter(self) -> Reading:
        """Look at the effective camera, or take metering frames where the camera does not stream.

        A camera without preview is asked for nothing.
        """
        reading = self._with_camera(self._reading, keeps_view=True)
        if reading.rate is None:  # the next one is a second away at least
            return_free_memory()
        if reading.focus is None:
            return reading
        self._best_focus = max(self._best_focus, reading.focus)
        percent = round(100 * reading.focus / self._best_focus) if self._best_focus else None
        return replace(reading, focus_percent=percent)

    def _reading(self, camera: Camera) -> Reading:
        reading = Reading(
            free_bytes=self._free_bytes(),
            camera=self._entry,
            battery_percent=self._condition.battery_percent,
            free_images=self._condition.free_images,
        )
        if not isinstance(camera, PreviewingCamera):
            return replace(reading, is_late=True)
        if self._view.suits(camera, self._request):
            try:
                return self._view.reading(camera, self._request, reading)
            except (CaptureError, UsageError) as error:
                return replace(reading, remark=error_text(error))
        source = MeteringFrames(camera)
        try:
            metered = meter(source)
        except CaptureError as error:
            return replace(reading, remark=error_text(error))
        frame = source.take(metered.setting)
        if self._sight is not None:
            self._sight.show_frame(frame, camera.controls, metered)
        return replace(
            reading,
            time_s=metered.limit_s * 2.0**self._request.compensation_stops,
            clipped=metered.clipped,
            histogram=frame_histogram(frame, camera.controls.layout),
            picture=frame_picture(frame, camera.controls.layout),
            focus=focus_value(camera.controls.layout.planes(frame.pixels)[0]),
        )

    def predict(self, choices: Sequence[Choice], cancelled: Callable[[], bool]) -> Iterator[Cost]:
        """Yield the cost of the plan of each choice, all from the same metering frames."""
        self._view.end()
        if self._camera is None:
            self.open(self._camera_id)
        assert self._camera is not None  # it was opened
        camera = self._camera
        if isinstance(camera, PreviewingCamera):
            camera = _RememberedPreviews(camera)
        for choice in choices:
            if cancelled():
                return
            yield self._cost(camera, choice, cancelled)

    def _cost(self, camera: Camera, choice: Choice, cancelled: Callable[[], bool]) -> Cost:
        request = self._request_for(choice)
        is_relative = not isinstance(camera, PreviewingCamera) and request.base_s is None
        if is_relative:  # any base exposure shows the relative ones
            if AUTO in (request.response, request.dynamic_range):
                return Cost(problem="known once the light is metered")
            base_s = camera.controls.time_s.nearest(1 / 60)
            request = replace(request, base_s=base_s)
        try:
            plan = _planned(camera, request, cancelled)
        except CameraError:
            self.close()  # it is opened again by what comes next
            raise
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

    def _previewed_light(self, camera: Camera, plan: CapturePlan) -> PreviewedLight | None:
        """Return the light for pictures of choices, of preview frames that are not old."""
        if self._sight is None or not isinstance(camera, PreviewingCamera):
            return None
        if time.monotonic() > self._previewed_until_s:
            from camctl.captures.response_preview import PreviewedLight, preview_settings

            shortest = plan.settings[0]
            longest = shortest.exposure * max(1.0, _PREVIEW_S / shortest.time_s)
            settings = preview_settings(camera.controls, shortest, longest)
            self._previewed = PreviewedLight.of(camera, settings)
            self._previewed_until_s = time.monotonic() + _PREVIEW_AGE_S
        return self._previewed

    def trace(self, choice: Choice, cancelled: Callable[[], bool]) -> Traced:
        """Return the most accurate settings for each time, and brackets to compare them with.

        The brackets are there for a page only, as are the pictures.

        Raises:
            UsageError: the noise of the camera is unknown
        """
        request = self._request_for(choice)

        def plan_with(camera: Camera) -> tuple[CapturePlan, PreviewedLight | None]:
            plan = _planned(camera, request, cancelled)
            return plan, self._previewed_light(camera, plan)

        plan, light = self._with_camera(plan_with)
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
        return Traced(points, () if self._sight is None else tuple(_rivals(front, cancelled)))

    def plan(self, choice: Choice, cancelled: Callable[[], bool]) -> Plan:
        """Meter, look up the exposures, and choose among the settings of the camera.

        Raises:
            StorageError: there is too little space for the capture
        """
        request = self._request_for(choice)

        def plan_with(camera: Camera) -> Plan:
            plan = _planned(camera, request, cancelled)
            needed, free = needed_bytes(plan, camera.controls), self._free_bytes()
            check_space("the capture", needed, free)
            return replace(plan_view(plan, request), needed_bytes=needed, free_bytes=free)

        return self._with_camera(plan_with)

    def shoot(
        self,
        plan: Plan,
        on_progress: Callable[[Progress], None],
        cancelled: Callable[[], bool],
    ) -> Summary:
        """Shoot the settings of `plan` into a new folder."""
        from camctl.captures.sequencer import capture

        assert isinstance(plan.handle, tuple)  # `plan_view` made it
        made, request = plan.handle
        folder = next_folder(self._parent, datetime.now())

        def shoot_with(camera: Camera) -> Summary:
            report = capture(
                camera,
                request,
                folder,
                plan=made,
                source=self._source,
                progress=lambda each: on_progress(progress_view(each)),
                cancelled=cancelled,
            )
            return summary_view(report, folder)

        return self._taken(shoot_with)

    def _taken(self, take: Callable[[Camera], Summary]) -> Summary:
        """Return what taking pictures brings; battery and card have changed by it."""
        summary = self._with_camera(take)
        self._ask_condition()
        return_free_memory()
        return summary

    def resume(
        self,
        past: Past,
        on_progress: Callable[[Progress], None],
        cancelled: Callable[[], bool],
    ) -> Summary:
        from camctl.captures.sequencer import resume

        folder = self._parent / past.name

        def resume_with(camera: Camera) -> CaptureReport:
            return resume(
                camera,
                folder,
                progress=lambda each: on_progress(progress_view(each)),
                cancelled=cancelled,
            )

        return summary_view(self._with_camera(resume_with), folder)

    def series(
        self,
        series: SeriesChoice,
        on_progress: Callable[[Progress], None],
        cancelled: Callable[[], bool],
    ) -> Summary:
        """Take a series into a new folder, as ``camctl series`` does."""
        from camctl.menu.series_job import take_series

        directory = next_folder(self._parent, datetime.now(), "series")
        request = self._request_for(series.choice)

        def take_with(camera: Camera) -> Summary:
            return take_series(
                camera, self._source, request, series, directory, on_progress, cancelled
            )

        return self._taken(take_with)

    def captures(self) -> tuple[Past, ...]:
        try:
            return list_captures(self._parent)
        except OSError as error:
            raise StorageError(
                f"cannot read {self._parent}: {error.strerror}", hint="choose another folder"
            ) from error

    def look(self, past: Past) -> Summary:
        from camctl.records.folder_store import read_report

        folder = self._parent / past.name
        return summary_view(read_report(folder), folder)

    def _request_for(self, choice: Choice) -> CaptureRequest:
        return replace(
            self._request,
            response=choice.response,
            dynamic_range="auto" if choice.dynamic_range is None else choice.dynamic_range,
            count=choice.count,
            time_budget_s=choice.time_budget_s,
            mains_hz=choice.mains_hz or self._request.mains_hz,
        )

    def _free_bytes(self) -> int:
        """Return the free space where captures are kept; the folder may not exist yet."""
        existing = next(
            path for path in (self._parent, *self._parent.absolute().parents) if path.exists()
        )
        return shutil.disk_usage(existing).free


def _planned(camera: Camera, request: CaptureRequest, cancelled: Callable[[], bool]) -> CapturePlan:
    from camctl.captures.plan import plan_capture

    def stop_if_cancelled(_: float) -> None:
        if cancelled():
            raise InterruptedCaptureError("the menu went on")

    return plan_capture(camera, request, progress=stop_if_cancelled)


class _RememberedPreviews:
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
