"""`camctl.live`: the effective camera as a stream of results."""

from __future__ import annotations

import asyncio
import threading
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from typing import Literal, Self

from camctl.errors import (
    CameraClosedError,
    CameraDisconnectedError,
    CameraError,
    CameraTimeoutError,
    CaptureError,
    UsageError,
)
from camctl.exposure.goal import CaptureRequest
from camctl.findings import Finding, note
from camctl.interface.camera import Camera, Frame, use_delay
from camctl.interface.clock import VirtualClock, cancelled_by
from camctl.interface.controls import ExposureControls
from camctl.interface.cycle import CyclingCamera, FrameCycle
from camctl.livestream.disagreement import Disagreement, OtherExposures, other_exposures
from camctl.livestream.planning import Following, LivePlanner, Look, measured_noise
from camctl.livestream.result import Arrays, LiveResult
from camctl.livestream.tables import ExposureSet, KeptTables, SumTable
from camctl.livestream.window import Window
from camctl.records.capture_plan import CapturePlan

Policy = Literal["latest", "all"]

#: Frames after which light and exposures are looked at, at least; a round of the cycle, too.
_LOOK_FRAMES = 8
#: Looks in a row whose exposures contradict the plan, each after more than n + d frames.
_CONTRADICTING_LOOKS = 2
#: How often a camera that is gone is opened again, s.
_RETRY_S = 0.5


