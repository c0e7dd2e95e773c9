"""The controller's main job: plan, shoot, sum, and write the outputs."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from camctl.captures.plan import plan_capture
from camctl.captures.sequence import Cancelled, OnProgress, Progress, Sequence
from camctl.errors import DataError, UsageError
from camctl.exposure.goal import CaptureRequest
from camctl.interface.camera import Camera
from camctl.interface.clock import VirtualClock, cancelled_by
from camctl.pictures.accumulator import sum_dtype
from camctl.records.capture_plan import CapturePlan
from camctl.records.folder_store import FolderStore
from camctl.records.frame_store import CaptureStore, MemoryStore
from camctl.records.report import CaptureReport, UnfinishedCapture
from camctl.records.report_file import check_camera
from camctl.system.number_text import range_text


def capture(
    camera: Camera,
    request: CaptureRequest,
    path: str | os.PathLike[str] | None = None,
    *,
    plan: CapturePlan | None = None,
    source: Mapping[str, Any] | None = None,
    progress: OnProgress | None = None,
    cancelled: Cancelled | None = None,
    overwrite: bool = False,
    taken_at: datetime | None = None,
) -> CaptureReport:
    """Take the picture that `request` asks for; keep it, with all its frames, in a folder.

    Args:
        camera: an open camera
        request: what the user asks for
        path: the folder, made where it does not exist, and locked against other processes; None:
            all is kept in memory, and the pictures come from the report's methods
        plan: the plan to follow, made by `plan_capture` from this request; None: made now
        source: what is needed to open this camera again; kept in the report
        progress: called before each frame and stage
        cancelled: called all the time while frames are awaited; if it returns True the capture
            ends within `POLL_S` of `camctl.interface.clock`, or as soon as the camera lets it.  The
            exposure that runs is aborted where the camera can do that; a set whose frames have all
            arrived is completed nevertheless
        overwrite: replace an earlier capture in the folder
        taken_at: date and time that the report has; None: of this computer, now

    Raises:
        UsageError: the request cannot be met by any camera, or `plan` was made from another one
        CaptureError: it cannot be planned, or a frame is missing; frames already shot are kept in
            the folder, and `resume` completes them
        InterruptedCaptureError: `cancelled` returned True, or Control-C was pressed
        CameraError: the camera failed
        StorageError: a file could not be written, or another process is writing the folder
    """
    report_progress = progress or (lambda _: None)
    opened: AbstractContextManager[CaptureStore] = nullcontext(MemoryStore())
    if path is not None:
        opened = FolderStore.create(Path(path), overwrite=overwrite)
    with opened as store:
        started = time.perf_counter()
        report_progress(
            Progress(0, len(request.ratios or ()) or request.most_exposures, "metering")
        )
        if plan is None:
            with cancelled_by(cancelled):
                plan = plan_capture(
                    camera,
                    request,
                    progress=lambda share: report_progress(
                        Progress(round(100 * share), 100, "solving", share)
                    ),
                )
        else:
            _check_plan(plan, request)
        sum_dtype(len(plan.settings), camera.controls.white)
        unfinished = _begun(camera, request, plan, source, taken_at)
        unfinished.timing["planning_s"] = time.perf_counter() - started
        store.save_report(unfinished)
        return Sequence(camera, store, unfinished, report_progress, cancelled).run()


def _begun(
    camera: Camera,
    request: CaptureRequest,
    plan: CapturePlan,
    source: Mapping[str, Any] | None,
    taken_at: datetime | None,
) -> UnfinishedCapture:
    """Return the report of a capture without frames."""
    controls = camera.controls
    return UnfinishedCapture(
        camera=camera.info,
        source=dict(source or {}),
        layout=controls.layout,
        pixel_format=controls.pixel_format,
        repeatable=controls.repeatable,
        response_origin=controls.response_origin,
        request=request,
        plan=plan,
        frames=[None] * len(plan.settings),
        white=controls.white,
        black_total=controls.black * len(plan.settings),
        timing={},
        clock="virtual" if isinstance(camera.clock, VirtualClock) else "real",
        versions={
            "camctl": version("camctl"),
            "numpy": np.__version__,
            "python": platform.python_version(),
        },
        taken_at=(taken_at or datetime.now()).astimezone().replace(microsecond=0),
    )


def _check_plan(plan: CapturePlan, request: CaptureRequest) -> None:
    requested = request.desired
    if requested is None:  # "auto": the light decided
        matches = plan.response == request.response
    else:
        planned = plan.desired
        matches = (planned.key, planned.dynamic_range) == (requested.key, requested.dynamic_range)
    if not matches:
        asked = "auto" if requested is None else range_text(requested.dynamic_range)
        raise UsageError(
            f"the plan ({plan.response}, range {range_text(plan.dynamic_range)}) is not of this "
            f"request ({request.response}, range {asked})",
            hint="make it with plan_capture from the same request",
        )


def resume(
    camera: Camera,
    path: str | os.PathLike[str],
    *,
    progress: OnProgress | None = None,
    cancelled: Cancelled | None = None,
) -> CaptureReport:
    """Shoot the missing frames of an interrupted capture, and complete its pictures.

    Args:
        camera: the camera it was begun with, open
        path: the folder of the capture
        progress: as for `capture`
        cancelled: as for `capture`

    Raises:
        DataError: the folder holds no capture, a complete one, or one of another camera
        CaptureError, InterruptedCaptureError, CameraError, StorageError: as `capture` does
    """
    directory = Path(path)
    with FolderStore.reopen(directory) as store:
        report = store.report
        assert report is not None  # it was read
        check_camera(camera, directory, report)
        if isinstance(report, CaptureReport):
            raise already_complete(directory, report.with_pictures(store))
        return Sequence(camera, store, report, progress or (lambda _: None), cancelled).run()


def already_complete(directory: Path, report: CaptureReport) -> DataError:
    """Check the frames of a complete capture; return the error that nothing is left to shoot.

    Raises:
        DataError: a frame is missing or has changed since it was shot
    """
    for position in range(len(report.frames)):
        report.frame(position)
    return DataError(
        f"the capture in {directory} is complete: all {len(report.frames)} frames were shot",
        hint="take another picture",
    )
