"""The simulated camera: a driver for simulated hardware, with the interface of all cameras."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from statistics import median

from camctl.errors import (
    CameraBusyError,
    CameraError,
    CameraTimeoutError,
    InterruptedCaptureError,
    UsageError,
)
from camctl.findings import note
from camctl.interface.camera import CameraBase, CameraInfo, Frame, MeasuredDelay, Pixels
from camctl.interface.clock import Clock, VirtualClock
from camctl.interface.controls import ExposureControls, ExposureSetting, ResponseOrigin
from camctl.profiles.profile import load_profile
from camctl.sim.damage import damaged
from camctl.sim.effects.budget import FramePlan
from camctl.sim.effects.record import Shot as RenderedShot
from camctl.sim.faults import Faults as Faults
from camctl.sim.recorded_stream import RecordedStream
from camctl.sim.render import Comparison, Renderer
from camctl.sim.scenes.scene import Scene
from camctl.sim.scenes.view import View, photons_per_unit
from camctl.sim.sensors.sensor import Sensor
from camctl.sim.streaming_device import Buffer, SimulatedDevice, Slot
from camctl.streaming import (
    ControlDelay,
    DelayOrigin,
    ExposureCycle,
    ExposurePipeline,
    FrameStamp,
    NumberedSource,
    Shot,
    StreamCycle,
    TimestampedStream,
    Written,
    mean_brightness,
    resting_setting,
    with_delay,
)

#: Time without a frame, beyond the time that the frame itself takes, after which the camera counts
#: as failed.
SILENCE_S = 5.0

#: Last frames whose median time to render is stated.
_READOUTS = 16


class SimulatedCamera(CameraBase):
    """A camera with `sensor` in front of `scene`; a `PreviewingCamera` and a `StreamingCamera`.

    The constructor opens it, since there is nothing to connect to; `open` opens it again after
    `close`, with a stream that begins anew.

    Args:
        scene: frames have the scene's size
        sensor: see `camctl.sim.sensors.sensor.Sensor`
        clock: virtual by default, so that nothing waits
        seed: of all noise; the same seed, settings and calls give the same frames
        faults: of the hardware
        tolerance_dn: the most that leaving out effects may change in any sample, DN, summed over
            the frames of one `shoot`: each of n frames has 1/n of it.  0, the default, leaves
            nothing out: an average over a bracket of interleaved exposures shows far less than one
            level, and a tolerance of more than 0.05 would distort it.
        repeat_noise: every frame has the noise of frame 0, so that it depends on its exposure
            alone, as with `camctl.sim.devices.common.VirtualSensor`
        is_unknown: the camera states neither response, noise nor sensitivity, and its control delay
            is taken from its profile
        states: frames state their exposures, see `camctl.streaming.FrameStamp.applied`
        stream: a real one, whose frames are lost and late in the same manner, none of them longer
            than the frame interval; None: no frame is lost or late

    Attributes:
        scene, is_unknown: as given
        sensor: as given, with the shorter exposures of a real stream
        device: the simulated hardware

    Raises:
        UsageError: a seed or a tolerance out of range
    """

    device: SimulatedDevice

    def __init__(
        self,
        scene: Scene,
        sensor: Sensor,
        *,
        clock: Clock | None = None,
        seed: int = 0,
        faults: Faults | None = None,
        tolerance_dn: float = 0.0,
        repeat_noise: bool = False,
        is_unknown: bool = False,
        states: bool = False,
        stream: RecordedStream | None = None,
    ) -> None:
        super().__init__("the simulated camera", clock if clock is not None else VirtualClock())
        if stream is not None:  # its times say which slot a frame has: all slots are equally long
            longest_s = min(sensor.time_maximum_s, sensor.frame_interval_s)
            sensor = sensor.model_copy(update={"time_maximum_s": longest_s})
        self.scene = scene
        self.sensor = sensor
        # The profile belongs to the serial number: each sensor has a profile of its own.
        self._info = CameraInfo("sim", "camctl", f"simulated {sensor.name}", sensor.name, "sim")
        self._delay = replace(ControlDelay.of(sensor.delay), origin=DelayOrigin.GUARANTEED)
        controls = sensor.controls(
            scene.shape,
            is_coloured=scene.is_coloured,
            photons_per_unit=photons_per_unit(scene, sensor),
        )
        self.is_unknown = is_unknown
        if is_unknown:
            # The samples of a mosaic are raw, and so linear.
            known = controls.layout.is_mosaic
            controls = replace(
                controls,
                response=None,
                response_origin=ResponseOrigin.STATED if known else ResponseOrigin.ASSUMED,
                noise=None,
                sensitivity=None,
            )
            delays = load_profile(self._info).delays
            self._delay = ControlDelay.from_record(delays.get(_mode(controls, sensor)))
        self._controls = replace(
            controls,
            delay_frames=self._delay.frames,
            timing=replace(
                # In virtual time a setting is written at the very begin of a frame that is on time.
                self._delay.timing(
                    0.0 if isinstance(self._clock, VirtualClock) and stream is None else 0.5
                ),
                rests=self._delay.frames is not None,
            ),
            findings=(*map(note, scene.notes), *self._delay.findings("sim")),
        )
        self._renderer = Renderer(
            View.of(scene, sensor), sensor, seed=seed, tolerance_dn=tolerance_dn
        )
        self._readouts_s: deque[float] = deque(maxlen=_READOUTS)
        self._has_rendered = False
        self._seed = seed
        self._repeat_noise = repeat_noise
        self._states = states
        self._manners = stream
        self._tolerance_share = 1.0
        self._plan: FramePlan | None = None
        self._exposure: RenderedShot | None = None
        self._faults = faults or Faults()
        self._busy_calls = self._faults.busy_calls
        self._before: Pixels | None = None
        self._frames_returned = 0
        self.open()

    @property
    def last_plan(self) -> FramePlan | None:
        """Which effects the last frame has; None before the first."""
        return self._plan

    def compare_last(self) -> Comparison:
        """Return what the last frame lacks: it is rendered again with and without every effect."""
        if self._exposure is None or self._plan is None:
            raise UsageError("no frame was taken", hint="take a frame first")
        return self._renderer.compare(self._exposure, self._plan)

    @property
    def unused_faults(self) -> list[str]:
        """Faults of frames that were not taken yet, as the option `faults` has them."""
        return self._faults.unused(self._frames_returned)

    @property
    def mode(self) -> str:
        return _mode(self.controls, self.sensor)

    def preview(self, setting: ExposureSetting) -> Frame:
        """Return one frame at `setting`; `Faults` do not count it."""
        self._check_ready()
        self.controls.check(setting)
        self._tolerance_share = 1.0
        shooting = self._pipeline(lambda: None).shoot(
            (setting,), resting_setting(self.controls, (setting,))
        )
        shot = next(shooting)
        return self._frame(shot, setting, light=self._faults.light(-1, shot.applied.time_s))

    def cycle(self, settings: Sequence[ExposureSetting]) -> StreamCycle[Buffer]:
        """Return frames without end; see `camctl.interface.cycle.CyclingCamera`."""
        requested = self._checked(settings)
        endless = ExposureCycle.of(self._pipeline(self._cause_faults), requested)
        self._is_shooting = True
        self._tolerance_share = 1 / len(settings)
        return StreamCycle(
            endless, self.controls, self._check_open, self._counted_frame, self._end_cycle
        )

    def _end_cycle(self) -> None:
        self._is_shooting = False

    def use_delay(self, delay: MeasuredDelay | None) -> None:
        """Use a measured control delay from now on; see `camctl.interface.camera.use_delay`."""
        self._delay = ControlDelay.of(delay)
        self._controls = with_delay(self.controls, self._delay, self.info.id)

    def step(
        self, before: ExposureSetting, after: ExposureSetting, frames: int, *, early: int = 0
    ) -> list[Frame]:
        self._check_ready()
        for setting in (before, after):
            self.controls.check(setting)
        # All are taken before the first is rendered, which may take longer than a frame.
        shots = self._pipeline(self._cause_faults).step(before, after, frames, early=early)
        self._tolerance_share = 1.0
        return [self._counted_frame(shot, after) for shot in shots]

    def _open(self) -> None:
        self.device = SimulatedDevice(
            self.sensor,
            self._render,
            self._clock,
            late_frames=self._faults.late_frames,
            seed=self._seed,
            stream=self._manners,
        )
        # None: nothing is stated
        late = self._faults.stated_late if self._states else None
        self._device_frames = _DeviceFrames(self.device, self._clock_offset_s, late)
        source: NumberedSource[Buffer] = self._device_frames
        if self._manners is not None:
            timed = _TimedFrames(self._device_frames, is_numbered=self._manners.is_numbered)
            source = TimestampedStream(
                timed, self._clock, self.sensor.frame_interval_s, timed.number, timed.stated
            )
            source.start()
        self._stream = ExposurePipeline(source, self._delay, self._brightness)

    def _close(self) -> None:
        """There is nothing to disconnect."""

    def _check_ready(self) -> None:
        super()._check_ready()
        if self._busy_calls > 0:
            self._busy_calls -= 1
            raise CameraBusyError(
                "the simulated camera is busy", hint="close what else uses it and try again"
            )

    def _frames(self, settings: tuple[ExposureSetting, ...]) -> Iterator[Frame]:
        self._tolerance_share = 1 / max(1, len(settings))
        rest = resting_setting(self.controls, settings)
        try:
            for shot in self._pipeline(self._cause_faults).shoot(settings, rest):
                yield self._counted_frame(shot, settings[shot.index])
                self._check_open()
        except (GeneratorExit, KeyboardInterrupt, InterruptedCaptureError):
            longest = max(settings, key=lambda setting: setting.time_s)
            with suppress(CameraError):  # it was unplugged meanwhile
                self.device.abort(resting_setting(self.controls, [longest]))
            self._stream.release()
            raise

    def _pipeline(self, before_frame: Callable[[], None]) -> ExposurePipeline[Buffer]:
        """Return the pipeline of the open device, which calls this before each frame."""
        self._device_frames.before_frame = before_frame
        self._stream.delay = self._delay
        return self._stream

    def _brightness(self, buffer: Buffer) -> float:
        return mean_brightness(self.device.read_out(buffer), self.controls.white)

    def _clock_offset_s(self) -> float:
        return self._faults.clock_offset_s(self._frames_returned)

    def _cause_faults(self) -> None:
        """Cause the faults that are due, once."""
        if self._frames_returned == self._faults.unplug_after:
            self._faults = replace(self._faults, unplug_after=None)
            self.device.unplug()
        if self._frames_returned == self._faults.freeze_after:
            self._faults = replace(self._faults, freeze_after=None)
            self.device.freeze()
        number = self._frames_returned
        if number in self._faults.dropped_frames:
            dropped = [each for each in self._faults.dropped_frames if each != number]
            self._faults = replace(self._faults, dropped_frames=dropped)
            self.device.drop_next()
        if number in self._faults.delayed_frames:
            delayed = dict(self._faults.delayed_frames)
            self._clock.sleep_until(self._clock.now() + delayed.pop(number))
            self._faults = replace(self._faults, delayed_frames=delayed)

    def _counted_frame(self, shot: Shot[Buffer], requested: ExposureSetting) -> Frame:
        number, faults = self._frames_returned, self._faults
        self._frames_returned += 1
        light = faults.light(number, shot.applied.time_s)
        frame = self._frame(shot, requested, light=light)
        if number in faults.repeated_frames and self._before is not None:
            frame = replace(frame, pixels=self._before)
        for kind in faults.damages(number):
            frame = replace(frame, pixels=damaged(frame.pixels, kind, number, frame.white))
        if faults.repeated_frames:
            self._before = frame.pixels
        return frame

    def _frame(self, shot: Shot[Buffer], requested: ExposureSetting, *, light: float) -> Frame:
        began_s = self._clock.now()
        pixels = self.device.read_out(shot.data, light=light)
        self._measure_readout(self._clock.now() - began_s)
        assert self._plan is not None  # `_render` has set it
        return Frame(
            pixels=pixels,
            requested=requested,
            applied=shot.applied,
            timestamp_s=shot.time_s,
            index=shot.index,
            black=self.controls.black,
            white=self.controls.white,
            details={"simulation": self._plan.summary()},
            lost=shot.lost,
        )

    def _measure_readout(self, readout_s: float) -> None:
        """Keep how long it takes to render a frame, which counts in real time."""
        is_first, self._has_rendered = not self._has_rendered, True
        if readout_s == 0 or is_first:  # the first frame computes what all of them need
            return
        self._readouts_s.append(readout_s)
        assert self._controls is not None
        assert self._controls.timing is not None
        timing = replace(self._controls.timing, readout_s=median(self._readouts_s))
        self._controls = replace(self._controls, timing=timing)

    def _render(self, slot: Slot) -> Pixels:
        if self._repeat_noise:
            exposure = self._renderer.shot(slot.time_s, slot.gain, 0)
        else:
            exposure = self._renderer.shot(
                slot.time_s,
                slot.gain,
                slot.sequence,
                start_s=slot.start_s,
                previous_s=slot.previous_s,
            )
        self._exposure = exposure
        self._plan = self._renderer.plan(exposure, share=self._tolerance_share)
        return self._renderer.expose(exposure, self._plan)


def _mode(controls: ExposureControls, sensor: Sensor) -> str:
    rows, columns = controls.shape
    rate = round(1 / sensor.frame_interval_s, 3)
    return f"{controls.layout}{controls.bits}-{columns}x{rows}-{rate:g}"


class _DeviceFrames:
    """The stream of a simulated device, which numbers its frames: a `NumberedSource[Buffer]`.

    Args:
        device: the hardware
        clock_offset_s: returns by how much the device's clock is wrong
        stated_late: frames by which the exposure that it states is too late; None: it states none

    Attributes:
        before_frame: called before each frame is taken
    """

    def __init__(
        self,
        device: SimulatedDevice,
        clock_offset_s: Callable[[], float],
        stated_late: int | None,
    ) -> None:
        self._device = device
        self._stated: deque[ExposureSetting] | None = None
        if stated_late is not None:
            self._stated = deque(maxlen=stated_late + 1)
        self.before_frame: Callable[[], None] = lambda: None
        self._clock_offset_s = clock_offset_s
        self._buffer: Buffer | None = None

    def next_frame(self) -> FrameStamp:
        self.before_frame()
        self._buffer = self._device.dequeue(SILENCE_S)
        if self._buffer is None:
            raise CameraTimeoutError(
                f"no frame from the simulated camera for {SILENCE_S:g} s",
                hint="unplug it, plug it in again and resume",
            )
        stamp_s = self._buffer.stamp_s + self._clock_offset_s()
        if self._stated is None:
            return FrameStamp(self._buffer.sequence, stamp_s)
        self._stated.append(self._buffer.exposed)
        return FrameStamp(self._buffer.sequence, stamp_s, applied=self._stated[0])

    def read(self) -> Buffer | None:
        return self._buffer

    def upcoming(self, *, late: bool = False) -> int:
        return self._device.upcoming

    def write(self, setting: ExposureSetting) -> Written:
        slot, applied = self._device.write(setting)
        return Written(applied, slot, slot)


class _TimedFrames:
    """The same frames as a `TimestampedSource[Buffer]`: their times say when their slots ended.

    Args:
        frames: of the device
        is_numbered: whether they state numbers
    """

    def __init__(self, frames: _DeviceFrames, *, is_numbered: bool) -> None:
        self._frames = frames
        self._is_numbered = is_numbered
        self._last: FrameStamp | None = None

    def grab(self) -> float:
        self._last = self._frames.next_frame()
        return self._last.time_s

    def number(self) -> int | None:
        """Return what the last frame states."""
        return self._last.number if self._is_numbered and self._last else None

    def stated(self, _: Buffer | None) -> ExposureSetting | None:
        """Return what the last frame states of its exposure."""
        return self._last.applied if self._last else None

    def retrieve(self) -> Buffer | None:
        return self._frames.read()

    def write(self, setting: ExposureSetting) -> ExposureSetting:
        return self._frames.write(setting).applied
