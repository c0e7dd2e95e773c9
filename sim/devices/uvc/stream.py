"""The frames of a virtual webcam from commit to stop: slots, exposures, and pixels as bytes."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from camctl.interface.camera import Pixels
from camctl.interface.controls import ExposureSetting
from camctl.sim.devices.clock import DeviceClock
from camctl.sim.devices.common import VirtualSensor
from camctl.sim.devices.uvc.controls import TICKS_PER_S
from camctl.sim.devices.uvc.descriptors import FORMATS
from camctl.sim.streaming_device import SimulatedDevice, Slot
from camctl.system.picture_operations import required_opencv

#: Of R, G and B in the luma of ITU-R BT.601.
_LUMA_WEIGHTS = np.array([0.299, 0.587, 0.114], np.float32)


@dataclass(frozen=True)
class StreamMode:
    """The mode of a stream.

    Attributes:
        format: name in `camctl.sim.devices.uvc.descriptors.FORMATS`
        interval_s: between frames
        delay: control delay, frames
        gain_delay: of the gain; None: as of the exposure time
        jitter: up to so many more at random
        is_limited: the luma of yuyv is mapped to 16..235
        seed: of the jitter
        setting: shutter time, s, and linear gain at the start
    """

    format: str
    interval_s: float
    delay: int
    gain_delay: int | None
    jitter: int
    is_limited: bool
    seed: int
    setting: tuple[float, float]


@dataclass(frozen=True)
class FrameExposure:
    """The exposure of a frame.

    Attributes:
        slot: number of its slot since the stream began
        time_s, gain: the setting in force
        light: factor on the light by automatic modes and faults
        ended_s: when the slot ended, on the device's clock
    """

    slot: int
    time_s: float
    gain: float
    light: float
    ended_s: float


class Owner(Protocol):
    """The camera that a stream belongs to."""

    def light(self, slot: int) -> float:
        """Return the factor on a slot's light."""

    def is_skipped(self, slot: int) -> bool:
        """Return whether a slot gives no frame."""

    def brightness(self) -> int:
        """Return the offset that is added to luma."""

    def send_frame(
        self, stream: Stream, exposure: FrameExposure, level: float, data: bytes
    ) -> None:
        """Send a frame of mean `level`, 0 to 1."""


class Stream:
    """A running stream; each frame is made by a call scheduled for the end of its slot.

    Args:
        owner: the camera
        sensor: what is exposed
        mode: see `StreamMode`
        clock: the time in which it runs
    """

    def __init__(
        self, owner: Owner, sensor: VirtualSensor, mode: StreamMode, clock: DeviceClock
    ) -> None:
        self._owner = owner
        self._sensor = sensor
        self._mode = mode
        self._clock = clock
        # An exposure ends with its slot, so none is longer.
        longest_s = max(1, math.floor(mode.interval_s * TICKS_PER_S)) / TICKS_PER_S
        model = sensor.model.model_copy(
            update={
                "time_minimum_s": 1 / TICKS_PER_S,
                "time_maximum_s": longest_s,
                "line_s": 1 / TICKS_PER_S,
                "gain_maximum": 16.0,
                "gain_step": 1 / 16,
                "delay_frames": mode.delay,
                "gain_delay_frames": mode.gain_delay,
                "delay_jitter_frames": mode.jitter,
                "frame_interval_s": mode.interval_s,
            }
        )
        self._lock = threading.Lock()  # of the device's registers; not held while rendering
        self._is_over = threading.Event()
        self._device = SimulatedDevice(model, self._render, clock, seed=mode.seed)
        # Not before the device begins, or its slots would be waited for with the lock held.
        self._began_s = clock.now()
        self._device.write(ExposureSetting(*mode.setting))
        self._exposure: FrameExposure | None = None
        self._light = 1.0

    def start(self) -> None:
        """Begin to send frames."""
        self._schedule(0)

    def stop(self) -> None:
        """End the stream at once; a frame that is being made is not sent."""
        self._is_over.set()

    def write(self, time_s: float, gain: float) -> tuple[int, ExposureSetting]:
        """Set the exposure; return the first slot that had not begun, and what was set."""
        with self._lock:
            return self._device.write(ExposureSetting(time_s, gain))

    def _schedule(self, slot: int) -> None:
        self._clock.call_at(self._slot_end_s(slot), self._end_slot)

    def _slot_end_s(self, slot: int) -> float:
        return self._began_s + (slot + 1) * self._mode.interval_s

    def _end_slot(self) -> None:
        """Send the frame of the slot that has ended, and schedule the end of the next one."""
        if self._is_over.is_set():
            return
        with self._lock:
            buffer = self._device.dequeue(0.0)
        assert buffer is not None  # this device is never frozen
        slot = buffer.sequence
        if not self._owner.is_skipped(slot):
            self._light = self._owner.light(slot)
            pixels = self._device.read_out(buffer)
            level = float(pixels.mean()) / (2**self._sensor.model.bits - 1)
            assert self._exposure is not None  # set by `_render`
            self._owner.send_frame(self, self._exposure, level, self._pack(pixels))
        self._schedule(slot + 1)

    def _render(self, slot: Slot) -> Pixels:
        # Rounded to the register's unit, so that the time is the float nearest to its decimal.
        time_s = round(slot.time_s * TICKS_PER_S) / TICKS_PER_S
        ended_s = self._slot_end_s(slot.sequence)
        self._exposure = FrameExposure(slot.sequence, time_s, slot.gain, self._light, ended_s)
        return self._sensor.expose(time_s * self._light, slot.gain, slot.sequence)

    def _pack(self, pixels: Pixels) -> bytes:
        """Return a frame's bytes: the sensor's digital numbers, or luma of 8 bits."""
        form = FORMATS[self._mode.format]
        if form.layout is not None:
            return pixels.astype("<u2" if form.pixel_bytes == 2 else np.uint8).tobytes()
        luma = self._luma(pixels)
        if not form.code:
            cv2 = required_opencv("the virtual webcam with MJPG frames")
            return bytes(cv2.imencode(".jpg", luma, [cv2.IMWRITE_JPEG_QUALITY, 95])[1])
        if self._mode.is_limited:
            luma = np.rint(16 + luma * (219 / 255)).astype(np.uint8)
        packed = np.full((*luma.shape, 2), 128, np.uint8)
        packed[..., 0] = luma
        return packed.tobytes()

    def _luma(self, pixels: Pixels) -> NDArray[np.uint8]:
        luma = (pixels >> max(0, self._sensor.model.bits - 8)).astype(np.uint8)
        if luma.ndim == 3:
            luma = np.rint(luma @ _LUMA_WEIGHTS).astype(np.uint8)
        if offset := self._owner.brightness():
            luma = np.clip(luma.astype(np.int16) + offset, 0, 255).astype(np.uint8)
        return luma