class Live:
    """Results of the effective camera, one for each frame after the first n + d.

    An iterator and an async iterator; also a context manager that ends the stream.  Any thread may
    call `change` and `close`.  See `camctl.live`.

    Attributes:
        planner: chooses the exposures
        lost: frames that did not arrive
        is_waiting: whether the camera is gone, and waited for
        on_waiting: called with the reason when that begins, and with None when the camera is back
    """

    def __init__(
        self,
        camera: CyclingCamera,
        request: CaptureRequest,
        fps: float | None,
        policy: Policy,
        *,
        reuse: bool,
        patience_s: float,
    ) -> None:
        self._camera, self._fps = camera, fps
        self.planner = LivePlanner(camera, request, fps)
        self._patience_s = patience_s
        self._is_virtual = isinstance(camera.clock, VirtualClock)
        self._pulls = policy == "all" or self._is_virtual
        self._arrays = Arrays(are_reused=reuse)
        self._state = threading.Condition()  # guards what follows
        self._plans: dict[int, CapturePlan] = {}
        self._wanted: CapturePlan | None = None  # the plan whose frames come next
        self._count = self._given = 0  # results made possible, and of them the last one given
        self._tables = KeptTables()
        self._error: BaseException | None = None
        self._is_closed = False
        self._step_lock = threading.Lock()  # held while a frame is taken
        self._cycle: FrameCycle | None = None
        self._reader: threading.Thread | None = None
        self._worker: ThreadPoolExecutor | None = None
        self._awaiting = ThreadPoolExecutor(1, thread_name_prefix="camctl-live-next")
        self._kept: deque[Future[LiveResult | None]] = deque()  # awaited by calls that were ended
        self._job: Future[None] | None = None
        self._following = Following()
        self._since_look = 0
        self._contradicting: list[OtherExposures] = []  # of looks in a row
        self._last_number: int | None = None
        self._findings: tuple[Finding, ...] = ()
        self._more_findings: list[Finding] = []
        self._next_planner: LivePlanner | None = None  # of a change that is to come
        self._measures_noise = False
        self.lost = 0
        self.is_waiting = False
        self.on_waiting: Callable[[CameraError | None], object] = lambda _: None

    # ---- for the consumer

    @property
    def plan(self) -> CapturePlan | None:
        """The plan whose frames come next; None before the first."""
        return self._wanted

    @property
    def controls(self) -> ExposureControls:
        """What the camera can set, and its noise, measured in the stream where it is unknown."""
        return self._controls

    def change(self, request: CaptureRequest) -> None:
        """Go on with another request, without a gap.

        Where this camera cannot meet it in the light that there is, the stream goes on as before,
        and says so in a finding.

        Raises:
            UsageError: no camera can meet it; the stream goes on as before
        """
        planner = LivePlanner(self._camera, request, self._fps)
        with self._state:
            self._next_planner = planner

    def close(self) -> None:
        """End the stream; the camera can shoot again.  A second call does nothing."""
        with self._state:
            self._is_closed = True
            self._state.notify_all()
        reader, worker = self._reader, self._worker
        if reader is not None and reader is not threading.current_thread():
            reader.join()
        with self._step_lock:
            self._end_cycle()
        if worker is not None:
            worker.shutdown()
        self._awaiting.shutdown()

    def __enter__(self) -> Self:
        """Begin the stream; raises as `__next__` does."""
        self._begin()
        return self

    def __exit__(self, *_: object) -> None:
        """End the stream."""
        self.close()

    def __iter__(self) -> Iterator[LiveResult]:
        return self

    def __next__(self) -> LiveResult:
        """Wait for the next result.

        Raises:
            CaptureError: the light cannot be metered, or the camera changed its format
            CameraError: the camera failed, or was gone for longer than the patience
        """
        result = self._kept.popleft().result() if self._kept else self._next()
        if result is None or self._is_closed:
            raise StopIteration
        return result

    def __aiter__(self) -> AsyncIterator[LiveResult]:
        return self

    async def __anext__(self) -> LiveResult:
        """Wait for the next result in a thread; raises as `__next__` does.

        Where the call is cancelled, the next one gets its result.
        """
        if self._is_closed:
            raise StopAsyncIteration
        waiting = self._kept.popleft() if self._kept else self._awaiting.submit(self._next)
        try:
            result = await asyncio.shield(asyncio.wrap_future(waiting))
        except asyncio.CancelledError:
            self._kept.append(waiting)
            raise
        if result is None:
            raise StopAsyncIteration
        return result

    # ---- taking frames

    def _next(self) -> LiveResult | None:
        self._begin()
        if self._pulls:
            while not self._step():
                if self._is_closed:
                    return None
        with self._state:
            self._state.wait_for(
                lambda: self._is_closed or self._error or self._count > self._given
            )
            if self._is_closed:
                return None
            if self._count == self._given and self._error is not None:
                raise self._error
            return self._result()

    def _begin(self) -> None:
        if self._has_begun:  # without the lock, which the reader has while it waits for a frame
            return
        with self._step_lock:
            if self._has_begun:
                return
            self._controls = self._camera.controls
            self._window = Window(self._controls)
            self._start_cycle(self.planner.first())
            self._worker = ThreadPoolExecutor(1, thread_name_prefix="camctl-live-plan")
            if not self._pulls:
                self._reader = threading.Thread(target=self._read, name="camctl-live", daemon=True)
                self._reader.start()

    @property
    def _has_begun(self) -> bool:
        return self._cycle is not None or self._error is not None or self._is_closed

    def _read(self) -> None:
        """Take frames until the stream ends: the thread of the policy "latest"."""
        with cancelled_by(lambda: self._is_closed):
            while not self._is_closed:
                try:
                    self._step()
                except BaseException as error:
                    with self._state:
                        self._error = error
                        self._state.notify_all()
                    return

    def _step(self) -> bool:
        """Take one frame; return whether it completes a result."""
        with self._step_lock:
            if self._is_closed:
                return False
            if len(self._contradicting) >= _CONTRADICTING_LOOKS:
                self._settle()
            assert self._cycle is not None  # it was begun
            try:
                frame = next(self._cycle)
            except CameraClosedError:  # by its owner: it is not waited for
                raise
            except (CameraDisconnectedError, CameraTimeoutError) as error:
                self._reconnect(error)
                return False
            except CameraError:
                if self._is_closed:
                    return False
                raise
            with self._state:
                is_result = self._take(frame)
                if is_result:
                    self._count += 1
                    self._state.notify_all()
            if is_result:
                self._look()
            return is_result

    def _take(self, frame: Frame) -> bool:
        assert frame.place is not None  # a frame of a cycle has one
        plan = self._plans[frame.place.plan]
        for number in [each for each in self._plans if each < frame.place.plan]:
            del self._plans[number]
        if self._last_number is not None:
            self.lost += frame.place.number - self._last_number - 1
        self._last_number = frame.place.number
        self._window.add(frame, len(plan.settings))
        self._shown = plan
        return self._window.is_complete

    def _start_cycle(self, plan: CapturePlan) -> None:
        cycle = self._camera.cycle(plan.settings)
        with self._state:
            self._cycle = cycle
            self._wanted = self._shown = plan
            self._plans = {0: plan}
            self._findings = tuple(plan.findings)
            self._window.clear()
            self._last_number = None
            self._disagreement = Disagreement(self._controls)
            self._tables.clear()
        self._measures_noise = self._controls.noise is None
        self._following.accept(None)
        self._contradicting, self._since_look = [], 0

    def _end_cycle(self) -> None:
        cycle, self._cycle = self._cycle, None
        if cycle is not None:
            with suppress(CameraError):
                cycle.close()

    def _reconnect(self, error: CameraError) -> None:
        """Open a camera that is gone until it is back; raise `error` after the patience."""
        self.is_waiting = True
        self.on_waiting(error)
        self._end_cycle()
        clock, began = self._camera.clock, self._camera.clock.now()
        while not self._is_closed:
            with suppress(CameraError):
                self._camera.close()
            try:
                self._camera.__enter__()
                assert self._wanted is not None  # a cycle was begun with it
                self._start_cycle(self._wanted)
                self.is_waiting = False
                self.on_waiting(None)
                return
            except CameraError:
                if clock.now() - began > self._patience_s:
                    raise error from None
            clock.sleep_until(clock.now() + _RETRY_S)

    # ---- results

    def _result(self) -> LiveResult:
        """Return the result of the present frames; the state is locked."""
        window, frames = self._window, tuple(self._window.frames)
        assert window.newest is not None
        total = self._arrays.get("sum", window.total.shape, window.total.dtype.type)
        total[...] = window.total
        self._given = self._count
        exposures = window.states(self._controls)
        time_s = window.newest.timestamp_s
        return LiveResult(
            number=self._count - 1,
            time_s=time_s,
            age_s=max(each.age_s for each in exposures),
            latency_s=self._camera.clock.now() - time_s,
            exposures=exposures,
            sum=total,
            plan=self._shown,
            findings=(*self._findings, *self._more_findings),
            layout=self._controls.layout,
            black=self._controls.black,
            white=self._controls.white,
            _tables=self._tables_of(frames),
            _frames=frames,
            _disagreement=self._disagreement,
            _arrays=self._arrays,
        )

    def _set_of(self, frames: tuple[Frame, ...]) -> ExposureSet:
        settings = tuple(frame.applied for frame in frames)
        base = min(map(self._controls.exposure, self._shown.settings))
        return ExposureSet(settings, base, self._shown.desired)

    def _tables_of(self, frames: tuple[Frame, ...]) -> tuple[SumTable, ...]:
        wanted = self._set_of(frames)
        # In virtual time nobody waits for the exact ones.
        is_exact = self._is_virtual and wanted.settings == self._shown.settings
        return self._tables.get(self._controls, wanted, is_exact=is_exact)

    # ---- looking at light and exposures

    def _look(self) -> None:
        """Look at the light from time to time, beside the stream where that is in real time."""
        self._since_look += 1
        is_due = self._since_look >= max(_LOOK_FRAMES, len(self._shown.settings))
        if not (is_due or self._next_planner):
            return
        if self._job is not None:
            if not self._job.done():
                return
            job, self._job = self._job, None
            job.result()
        self._since_look = 0
        with self._state:
            frames = tuple(self._window.frames)
            tables = self._tables_of(frames)
            wanted = self._set_of(frames)
            look = Look.at(self._window.total, self._controls.layout, tables)
        if self._is_virtual:
            self._inspect(frames, look, wanted)
        else:
            assert self._worker is not None
            self._job = self._worker.submit(self._inspect, frames, look, wanted)

    def _inspect(self, frames: tuple[Frame, ...], look: Look, wanted: ExposureSet) -> None:
        is_whole = {frame.place.plan for frame in frames if frame.place} == {max(self._plans)}
        if not is_whole:
            return
        if self._measures_noise:
            self._measure_noise(frames)
        else:
            self._tables.make_exact(self._controls, wanted, self._state)
        found = other_exposures(self._controls, frames)
        # Looks of another plan say nothing of this one.
        before = [each for each in self._contradicting if found and found.is_of_plan(each)]
        self._contradicting = [] if found is None else [*before, found]
        self._more_findings = self.planner.light_findings(look, wanted.desired.dynamic_range)
        is_other = self._following.is_other(look) and self.planner.request.base_s is None
        if is_other or self._next_planner:
            self._plan_again(look)

    def _measure_noise(self, frames: tuple[Frame, ...]) -> None:
        self._measures_noise = False
        noise = measured_noise(self._controls, frames)
        if noise is not None:
            with self._state:
                self._controls = replace(self._controls, noise=noise)
                self._tables.clear()
                self._disagreement = Disagreement(self._controls)

    def _settle(self) -> None:
        """Say why exposures contradict; let the camera settle where its delay may be the reason."""
        before, found = self._contradicting[-_CONTRADICTING_LOOKS:]
        reason, has_delay = found.reason(before), self._controls.delay_frames is not None
        if reason == "exposures":
            finding = found.finding([each.applied for each in self._window.frames])
        elif reason == "delay" and has_delay and use_delay(self._camera, None):
            measure = {"calibrate_delay": self._camera.info.id}
            finding = Finding(code="stream_settles", remedies=measure)
            self._end_cycle()
            self._controls = replace(self._camera.controls, noise=self._controls.noise)
            assert self._wanted is not None  # a cycle was begun with it
            self._start_cycle(self._wanted)
        else:
            finding = Finding(code="light_varies", details={"within": "stream"})
        self._contradicting = []
        self._add(finding)

    def _add(self, finding: Finding) -> None:
        """State a finding, once for each code."""
        others = (each for each in self._findings if each.code != finding.code)
        self._findings = (*others, finding)

    def _plan_again(self, look: Look) -> None:
        """Choose exposures for the light of the stream, and exchange the list."""
        before, cycle = self._wanted, self._cycle
        if before is None or cycle is None:
            return
        with self._state:
            changed, self._next_planner = self._next_planner, None
        planner = changed or self.planner
        try:
            plan = planner.again(look.light(self._controls, before.settings))
        except (CaptureError, UsageError) as error:
            if changed is None:
                self._following.accept(look, is_final=True)  # there are no better ones
            else:
                self._add(note(str(error)))
            return
        self.planner = planner
        if (plan.settings, plan.desired.key) == (before.settings, before.desired.key):
            self._following.accept(look, is_final=True)
            return
        with self._state:
            if self._cycle is not cycle:
                return
            self._plans[cycle.exchange(plan.settings)] = plan
            self._wanted = plan
            self._findings = tuple(plan.findings)
        self._following.accept(None)


