"""The controller's main job: plan, shoot, sum, and write the outputs.

The camera gets the whole list of settings at once.  During the next exposure a worker stores the
last frame, compares it with its neighbour and adds it to the sum, in this order.  A slow disk
pauses the stream; no frame is dropped.
"""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import camctl
from camctl.camera import Camera, Frame, Pixels
from camctl.captures.accumulator import Accumulator, sum_dtype
from camctl.captures.exposure_check import NeighbourCheck, suspects
from camctl.captures.frame_store import CaptureStore, FolderStore, MemoryStore, read_capture
from camctl.captures.outputs import complete
from camctl.captures.plan import plan_capture
from camctl.captures.report import CaptureReport, StoredFrame, UnfinishedCapture
from camctl.captures.request import CapturePlan, CaptureRequest
from camctl.errors import CamctlError, CaptureError, DataError, InterruptedCaptureError, UsageError


@dataclass(frozen=True)
class Progress:
    """How far a capture is: `done` of `total` in one of its stages.

    The stages are "metering", "solving" (in percent; where no table holds the exposures),
    "shooting" (in frames) and "writing".  `share` is the share of the stage's time that is over,
    0 to 1: frames take as long as their exposures.
    """

    done: int
    total: int
    stage: str
    share: float = 0.0


_OnProgress = Callable[[Progress], None]
_Cancelled = Callable[[], bool]


def capture(
    camera: Camera,
    request: CaptureRequest,
    path: str | os.PathLike[str] | None = None,
    *,
    plan: CapturePlan | None = None,
    source: Mapping[str, Any] | None = None,
    progress: _OnProgress | None = None,
    cancelled: _Cancelled | None = None,
    overwrite: bool = False,
) -> CaptureReport:
    """Take the picture that `request` asks for; keep it, with all its frames, in a folder.

    Args:
        camera: an open camera
        request: what the user asks for
        path: the folder, made where it does not exist; None: all is kept in memory, and the
            pictures come from the report's methods
        plan: the plan to follow, made by `plan_capture` from this request; None: made now
        source: what is needed to open this camera again; kept in the report
        progress: called before each frame and stage
        cancelled: called before each frame; if it returns True the capture ends
        overwrite: replace an earlier capture in the folder

    Raises:
        UsageError: the request cannot be met by any camera, or `plan` was made from another one
        CaptureError: it cannot be planned, or a frame is missing; frames already shot are kept in
            the folder, and `resume` completes them
        InterruptedCaptureError: `cancelled` returned True, or Control-C was pressed
        CameraError: the camera failed
        StorageError: a file could not be written
    """
    directory = None if path is None else Path(path)
    if directory is not None:
        FolderStore.check_free(directory, overwrite=overwrite)
    report_progress = progress or (lambda _: None)
    started = time.perf_counter()
    report_progress(Progress(0, len(request.ratios or ()) or request.count, "metering"))
    if plan is None:
        plan = plan_capture(
            camera,
            request,
            progress=lambda share: report_progress(
                Progress(round(100 * share), 100, "solving", share)
            ),
        )
    else:
        _check_plan(plan, request)
    controls = camera.controls
    sum_dtype(len(plan.settings), controls.white)
    store: CaptureStore = MemoryStore()
    if directory is not None:
        store = FolderStore.create(directory, overwrite=overwrite)
    unfinished = UnfinishedCapture(
        camera=camera.info,
        source=dict(source or {}),
        layout=controls.layout,
        request=request,
        plan=plan,
        frames=[None] * len(plan.settings),
        white=controls.white,
        black_total=controls.black * len(plan.settings),
        timing={"planning_s": time.perf_counter() - started},
        versions={
            "camctl": camctl.__version__,
            "numpy": np.__version__,
            "python": platform.python_version(),
        },
    )
    store.save_report(unfinished)
    return _Sequence(camera, store, unfinished, report_progress, cancelled).run()


