"""One capture from its first missing frame to its pictures.

The camera gets the whole list of settings at once.  During the next exposures a worker stores each
frame, compares it with its neighbour and adds it to the sum, in this order.  Small frames may wait
for the worker, so that a stream of short exposures continues meanwhile: each setting of a stream is
written in a frame of its own, and a pause costs frames.  A slow disk pauses the stream when
`WAITING_BYTES` wait; no frame is dropped.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np

from camctl.captures.frame_checks import FrameChecks
from camctl.captures.outputs import complete
from camctl.errors import CamctlError, CaptureError, DataError, InterruptedCaptureError
from camctl.exposure.search.wall_time import predicted_wall_s, wall_time_findings
from camctl.interface.camera import Camera, Frame, Pixels, shoot_when_ready, use_delay
from camctl.interface.clock import cancelled_by, check_cancelled
from camctl.interface.controls import Layout
from camctl.pictures.accumulator import Accumulator
from camctl.records.capture_plan import CapturePlan
from camctl.records.frame import StoredFrame
from camctl.records.frame_store import AfterFailure, CaptureStore
from camctl.records.report import CaptureReport, UnfinishedCapture
from camctl.records.report_file import clean_details
from camctl.system.interrupts import uninterrupted
from camctl.system.memory import return_free_memory, share_free_memory
from camctl.system.picture_operations import count_from
from camctl.system.system_errors import resource_error
from camctl.system.threads import Threads

WAITING_BYTES = 32_000_000
"""Size of the frames that may wait for the worker; at least one may: 16 frames of 2 MP, 8 bits."""


@dataclass(frozen=True)
class Progress:
    """How far a capture is: `done` of `total` in one of its stages.

    The stages are "metering", "solving" (in percent; where no table holds the exposures),
    "shooting" (in frames) and "writing".  `share` is the share of the stage's time that is over,
    0 to 1: frames take as long as their exposures.  `plan` is what is shot, once it is made.
    """

    done: int
    total: int
    stage: str
    share: float = 0.0
    plan: CapturePlan | None = None


OnProgress = Callable[[Progress], None]
Cancelled = Callable[[], bool]


class Sequence:
    """One capture from its first missing frame to its pictures; `capture` is its state."""

    def __init__(
        self,
        camera: Camera,
        store: CaptureStore,
        capture: UnfinishedCapture,
        on_progress: OnProgress,
        cancelled: Cancelled | None,
    ) -> None:
        self._camera, self._controls = camera, camera.controls
        self._store, self._capture = store, capture
        self._on_progress, self._cancelled = on_progress, cancelled or (lambda: False)
        self._checks = FrameChecks(camera, capture)
        self._sum: Accumulator | None = None
        self._arrived = {k for k, frame in enumerate(capture.frames) if frame is not None}

    def run(self) -> CaptureReport:
        """Shoot the missing frames, then write the pictures."""
        share_free_memory()  # before the first thread has memory of its own
        frames, timing = self._capture.frames, self._capture.timing
        began, wall_began = self._camera.clock.now(), time.perf_counter()
        try:
            for position, frame in enumerate(frames):
                if frame is not None:
                    self._add(position, self._kept_samples(position))
            missing = [position for position, frame in enumerate(frames) if frame is None]
            timing["planned_wall_s"] = self._planned_wall_s(missing)
            timing["actual_wall_s"] = self._shoot(missing)
            self._compare_times(missing)
            self._shoot_suspects_again()
            self._settle_if_late()
            timing["shooting_s"] = self._camera.clock.now() - began
            timing["shooting_wall_s"] = time.perf_counter() - wall_began
            self._report_progress("writing")
            assert self._sum is not None  # a plan has at least one setting
            return complete(
                self._capture, self._sum.total, self._checks, self._controls, self._store
            )
        except KeyboardInterrupt as error:
            raise self._failure(str(error) or "interrupted", InterruptedCaptureError) from None
        except InterruptedCaptureError as error:
            raise self._failure(error.what, InterruptedCaptureError) from None
        except CamctlError as error:
            kind = type(error) if _is_made_from_message(error) else CaptureError
            raise self._failure(str(error), kind, error.remedies) from error
        except Exception as error:
            if (refused := resource_error(error)) is not None:
                raise self._failure(str(refused), type(refused)) from error
            after = self._kept()
            error.add_note(f"{after.kept}; {after.hint}")
            vars(error)["remedies"] = after.remedies  # as an error of camctl has them
            raise
        finally:
            return_free_memory()

    def _is_to_end(self) -> bool:
        """Return whether the capture was cancelled; a complete set becomes a picture even then."""
        return len(self._arrived) < len(self._capture.frames) and self._cancelled()

    @property
    def _done(self) -> int:
        return sum(frame is not None for frame in self._capture.frames)

    def _failure(
        self, what: str, kind: type[CamctlError], remedies: Mapping[str, Any] | None = None
    ) -> CamctlError:
        """Return the error with the number of frames that are kept, and how to continue."""
        after = self._kept()
        return kind(
            f"{what}; {after.kept}",
            hint=after.hint,
            remedies={**(remedies or {}), **after.remedies},
        )

    def _kept(self) -> AfterFailure:
        return self._store.after_failure(self._done, len(self._capture.frames))

    def _planned_wall_s(self, positions: list[int]) -> float:
        """Return how long the settings at `positions` should take, s."""
        plan = self._capture.plan
        if plan.wall_s is not None and len(positions) == len(plan.settings):
            return plan.wall_s
        return predicted_wall_s(self._controls, [plan.settings[place] for place in positions])

    def _compare_times(self, positions: list[int]) -> None:
        """Record where the settings at `positions` took another time than planned."""
        plan, timing = self._capture.plan, self._capture.timing
        if plan.is_wall_known and positions:
            self._capture.findings += wall_time_findings(
                self._controls,
                [plan.settings[place] for place in positions],
                planned_s=timing["planned_wall_s"],
                actual_s=timing["actual_wall_s"],
            )

    def _shoot(self, positions: list[int]) -> float:
        """Shoot the settings at `positions`; frames are processed during later exposures.

        Returns:
            the time until the last frame arrived, by the camera's clock, s
        """
        began = arrived = self._camera.clock.now()
        if not positions:
            return 0.0
        waiting: deque[Future[None]] = deque()
        with Threads(1, thread_name_prefix="camctl-frame") as worker:
            try:
                self._report_progress("shooting")
                settings = [self._capture.plan.settings[position] for position in positions]
                self._checks.begin(positions)
                with (
                    closing(shoot_when_ready(self._camera, settings)) as frames,
                    cancelled_by(self._is_to_end),
                ):
                    for frame in frames:
                        arrived = self._camera.clock.now()
                        most = max(1, WAITING_BYTES // frame.pixels.nbytes)
                        while waiting and (waiting[0].done() or len(waiting) >= most):
                            waiting[0].result()
                            waiting.popleft()
                        position = positions[frame.index]
                        before = waiting[-1] if waiting else None
                        waiting.append(worker.submit(self._take, frame, position, before))
                        self._arrived.add(position)
                        check_cancelled()
                        self._report_progress("shooting")
            finally:
                # Whatever happened to the camera, the frames that have arrived are kept.
                _wait_for(waiting)
        missing = sum(self._capture.frames[position] is None for position in positions)
        if missing:
            raise CaptureError(f"the camera ended the sequence {missing} frames early")
        self._report_progress("shooting")
        return arrived - began

    def _report_progress(self, stage: str) -> None:
        """Report progress, weighted by the time that the frames take."""
        plan, interval_s = self._capture.plan, self._controls.frame_interval_s
        times = [max(setting.time_s, interval_s) for setting in plan.settings]
        share = sum(times[position] for position in self._arrived) / sum(times)
        self._on_progress(Progress(len(self._arrived), len(times), stage, share, plan))

    def _take(self, frame: Frame, position: int, before: Future[None] | None) -> None:
        """Store a frame, compare it with its neighbours, add it to the sum.

        Where this failed for the frame `before` it fails again: nothing is stored after an error.
        """
        if before is not None:
            before.result()
        files = self._store.keep(frame, position)
        if (frame.black, frame.white) != (self._controls.black, self._controls.white):
            self._capture.rejected += self._store.reject(position)
            self._store.save_report(self._capture)
            raise CaptureError(
                f"the camera changed its black and white level to {frame.black} and {frame.white} "
                f"within the capture",
                hint="keep gain and format fixed, and shoot again",
            )
        saturated = count_from(frame.pixels, frame.white)
        self._capture.frames[position] = StoredFrame(
            **vars(files),
            requested=frame.requested,
            applied=frame.applied,
            requested_s=frame.requested.time_s,
            applied_s=frame.applied.time_s,
            black=frame.black,
            white=frame.white,
            saturated_fraction=saturated / frame.pixels.size,
            timestamp_s=frame.timestamp_s if math.isfinite(frame.timestamp_s) else 0.0,
            lost=frame.lost,
            details=clean_details(frame.details),
        )
        try:
            self._store.save_report(self._capture)
        except BaseException:
            self._capture.frames[position] = None  # it is not counted as kept
            raise
        self._add(position, frame.pixels)

    def _add(self, position: int, pixels: Pixels) -> None:
        """Compare with the neighbours that have arrived, and sum."""
        self._checks.add(position, pixels)
        if self._sum is None:
            count = len(self._capture.frames)
            self._sum = Accumulator(pixels.shape, pixels.dtype, count, self._controls.white)
        self._sum.accumulate(pixels)

    def _kept_samples(self, position: int) -> Pixels:
        """Return the samples of a frame that was shot before; raise `DataError` if they are not."""
        pixels, controls = self._store.frame(position), self._controls
        shape = (*controls.shape, 3) if controls.layout is Layout.RGB else controls.shape
        dtype = np.dtype(np.uint8 if controls.bits <= 8 else np.uint16)
        if (pixels.shape, pixels.dtype) != (shape, dtype):
            raise DataError(
                f"frame {position + 1} holds {pixels.shape} {pixels.dtype}, and the camera makes "
                f"{shape} {dtype}",
                hint="set the same format",
            )
        return pixels

    def _shoot_suspects_again(self) -> None:
        """Shoot frames with a wrong exposure again, once; not in a capture that was cancelled."""
        again = self._checks.suspects()
        if not again or self._cancelled():
            return
        self._shoot_again(again)

    def _settle_if_late(self) -> None:
        """Let the camera settle, and shoot all again, where its control delay may be wrong.

        One wrong frame can look like that: it has been shot again before.  What settled frames
        show tells whether it was the delay.
        """
        if not self._checks.are_to_settle or self._cancelled():
            return
        if not use_delay(self._camera, None):
            return
        self._checks.settle()
        self._shoot_again(range(len(self._capture.frames)))

    def _shoot_again(self, again: Iterable[int]) -> None:
        """Shoot frames that have arrived in place of themselves."""
        again = list(again)
        assert self._sum is not None  # all frames were added
        for position in again:
            self._sum.withdraw(self._store.frame(position))
            self._checks.remove(position)
            self._capture.rejected += self._store.reject(position)
            self._capture.frames[position] = None
            self._arrived.discard(position)
        self._store.save_report(self._capture)
        self._shoot(again)
        for position in again:
            frame = self._capture.frames[position]
            assert frame is not None  # `_shoot` has taken it
            frame.attempts = 2


@uninterrupted
def _wait_for(waiting: Iterable[Future[None]]) -> None:
    for each in waiting:
        each.result()


def _is_made_from_message(error: CamctlError) -> bool:
    """Return whether an error of this kind can be made again from a message alone."""
    return type(error).__init__ is CamctlError.__init__
