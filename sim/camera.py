"""The simulated camera: a driver for simulated hardware, with the interface of all cameras."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace

from camctl.camera import CameraBase, CameraInfo, Frame, Pixels
from camctl.clock import Clock, VirtualClock
from camctl.controls import ExposureSetting
from camctl.errors import CameraBusyError, CameraTimeoutError
from camctl.streaming import (
    ControlDelay,
    DelayOrigin,
    ExposurePipeline,
    FrameStamp,
    Shot,
    Written,
)
from sim.effects.budget import FramePlan
from sim.render import Renderer
from sim.scenes.scene import Scene
from sim.scenes.view import View, photons_per_unit
from sim.sensors.sensor import Sensor
from sim.streaming_device import Buffer, SimulatedDevice, Slot

#: Time without a frame, beyond the time that the frame itself takes, after which the camera counts
#: as failed.
SILENCE_S = 5.0


@dataclass(frozen=True)
class Faults:
    """Faults of the simulated hardware.

    Frames are counted from 0 over all that `shoot` and `step` return.

    Attributes:
        unplug_after: the cable is pulled after this number of frames
        freeze_after: the stream stops after this number of frames
        busy_calls: number of first calls of `shoot`, `step` or `preview` that find the camera busy
        wrong_exposure: frame number to the factor by which its exposure differs from `applied`
    """

    unplug_after: int | None = None
    freeze_after: int | None = None
    busy_calls: int = 0
    wrong_exposure: Mapping[int, float] = field(default_factory=dict)


class SimulatedCamera(CameraBase):
    """A camera with `sensor` in front of `scene`; a `PreviewingCamera` and a `StreamingCamera`.

    The constructor opens it, since there is nothing to connect to; `open` opens it again after
    `close`, with a stream that begins anew.

    Args:
        scene: frames have the scene's size
        sensor: see `sim.sensors.sensor.Sensor`
        clock: virtual by default, so that nothing waits
        seed: of all noise; the same seed, settings and calls give the same frames
        faults: of the hardware
        tolerance_dn: the most that leaving out effects may change in any sample, DN, summed over
            the frames of one `shoot`: each of n frames has 1/n of it.  0, the default, leaves
            nothing out: an average over a bracket of interleaved exposures shows far less than one
            level, and a tolerance of more than 0.05 would distort it.
        repeat_noise: every frame has the noise of frame 0, so that it depends on its exposure
            alone, as with `sim.devices.common.VirtualSensor`

    Attributes:
        scene, sensor: as given
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
    ) -> None:
        super().__init__("the simulated camera", clock if clock is not None else VirtualClock())
        self.scene = scene
        self.sensor = sensor
        # The profile belongs to the serial number: each sensor has a profile of its own.
        self._info = CameraInfo("sim", "camctl", f"simulated {sensor.name}", sensor.name, "sim")
        most = sensor.delay_frames + sensor.delay_jitter_frames
        self._delay = ControlDelay(sensor.delay_frames, most, DelayOrigin.GUARANTEED)
        self._controls = sensor.controls(
            scene.shape,
            is_coloured=scene.is_coloured,
            photons_per_unit=photons_per_unit(scene, sensor),
            notes=(*scene.notes, *self._delay.notes("sim")),
        )
        self._renderer = Renderer(
            View.of(scene, sensor), sensor, seed=seed, tolerance_dn=tolerance_dn
        )
        self._seed = seed
        self._repeat_noise = repeat_noise
        self._tolerance_share = 1.0
        self._plan: FramePlan | None = None
        self._faults = faults or Faults()
        self._busy_calls = self._faults.busy_calls
        self._frames_returned = 0
        self.open()

    @property
    def last_plan(self) -> FramePlan | None:
        """Which effects the last frame has; None before the first."""
        return self._plan

    @property
    def frames_lost(self) -> int:
        """Frames that the device dropped because they were not taken in time."""
        return self.device.lost

    @property
    def mode(self) -> str:
        """Pixel layout, bits, size and frame rate, such as mono8-640x480-30."""
        controls = self.controls
        rows, columns = controls.shape
        rate = round(1 / self.sensor.frame_interval_s, 3)
        return f"{controls.layout}{controls.bits}-{columns}x{rows}-{rate:g}"

    def preview(self, setting: ExposureSetting) -> Frame:
        """Return one frame at `setting`; `Faults` do not count it."""
        self._check_ready()
        self.controls.check(setting)
        self._tolerance_share = 1.0
        shot = next(self._pipeline(lambda: None).shoot((setting,)))
        return self._frame(shot, setting, light=1.0)

    def step(self, before: ExposureSetting, after: ExposureSetting, frames: int) -> list[Frame]:
        """Return the frames after a change of exposure; see `StreamingCamera.step`."""
        self._check_ready()
        for setting in (before, after):
            self.controls.check(setting)
        # All are taken before the first is rendered, which may take longer than a frame.
        shots = self._pipeline(self._cause_faults).step(before, after, frames)
        self._tolerance_share = 1.0
        return [self._counted_frame(shot, after) for shot in shots]

    def _open(self) -> None:
        self.device = SimulatedDevice(self.sensor, self._render, self._clock, seed=self._seed)

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
        for shot in self._pipeline(self._cause_faults).shoot(settings):
            yield self._counted_frame(shot, settings[shot.index])
            self._check_open()

    def _pipeline(self, before_frame: Callable[[], None]) -> ExposurePipeline[Buffer]:
        return ExposurePipeline(_DeviceFrames(self.device, before_frame), self._delay)

    def _cause_faults(self) -> None:
        """Cause the faults that are due, once."""
        if self._frames_returned == self._faults.unplug_after:
            self._faults = replace(self._faults, unplug_after=None)
            self.device.unplug()
        if self._frames_returned == self._faults.freeze_after:
            self._faults = replace(self._faults, freeze_after=None)
            self.device.freeze()

    def _counted_frame(self, shot: Shot[Buffer], requested: ExposureSetting) -> Frame:
        light = self._faults.wrong_exposure.get(self._frames_returned, 1.0)
        self._frames_returned += 1
        return self._frame(shot, requested, light=light)

    def _frame(self, shot: Shot[Buffer], requested: ExposureSetting, *, light: float) -> Frame:
        pixels = self.device.read_out(shot.data, light=light)
        assert self._plan is not None  # `_render` has set it
        return Frame(
            pixels=pixels,
            requested=requested,
            applied=shot.applied,
            timestamp_s=shot.time_s,
            index=shot.index,
            black=self.controls.black,
            white=self.controls.white,
            details={"simulation": self._plan.as_data()},
        )

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
        self._plan = self._renderer.plan(exposure, share=self._tolerance_share)
        return self._renderer.expose(exposure, self._plan)


class _DeviceFrames:
    """The stream of a simulated device, which numbers its frames: a `NumberedSource[Buffer]`.

    Args:
        device: the hardware
        before_frame: called before each frame is taken
    """

    def __init__(self, device: SimulatedDevice, before_frame: Callable[[], None]) -> None:
        self._device = device
        self._before_frame = before_frame
        self._buffer: Buffer | None = None

    def next_frame(self) -> FrameStamp:
        self._before_frame()
        self._buffer = self._device.dequeue(SILENCE_S)
        if self._buffer is None:
            raise CameraTimeoutError(
                f"no frame from the simulated camera for {SILENCE_S:g} s",
                hint="unplug it, plug it in again and resume",
            )
        return FrameStamp(self._buffer.sequence, self._buffer.timestamp_s)

    def read(self) -> Buffer | None:
        return self._buffer

    def upcoming(self, *, late: bool = False) -> int:
        return self._device.upcoming

    def write(self, setting: ExposureSetting) -> Written:
        slot, applied = self._device.write(setting)
        return Written(applied, slot, slot)
