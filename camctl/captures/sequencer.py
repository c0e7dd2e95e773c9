"""Look up, plan, shoot, sum, hand over: the controller's main job.

The camera gets the whole list of settings at once.  While the next exposure runs, a worker writes
the last frame to disk, compares it with its neighbour and adds it to the sum, in that order.  A
slow disk pauses the stream; nothing is dropped.
"""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import camctl
from camctl.camera import Camera, Frame, Pixels
from camctl.captures.accumulator import Accumulator, sum_dtype
from camctl.captures.exposure_check import NeighbourCheck
from camctl.captures.frame_store import FrameStore
from camctl.captures.outputs import write_outputs
from camctl.captures.plan import plan_capture
from camctl.captures.report import CaptureReport, FrameRecord, read_report
from camctl.captures.request import CapturePlan, CaptureRequest
from camctl.errors import CamctlError, CaptureError, DataError, InterruptedCaptureError
from camctl.exposure.table import ExposureTable


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


_Report = Callable[[Progress], None]
_Cancelled = Callable[[], bool]


def capture(
    camera: Camera,
    request: CaptureRequest,
    directory: Path,
    *,
    plan: CapturePlan | None = None,
    table: ExposureTable | None = None,
    source: Mapping[str, Any] | None = None,
    progress: _Report | None = None,
    cancelled: _Cancelled | None = None,
    overwrite: bool = False,
) -> CaptureReport:
    """Take the picture that `request` asks for and leave it, with all its frames, in `directory`.

    Args:
        camera: an open camera
        request: what is wanted
        directory: made where it does not exist; see `camctl.captures.frame_store` for what it will hold
        plan: the plan to follow, as `plan_capture` made it of this request; None: made now
        table: where the ratios are looked up; None: the shipped table, else solved and kept
        source: what is needed to open this camera again; kept in the report
        progress: told before each frame and stage
        cancelled: asked before each frame; True ends the capture
        overwrite: replace an earlier capture in `directory`

    Raises:
        CaptureError: it could not be planned, or a frame is missing; frames already shot are kept,
            and `resume` completes them
        InterruptedCaptureError: `cancelled` said so, or Control-C was pressed
        StorageError: a file could not be written

    """
    FrameStore.check_free(directory, overwrite=overwrite)
    tell = progress or (lambda _: None)
    started = time.perf_counter()
    tell(Progress(0, len(request.ratios or ()) or request.count, "metering"))
    if plan is None:
        plan = plan_capture(
            camera,
            request,
            table=table,
            progress=lambda share: tell(Progress(round(100 * share), 100, "solving", share)),
        )
    controls = camera.controls
    sum_dtype(len(plan.settings), controls.white)
    archive = FrameStore.create(directory, overwrite=overwrite)
    report = CaptureReport(
        status="incomplete",
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
    report.write(directory)
    return _Sequence(camera, archive, report, tell, cancelled or (lambda: False)).run()


def resume(
    camera: Camera,
    directory: Path,
    *,
    progress: _Report | None = None,
    cancelled: _Cancelled | None = None,
) -> CaptureReport:
    """Shoot what is missing in an interrupted capture, and hand the picture over.

    Raises:
        DataError: the folder holds no capture, or one of another camera
        CaptureError, InterruptedCaptureError, StorageError: as `capture` does

    """
    report = read_report(directory)
    controls = camera.controls
    if (report.camera.make, report.camera.model, report.camera.serial) != (
        camera.info.make,
        camera.info.model,
        camera.info.serial,
    ):
        raise DataError(
            f"{directory} was begun with {report.camera.make} {report.camera.model} "
            f"{report.camera.serial}, this is {camera.info.make} {camera.info.model} "
            f"{camera.info.serial}",
            hint="connect the same camera",
        )
    if (controls.white, controls.layout) != (report.white, report.layout):
        raise DataError(
            f"{directory} was begun in another format of the camera", hint="set the same format"
        )
    if report.status == "complete":
        raise DataError(f"{directory} is complete: nothing is missing", hint="shoot a new capture")
    for position, record in enumerate(report.frames):
        if record is not None and not (directory / record.file).exists():
            report.frames[position] = None
    sequence = _Sequence(
        camera,
        FrameStore(directory),
        report,
        progress or (lambda _: None),
        cancelled or (lambda: False),
    )
    return sequence.run()


class _Sequence:
    """One capture from its first frame to its pictures; the report is its state."""

    def __init__(
        self,
        camera: Camera,
        archive: FrameStore,
        report: CaptureReport,
        tell: _Report,
        cancelled: _Cancelled,
    ) -> None:
        self.camera, self.archive, self.report = camera, archive, report
        self.tell, self.cancelled = tell, cancelled
        self.controls = camera.controls
        self.real = camera.controls.levels
        self.check = NeighbourCheck(self.real, self.controls.black)
        self.samples: dict[int, NDArray[np.intp]] = {}
        self.sum: Accumulator | None = None

    @property
    def done(self) -> int:
        """Frames that are kept."""
        return sum(record is not None for record in self.report.frames)

    def run(self) -> CaptureReport:
        """Shoot what is missing, then write the pictures."""
        began, wall = self.camera.clock.now(), time.perf_counter()
        try:
            for position, record in enumerate(self.report.frames):
                if record is not None:
                    self._add(position, self.archive.read(record.file))
            self._shoot([i for i, record in enumerate(self.report.frames) if record is None])
            self._shoot_again()
            self.report.timing["shooting_s"] = self.camera.clock.now() - began
            self.report.timing["shooting_wall_s"] = time.perf_counter() - wall
            assert self.sum is not None
            self._tell("writing")
            write_outputs(self.report, self.sum.total, self.controls, self.archive.directory)
        except KeyboardInterrupt:
            raise self._stopped("interrupted", InterruptedCaptureError) from None
        except InterruptedCaptureError as error:
            raise self._stopped(error.what, InterruptedCaptureError) from None
        except CamctlError as error:
            raise self._stopped(
                str(error), type(error) if _plain(error) else CaptureError
            ) from error
        return self.report

    def _stopped(self, what: str, kind: type[CamctlError]) -> CamctlError:
        """Return the error that says what became of the frames."""
        total = len(self.report.frames)
        return kind(
            f"{what}; {self.done} of {total} frames are kept",
            hint=f"go on with: camctl shoot --resume {self.archive.directory}",
        )

    def _shoot(self, positions: list[int]) -> None:
        """Shoot the settings at `positions`, each processed while the next one is exposed."""
        if not positions:
            return
        pending: Future[None] | None = None
        with ThreadPoolExecutor(1, thread_name_prefix="camctl-frame") as worker:
            try:
                self._tell("shooting")
                settings = [self.report.plan.settings[position] for position in positions]
                with closing(self.camera.shoot(settings)) as frames:
                    for frame in frames:
                        if pending is not None:
                            pending.result()
                        pending = worker.submit(self._take, frame, positions[frame.index])
                        if self.cancelled():
                            raise InterruptedCaptureError("cancelled")
                        self._tell("shooting")
            finally:
                # Whatever happened to the camera, the frame that has come is kept.
                if pending is not None:
                    pending.result()
        missing = [position for position in positions if self.report.frames[position] is None]
        if missing:
            raise CaptureError(f"the camera ended the sequence {len(missing)} frames early")
        self._tell("shooting")

    def _tell(self, stage: str) -> None:
        """Report progress, weighted by the time that the frames take."""
        frames = self.report.frames
        interval_s = self.controls.frame_interval_s
        times = [max(setting.time_s, interval_s) for setting in self.report.plan.settings]
        over = sum(t for t, record in zip(times, frames, strict=True) if record is not None)
        self.tell(Progress(self.done, len(frames), stage, over / sum(times)))

    def _take(self, frame: Frame, position: int) -> None:
        """Write a frame, check it against its neighbours, add it to the sum."""
        file, original = self.archive.keep(frame, position)
        if (frame.black, frame.white) != (self.controls.black, self.controls.white):
            raise CaptureError(
                f"the camera changed its black and white level to {frame.black} and {frame.white} "
                f"within the capture",
                hint="keep gain and format fixed, and shoot again",
            )
        plan = self.report.plan
        smallest = min(setting.exposure for setting in plan.settings)
        self.report.frames[position] = FrameRecord(
            file=file,
            original=original,
            requested=frame.requested,
            applied=frame.applied,
            requested_s=frame.requested.time_s,
            applied_s=frame.applied.time_s,
            exposure=frame.applied.exposure / smallest,
            black=frame.black,
            white=frame.white,
            saturated_fraction=float(np.count_nonzero(frame.pixels >= frame.white))
            / frame.pixels.size,
            timestamp_s=frame.timestamp_s,
            details=dict(frame.details),
        )
        self.report.write(self.archive.directory)
        self._add(position, frame.pixels)

    def _add(self, position: int, pixels: Pixels) -> None:
        """Compare with the neighbours that are there already, and sum."""
        self.samples[position] = self.check.sample(pixels)
        for later in (position, position + 1):
            self._compare(later)
        if self.sum is None:
            self.sum = Accumulator(
                pixels.shape, pixels.dtype, len(self.report.frames), self.controls.white
            )
        self.sum.accumulate(pixels)

    def _compare(self, later: int) -> None:
        """Check frame `later` against the one before it, where both are there."""
        before, after = self.samples.get(later - 1), self.samples.get(later)
        if before is None or after is None:
            return
        first, second = self._record(later - 1), self._record(later)
        expected = second.applied.exposure / first.applied.exposure
        second.ratio = self.check.compare(before, after, expected)

    def _record(self, position: int) -> FrameRecord:
        record = self.report.frames[position]
        assert record is not None
        return record

    def _suspects(self) -> list[int]:
        """Return the frames to blame for the ratios that do not agree.

        A frame that disagrees with both neighbours is to blame alone; where only one pair
        disagrees, both of it are suspect.
        """
        count = len(self.report.frames)
        wrong = [
            later
            for later in range(1, count)
            if (ratio := self._record(later).ratio) is not None and not ratio.agrees
        ]
        inner = {later for later in wrong if later + 1 in wrong}
        pairs = [
            (later - 1, later) for later in wrong if later not in inner and later - 1 not in inner
        ]
        return sorted(inner | {position for pair in pairs for position in pair})

    def _shoot_again(self) -> None:
        """Shoot frames again, once, whose exposure is not what the camera says; then mark them."""
        suspects = [i for i in self._suspects() if self._record(i).attempts == 1]
        if suspects:
            assert self.sum is not None
            for position in suspects:
                record = self._record(position)
                self.sum.withdraw(self.archive.read(record.file))
                self.report.rejected.append(self.archive.reject(record.file))
                self.report.frames[position] = None
                del self.samples[position]
            self.report.write(self.archive.directory)
            self._shoot(suspects)
            for position in suspects:
                self._record(position).attempts = 2
        for position in self._suspects():
            ratio = self._record(position).ratio
            if ratio is not None and not ratio.agrees:
                self.report.warnings.append(
                    f"frame {position + 1} is {ratio.measured:.4g} times as bright as the one "
                    f"before, its exposure says {ratio.expected:.4g}: do not trust the picture "
                    f"(if lamps flicker, see --mains)"
                )


def _plain(error: CamctlError) -> bool:
    """Say whether an error of this kind can be made again from a message alone."""
    return type(error).__init__ is CamctlError.__init__