def live(
    camera: Camera,
    request: CaptureRequest | None = None,
    *,
    fps: float | None = None,
    policy: Policy = "latest",
    reuse: bool = False,
    patience_s: float = 60.0,
) -> Live:
    """Return the results of the effective camera, live: one for each frame.

    The camera repeats the exposures of a plan.  Any n frames in a row hold each of them, so that
    each frame completes a result.  Exposures follow the light by what the stream shows, without
    frames for metering; a camera that is unplugged is waited for.

    Args:
        camera: an open camera that streams, see `camctl.interface.cycle`
        request: what the results are to be; None: the defaults
        fps: results a second at least, which limits the exposure times; None: 10
        policy: for a consumer that is slower than the camera: "latest" gives it the newest result,
            "all" one for each frame that arrives, while the camera may lose some.  A camera in
            virtual time waits for the consumer
        reuse: the arrays of a result are overwritten by the next one: no memory is allocated
        patience_s: how long a camera that is gone is waited for, s

    Raises:
        UsageError: the camera does not stream, or sends fewer frames; the request cannot be met

    >>> import camctl
    >>> with camctl.open_camera("sim", size="64x48") as camera, camctl.live(camera) as results:
    ...     result = next(results)
    >>> result.irradiance.shape, len(result.exposures)
    ((48, 64), 3)
    """
    if not isinstance(camera, CyclingCamera):
        raise UsageError(
            f"{camera.info.id} takes single pictures, and does not stream",
            hint="take pictures with it, or use a webcam or a camera for machine vision",
        )
    if policy not in ("latest", "all"):
        raise UsageError(f"invalid policy {policy!r}: expected latest or all")
    return Live(
        camera, request or CaptureRequest(), fps, policy, reuse=reuse, patience_s=patience_s
    )