def _check_plan(plan: CapturePlan, request: CaptureRequest) -> None:
    requested = request.desired
    if requested is None:  # "auto": the light decided
        matches = plan.response == request.response
    else:
        planned = plan.desired
        matches = (planned.key, planned.dynamic_range) == (requested.key, requested.dynamic_range)
    if not matches:
        raise UsageError(
            f"the plan ({plan.response}, range 1:{plan.dynamic_range:g}) is not of this request "
            f"({request.response}, range 1:{request.dynamic_range:g})",
            hint="make it with plan_capture from the same request",
        )


def resume(
    camera: Camera,
    path: str | os.PathLike[str],
    *,
    progress: _OnProgress | None = None,
    cancelled: _Cancelled | None = None,
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
    report = read_capture(directory)
    begun, present, controls = report.camera, camera.info, camera.controls
    if (begun.make, begun.model, begun.serial) != (present.make, present.model, present.serial):
        raise DataError(
            f"{directory} was begun with {begun.make} {begun.model} {begun.serial}, "
            f"and this camera is {present.make} {present.model} {present.serial}",
            hint="connect the same camera",
        )
    if (controls.white, controls.layout) != (report.white, report.layout):
        raise DataError(
            f"{directory} was begun in another format of the camera", hint="set the same format"
        )
    if isinstance(report, CaptureReport):
        raise DataError(f"{directory} is complete: no frame is missing", hint="shoot a new capture")
    store = FolderStore(directory)
    for position in range(len(report.frames)):
        if not store.holds(position):
            report.frames[position] = None
    return _Sequence(camera, store, report, progress or (lambda _: None), cancelled).run()


class _Sequence:
    """One capture from its first missing frame to its pictures; `capture` is its state."""

    def __init__(
        self,
        camera: Camera,
        store: CaptureStore,
        capture: UnfinishedCapture,
        on_progress: _OnProgress,
        cancelled: _Cancelled | None,
    ) -> None:
        self._camera, self._controls = camera, camera.controls
        self._store, self._capture = store, capture
        self._on_progress, self._cancelled = on_progress, cancelled or (lambda: False)
        self._check = NeighbourCheck(self._controls.levels, self._controls.black)
        self._sum: Accumulator | None = None

    def run(self) -> CaptureReport:
        """Shoot the missing frames, then write the pictures."""
        frames, timing = self._capture.frames, self._capture.timing
        began, wall_began = self._camera.clock.now(), time.perf_counter()
        try:
            for position, frame in enumerate(frames):
                if frame is not None:
                    self._add(position, self._store.frame(position))
            self._shoot([position for position, frame in enumerate(frames) if frame is None])
            self._shoot_suspects_again()
            timing["shooting_s"] = self._camera.clock.now() - began
            timing["shooting_wall_s"] = time.perf_counter() - wall_began
            self._report_progress("writing")
            assert self._sum is not None  # a plan has at least one setting
            return complete(self._capture, self._sum.total, self._controls, self._store)
        except KeyboardInterrupt:
            raise self._failure("interrupted", InterruptedCaptureError) from None
        except InterruptedCaptureError as error:
            raise self._failure(error.what, InterruptedCaptureError) from None
        except CamctlError as error:
            kind = type(error) if _is_made_from_message(error) else CaptureError
            raise self._failure(str(error), kind) from error

    @property
    def _done(self) -> int:
        return sum(frame is not None for frame in self._capture.frames)

    def _failure(self, what: str, kind: type[CamctlError]) -> CamctlError:
        """Return the error with the number of frames that are kept, and how to go on."""
        kept, hint = self._store.after_failure(self._done, len(self._capture.frames))
        return kind(f"{what}; {kept}", hint=hint)

    def _shoot(self, positions: list[int]) -> None:
        """Shoot the settings at `positions`; each frame is processed during the next exposure."""
        if not positions:
            return
        pending: Future[None] | None = None
        with ThreadPoolExecutor(1, thread_name_prefix="camctl-frame") as worker:
            try:
                self._report_progress("shooting")
                settings = [self._capture.plan.settings[position] for position in positions]
                with closing(self._camera.shoot(settings)) as frames:
                    for frame in frames:
                        if pending is not None:
                            pending.result()
                        pending = worker.submit(self._take, frame, positions[frame.index])
                        if self._cancelled():
                            raise InterruptedCaptureError("cancelled")
                        self._report_progress("shooting")
            finally:
                # Whatever happened to the camera, the frame that has arrived is kept.
                if pending is not None:
                    pending.result()
        missing = sum(self._capture.frames[position] is None for position in positions)
        if missing:
            raise CaptureError(f"the camera ended the sequence {missing} frames early")
        self._report_progress("shooting")

    def _report_progress(self, stage: str) -> None:
        """Report progress, weighted by the time that the frames take."""
        frames = self._capture.frames
        interval_s = self._controls.frame_interval_s
        times = [max(setting.time_s, interval_s) for setting in self._capture.plan.settings]
        over = sum(t for t, frame in zip(times, frames, strict=True) if frame is not None)
        self._on_progress(Progress(self._done, len(frames), stage, over / sum(times)))

    def _take(self, frame: Frame, position: int) -> None:
        """Store a frame, compare it with its neighbours, add it to the sum."""
        file, original = self._store.keep(frame, position)
        if (frame.black, frame.white) != (self._controls.black, self._controls.white):
            raise CaptureError(
                f"the camera changed its black and white level to {frame.black} and {frame.white} "
                f"within the capture",
                hint="keep gain and format fixed, and shoot again",
            )
        saturated = float(np.count_nonzero(frame.pixels >= frame.white))
        self._capture.frames[position] = StoredFrame(
            file=file,
            original=original,
            requested=frame.requested,
            applied=frame.applied,
            requested_s=frame.requested.time_s,
            applied_s=frame.applied.time_s,
            black=frame.black,
            white=frame.white,
            saturated_fraction=saturated / frame.pixels.size,
            timestamp_s=frame.timestamp_s,
            details=dict(frame.details),
        )
        self._store.save_report(self._capture)
        self._add(position, frame.pixels)

    def _add(self, position: int, pixels: Pixels) -> None:
        """Compare with the neighbours that have arrived, and sum."""
        self._check.add(position, pixels)
        for later in (position, position + 1):
            if self._check.has(later):
                before, after = self._frame(later - 1), self._frame(later)
                expected = after.applied.exposure / before.applied.exposure
                after.ratio = self._check.check(later, expected)
        if self._sum is None:
            count = len(self._capture.frames)
            self._sum = Accumulator(pixels.shape, pixels.dtype, count, self._controls.white)
        self._sum.accumulate(pixels)

    def _frame(self, position: int) -> StoredFrame:
        frame = self._capture.frames[position]
        assert frame is not None  # it was added
        return frame

    def _suspects(self) -> list[int]:
        return suspects([self._frame(k).ratio for k in range(len(self._capture.frames))])

    def _shoot_suspects_again(self) -> None:
        """Shoot frames with a wrong exposure again, once; then warn of those that stay wrong."""
        again = [position for position in self._suspects() if self._frame(position).attempts == 1]
        if again:
            assert self._sum is not None  # all frames were added
            for position in again:
                self._sum.withdraw(self._store.frame(position))
                self._check.remove(position)
                self._capture.frames[position] = None
                if (name := self._store.reject(position)) is not None:
                    self._capture.rejected.append(name)
            self._store.save_report(self._capture)
            self._shoot(again)
            for position in again:
                self._frame(position).attempts = 2
        for position in self._suspects():
            ratio = self._frame(position).ratio
            if ratio is not None and not ratio.agrees:
                self._capture.warnings.append(
                    f"frame {position + 1} is {ratio.measured:.4g} times as bright as the frame "
                    f"before, and its exposure is {ratio.expected:.4g} times as long: do not trust "
                    f"the picture (if lamps flicker, see --mains)"
                )


def _is_made_from_message(error: CamctlError) -> bool:
    """Return whether an error of this kind can be made again from a message alone."""
    return type(error).__init__ is CamctlError.__init__
