"""The job behind the menu, carried out with a camera."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from camctl.captures.metering import MeteringFrames, meter
from camctl.errors import (
    CamctlError,
    CameraError,
    CaptureError,
    StorageError,
    UsageError,
)
from camctl.exposure.goal import CaptureRequest
from camctl.interface.backends import list_cameras
from camctl.interface.camera import Camera, CameraCondition, PreviewingCamera, StatingCamera
from camctl.menu.capture_list import list_captures, next_folder
from camctl.menu.costs import Costs, RememberedPreviews, planned
from camctl.menu.data import (
    Calibrated,
    CameraEntry,
    Choice,
    Cost,
    Loaded,
    Past,
    Plan,
    Progress,
    Reading,
    SeriesChoice,
    Settings,
    Summary,
    Traced,
)
from camctl.menu.entries import TOGETHER
from camctl.menu.live_view import LiveView, Sight
from camctl.menu.settings_file import load_settings, save_settings
from camctl.menu.several import Others, Take, take_together
from camctl.menu.thumbnails import focus_value, frame_histogram, frame_picture
from camctl.menu.views import (
    entry_of,
    needed_bytes,
    plan_view,
    progress_view,
    summary_view,
)
from camctl.messages.menu import error_text
from camctl.records import SERIES
from camctl.system.files import check_space
from camctl.system.memory import return_free_memory

if TYPE_CHECKING:  # the idle menu does not load what captures are made with
    from camctl.records.report import CaptureReport

OpenCamera = Callable[..., tuple[Camera, Mapping[str, Any]]]
"""Returns an open camera for an id, "" the default one, and what a report keeps of it; a
calibration has a second argument, the parts of the camera's profile to use."""

_Result = TypeVar("_Result")


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
        self._others = Others()
        self._costs = Costs(has_pictures=sight is not None)
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
        opened = () if self._camera is None else (self._camera, *self._others.cameras)
        entries = [entry_of(each.info) for each in opened]
        known = {each.id for each in found}
        return (*(each for each in entries if each.id not in known), *found)

    def open(self, camera_id: str) -> CameraEntry:
        self.close()
        self._camera_id = camera_id
        first, *others = camera_id.split(TOGETHER)
        self._camera, self._source = self._open_camera(first)
        self._others.open(others, self._open_camera)
        self._entry = entry_of(self._camera.info, *(each.info for each in self._others.cameras))
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
        self._costs.forget()
        self._others.close()
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
            **vars(self._condition),
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
        camera = self._with_camera(
            lambda found: (
                RememberedPreviews(found) if isinstance(found, PreviewingCamera) else found
            )
        )
        for choice in choices:
            if cancelled():
                return
            try:
                yield self._costs.of(camera, self._request_for(choice), cancelled)
            except CameraError:
                self.close()  # it is opened again by what comes next
                raise

    def trace(self, choice: Choice, cancelled: Callable[[], bool]) -> Traced:
        request = self._request_for(choice)
        return self._with_camera(lambda camera: self._costs.trace(camera, request, cancelled))

    def plan(self, choice: Choice, cancelled: Callable[[], bool]) -> Plan:
        """Meter, look up the exposures, and choose among the settings of the camera.

        Raises:
            StorageError: there is too little space for the capture
        """
        request = self._request_for(choice)

        def plan_with(camera: Camera) -> Plan:
            plan = planned(camera, request, cancelled)
            needed, free = needed_bytes(plan, camera.controls), self._free_bytes()
            needed *= 1 + len(self._others.takes(plan, request))  # all must be able to shoot it
            check_space("the capture", needed, free)
            return replace(plan_view(plan, request), needed_bytes=needed, free_bytes=free)

        return self._with_camera(plan_with)

    def shoot(
        self,
        plan: Plan,
        on_progress: Callable[[Progress], None],
        cancelled: Callable[[], bool],
    ) -> Summary:
        """Shoot the settings of `plan` into a new folder, with each camera into one of its own."""
        assert isinstance(plan.handle, tuple)  # `plan_view` made it
        made, request = plan.handle

        def shoot_with(camera: Camera) -> Summary:
            first = Take(camera, self._source, made, request)
            takes = (first, *self._others.takes(made, request))
            return take_together(takes, self._parent, on_progress, cancelled)

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
        from camctl.menu.series_job import take_series
        from camctl.records.journal import read_series

        folder = self._parent / past.name
        if (folder / SERIES).is_file():
            journal = read_series(folder)
            return self._taken(
                lambda camera: take_series(camera, journal, folder, on_progress, cancelled)
            )

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
        from camctl.records.journal import SeriesJournal, SeriesOptions

        if self._others.cameras:
            raise UsageError(
                "a series is taken with one camera", hint="choose one", remedies={"cameras": None}
            )
        directory = next_folder(self._parent, datetime.now(), "series")
        options = SeriesOptions(repeat=series.count, interval_s=series.interval_s)

        def take_with(camera: Camera) -> Summary:
            journal = SeriesJournal(
                camera=camera.info,
                source=dict(self._source),
                request=self._request_for(series.choice),
                options=options,
            )
            return take_series(camera, journal, directory, on_progress, cancelled)

        return self._taken(take_with)

    def calibrate(
        self,
        scene: str,
        on_progress: Callable[[Progress], None],
        cancelled: Callable[[], bool],
    ) -> Calibrated:
        """Measure the first camera, which is opened again by what comes next, with the results."""
        from camctl.menu.calibration_job import measure

        self.close()
        first = self._camera_id.split(TOGETHER)[0]
        return measure(
            lambda parts: self._open_camera(first, parts)[0], scene, on_progress, cancelled
        )

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
            spend_shutter=choice.spend_shutter or self._request.spend_shutter,
        )

    def _free_bytes(self) -> int:
        """Return the free space where captures are kept; the folder may not exist yet."""
        existing = next(
            path for path in (self._parent, *self._parent.absolute().parents) if path.exists()
        )
        return shutil.disk_usage(existing).free
