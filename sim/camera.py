"""The simulated camera: a driver on simulated hardware, behind the interface of all cameras."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from camctl.camera import CameraInfo, Closing, Frame, FrameStream, Pixels
from camctl.clock import Clock, VirtualClock
from camctl.controls import ExposureControls, ExposureSetting
from camctl.errors import (
    CameraBusyError,
    CameraDisconnectedError,
    CameraProtocolError,
    CameraTimeoutError,
)
from sim.effects.budget import FramePlan
from sim.render import Renderer
from sim.scenes.scene import Scene
from sim.scenes.view import View, photons_per_unit
from sim.sensors.sensor import Sensor
from sim.streaming_device import Buffer, SimulatedDevice, Slot

SILENCE_S = 5.0


@dataclass(frozen=True)
class Faults:
    """What goes wrong, as it does with real hardware.

    Frames are counted from 0 as `shoot` and `step` hand them over, since the camera was opened.

    Attributes:
        unplug_after: the cable is pulled after so many frames
        freeze_after: the stream falls silent after so many frames
        busy_calls: so many first calls of shoot or preview find the camera busy
        wrong_exposure: frame number to the factor by which its light is not what `applied` says
    """

    unplug_after: int | None = None
    freeze_after: int | None = None
    busy_calls: int = 0
    wrong_exposure: Mapping[int, float] = field(default_factory=dict)


class SimulatedCamera(Closing):
    """A camera with `sensor` before `scene`; implements `PreviewingCamera` and `StreamingCamera`.

    Args:
        scene: what it looks at; the frame has the scene's size
        sensor: see `sim.sensors.sensor.Sensor`
        clock: virtual by default, so that nothing waits
        seed: of all noise; the same seed, settings and calls give the same frames
        faults: what goes wrong
        threads: that render a frame (1 or 2); the frame is the same
        tolerance_dn: most that leaving effects out may change in any sample, DN, summed over the
            frames of one `shoot`: each of n frames has 1/n of it.  0, the default, leaves nothing
            out: averages over a bracket of interleaved exposures show far less than a level, and
            a tolerance of more than 0.05 would spoil them.
        repeat_noise: every frame draws the noise of frame 0 as if the camera had been opened just
            then, so that it depends on its exposure alone, as in `sim.devices.common`

    Raises:
        UsageError: a seed or a tolerance out of range
    """

    def __init__(
        self,
        scene: Scene,
        sensor: Sensor,
        *,
        clock: Clock | None = None,
        seed: int = 0,
        faults: Faults | None = None,
        threads: int = 2,
        tolerance_dn: float = 0.0,
        repeat_noise: bool = False,
    ) -> None:
        self.scene = scene
        self.sensor = sensor
        self._clock = clock if clock is not None else VirtualClock()
        self._controls = sensor.controls(
            scene.shape,
            is_coloured=scene.is_coloured,
            photons_per_unit=photons_per_unit(scene, sensor),
            notes=(*scene.notes, *_settling(sensor)),
        )
        self._renderer = Renderer(
            View.of(scene, sensor), sensor, seed=seed, threads=threads, tolerance_dn=tolerance_dn
        )
        self._repeat_noise = repeat_noise
        self._share = 1.0
        self._plan: FramePlan | None = None
        self.device = SimulatedDevice(sensor, self._render, self._clock, seed=seed)
        self._faults = faults or Faults()
        self._busy_calls = self._faults.busy_calls
        self._handed_over = 0
        self._is_shooting = False
        self._is_open = True

    @property
    def info(self) -> CameraInfo:
        """Who it is; its serial number is the sensor's name, which its profile belongs to."""
        return CameraInfo("sim", "camctl", f"simulated {self.sensor.name}", self.sensor.name, "sim")

    @property
    def controls(self) -> ExposureControls:
        """What it can set."""
        return self._controls

    @property
    def clock(self) -> Clock:
        """The clock of its timestamps."""
        return self._clock

    @property
    def last_plan(self) -> FramePlan | None:
        """Which effects the frame that was handed over last has; None before the first."""
        return self._plan

    @property
    def frames_lost(self) -> int:
        """Frames that the device dropped because nobody took them in time."""
        return self.device.lost

    @property
    def mode(self) -> str:
        """Pixel format, size and frame rate, such as mono8-640x480-30."""
        rows, columns = self._controls.shape
        rate = round(1 / self.sensor.frame_interval_s, 3)
        return f"{self._controls.layout}{self._controls.bits}-{columns}x{rows}-{rate:g}"

    def shoot(self, settings: Sequence[ExposureSetting]) -> FrameStream:
        """Take the settings in their order; see `camctl.camera.Camera.shoot`."""
        wanted = tuple(settings)
        self._check_ready()
        for setting in wanted:
            self._controls.check(setting)
        return self._shoot(wanted)

    def preview(self, setting: ExposureSetting) -> Frame:
        """Return one frame at `setting`; it counts as none of `Faults`."""
        self._check_ready()
        self._controls.check(setting)
        return next(self._stream((setting,), is_preview=True))

    def step(self, before: ExposureSetting, after: ExposureSetting, frames: int) -> list[Frame]:
        """Return the frames that follow a change of exposure; see `camctl.camera.StreamingCamera`.

        Raises:
            CameraProtocolError: the device dropped a frame because nobody took it in time
        """
        self._check_ready()
        for setting in (before, after):
            self._controls.check(setting)
        settled = self.device.write(before)[0]
        settled += self.sensor.delay_frames + self.sensor.delay_jitter_frames
        while self._dequeue(is_preview=False).sequence < settled:
            pass
        first, applied = self.device.write(after)
        # All of them are taken before the first is rendered, which may take longer than a frame.
        buffers: list[Buffer] = []
        while len(buffers) < frames:
            buffer = self._dequeue(is_preview=False)
            if buffer.sequence >= first:
                buffers.append(buffer)
        if [buffer.sequence - first for buffer in buffers] != list(range(frames)):
            raise CameraProtocolError(
                "the simulated camera lost a frame", hint="leave the computer alone and try again"
            )
        self._share = 1.0
        return [
            self._read_out(buffer, after, applied, index, is_preview=False)
            for index, buffer in enumerate(buffers)
        ]

    def close(self) -> None:
        """Let go of the device; every call but this one then raises `CameraDisconnectedError`."""
        self._is_open = False

    def _render(self, slot: Slot) -> Pixels:
        if self._repeat_noise:
            shot = self._renderer.shot(slot.time_s, slot.gain, 0)
        else:
            shot = self._renderer.shot(
                slot.time_s,
                slot.gain,
                slot.sequence,
                start_s=slot.start_s,
                previous_s=slot.previous_s,
            )
        self._plan = self._renderer.plan(shot, share=self._share)
        return self._renderer.expose(shot, self._plan)

    def _check_open(self) -> None:
        if not self._is_open:
            raise CameraDisconnectedError("the simulated camera is closed", hint="open it again")

    def _check_ready(self) -> None:
        self._check_open()
        if self._busy_calls > 0:
            self._busy_calls -= 1
            raise CameraBusyError(
                "the simulated camera is busy", hint="close what else uses it and try again"
            )
        if self._is_shooting:
            raise CameraBusyError(
                "the simulated camera is still shooting", hint="finish or close that shot first"
            )

    def _shoot(self, settings: tuple[ExposureSetting, ...]) -> Generator[Frame, None, None]:
        if self._is_shooting:
            raise CameraBusyError(
                "the simulated camera is still shooting", hint="finish or close that shot first"
            )
        self._is_shooting = True
        try:
            yield from self._stream(settings, is_preview=False)
        finally:
            self._is_shooting = False

    def _stream(
        self, settings: tuple[ExposureSetting, ...], *, is_preview: bool
    ) -> Iterator[Frame]:
        """Yield a frame for each setting, each from a slot that is known to have had it.

        With a constant delay of d frames one setting is written a slot, so that setting i is in
        force from slot w_i + d until setting i + 1 is, w_i the first slot that had not begun when i
        was written: the stream never stops, and n settings take n + d slots.  Where the delay is
        not constant, setting i + 1 is written only when the frame of i is there.  A frame that was
        lost because the consumer was late is shot again from its setting on.
        """
        self._share = 1 / max(1, len(settings))
        steady = self.sensor.delay_jitter_frames == 0
        settled = self.sensor.delay_frames + self.sensor.delay_jitter_frames
        written: list[tuple[int, ExposureSetting]] = []  # of settings[done:], as the device said
        done = 0
        while done < len(settings):
            self._check_open()
            next_one = done + len(written)
            if next_one < len(settings) and (
                not written or (steady and self.device.upcoming > written[-1][0])
            ):
                written.append(self.device.write(settings[next_one]))
            buffer = self._dequeue(is_preview)
            first = written[0][0] + settled
            if buffer.sequence < first:
                continue
            if len(written) > 1 and buffer.sequence >= written[1][0] + settled:
                written.clear()
                continue
            # The next control change goes out before the frame, which may be held for long.
            next_one = done + len(written)
            if steady and next_one < len(settings) and self.device.upcoming > written[-1][0]:
                written.append(self.device.write(settings[next_one]))
            applied = written.pop(0)[1]
            frame = self._read_out(buffer, settings[done], applied, done, is_preview)
            done += 1
            yield frame

    def _dequeue(self, is_preview: bool) -> Buffer:
        if not is_preview:
            self._strike()
        buffer = self.device.dequeue(SILENCE_S)
        if buffer is None:
            raise CameraTimeoutError(
                f"no frame from the simulated camera for {SILENCE_S:g} s",
                hint="unplug it, plug it in again and resume",
            )
        return buffer

    def _strike(self) -> None:
        """Let the fault happen whose time has come, once."""
        if self._handed_over == self._faults.unplug_after:
            self._faults = replace(self._faults, unplug_after=None)
            self.device.unplug()
        if self._handed_over == self._faults.freeze_after:
            self._faults = replace(self._faults, freeze_after=None)
            self.device.freeze()

    def _read_out(
        self,
        buffer: Buffer,
        requested: ExposureSetting,
        applied: ExposureSetting,
        index: int,
        is_preview: bool,
    ) -> Frame:
        light = 1.0
        if not is_preview:
            light = self._faults.wrong_exposure.get(self._handed_over, 1.0)
            self._handed_over += 1
        pixels = self.device.read_out(buffer, light=light)
        assert self._plan is not None  # reading out has made it
        return Frame(
            pixels=pixels,
            requested=requested,
            applied=applied,
            timestamp_s=buffer.timestamp_s,
            index=index,
            black=self._controls.black,
            white=self._controls.white,
            details={"simulation": self._plan.as_data()},
        )


def _settling(sensor: Sensor) -> tuple[str, ...]:
    """Return a line for a sensor that cannot be set frame by frame."""
    if sensor.delay_jitter_frames == 0:
        return ()
    most = sensor.delay_frames + sensor.delay_jitter_frames
    return (
        f"the delay of the exposure controls is not constant ({sensor.delay_frames} to {most} "
        "frames): the stream settles for each exposure",
    )
