"""The frames of a virtual webcam from commit to stop: slots, exposures, and pixels as bytes."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from camctl.camera import Pixels
from camctl.controls import ExposureSetting
from sim.devices.clock import DeviceClock
from sim.devices.scenery import Exposer
from sim.devices.uvc.controls import TICKS_PER_S
from sim.devices.uvc.descriptors import FORMATS
from sim.streaming_device import SimulatedDevice, Slot

_JPEG_QUALITY = 95


@dataclass(frozen=True)
class Mode:
    """What a stream is like.

    Attributes:
        format: name in `sim.devices.uvc.descriptors.FORMATS`
        interval_s: from frame to frame
        delay, jitter: of exposure and gain: frames, and up to so many more at random
        is_limited: the luma of yuyv goes from 16 to 235
        seed: of the jitter
    """

    format: str
    interval_s: float
    delay: int
    jitter: int
    is_limited: bool
    seed: int


@dataclass(frozen=True)
class Exposed:
    """A frame's exposure.

    Attributes:
        slot: number since the stream began
        time_s, gain: the setting in force
        light: so many times the light came in beside that, by automatics or faults
        ended_s: when the slot ended, on the device's clock
    """

    slot: int
    time_s: float
    gain: float
    light: float
    ended_s: float


class Owner(Protocol):
    """The camera that streams; called by scheduled calls of the stream."""

    def light(self, slot: int) -> float:
        """Return how many times the light a slot gets."""
        ...

    def is_left_out(self, slot: int) -> bool:
        """Say whether no frame is made of a slot."""
        ...

    def brightness(self) -> int:
        """Return what is added to luma."""
        ...

    def write_outputs(self, stream: Stream, exposed: Exposed, level: float, data: bytes) -> None:
        """Take a frame; `level` is its mean, 0 to 1."""
        ...


class Stream:
    """Frames, by calls that are scheduled for the ends of their slots, until `stop`.

    Args:
        owner: the camera
        exposer: the sensor before its scene
        mode: see `Mode`
        setting: shutter time, s, and linear gain at the start
        clock: the time that it runs in
    """

    def __init__(
        self,
        owner: Owner,
        exposer: Exposer,
        mode: Mode,
        setting: tuple[float, float],
        clock: DeviceClock,
    ) -> None:
        self._owner = owner
        self._exposer = exposer
        self._mode = mode
        # Exposures end with their slot, so none is longer.
        longest_s = max(1, math.floor(mode.interval_s * TICKS_PER_S)) / TICKS_PER_S
        sensor = exposer.sensor.model_copy(
            update={
                "time_minimum_s": 1 / TICKS_PER_S,
                "time_maximum_s": longest_s,
                "line_s": 1 / TICKS_PER_S,
                "gain_maximum": 16.0,
                "gain_step": 1 / 16,
                "delay_frames": mode.delay,
                "delay_jitter_frames": mode.jitter,
                "frame_interval_s": mode.interval_s,
            }
        )
        self._lock = threading.Lock()  # of the sensor's registers; never held while it renders
        self._is_over = threading.Event()
        self._clock = clock
        self._device = SimulatedDevice(sensor, self._render, self._clock, seed=mode.seed)
        # Not before the device begins, or its slots would be waited for with the lock held.
        self._began_s = self._clock.now()
        self._device.write(ExposureSetting(*setting))
        self._exposed: Exposed | None = None
        self._light = 1.0

    def start(self) -> None:
        """Begin to hand frames over."""
        self._schedule(0)

    def stop(self) -> None:
        """End after the frame that is being made, which comes to nothing; does not wait for it."""
        self._is_over.set()

    def write(self, time_s: float, gain: float) -> tuple[int, ExposureSetting]:
        """Set the exposure; return the first slot that had not begun, and what was set."""
        with self._lock:
            return self._device.write(ExposureSetting(time_s, gain))

    def _schedule(self, slot: int) -> None:
        ends_s = self._began_s + (slot + 1) * self._mode.interval_s
        self._clock.call_at(ends_s, self._end_slot)

    def _end_slot(self) -> None:
        """Hand over the frame of the slot that has ended, and schedule the end of the next one."""
        if self._is_over.is_set():
            return
        with self._lock:
            buffer = self._device.dequeue(0.0)
        assert buffer is not None  # this device is never frozen
        if not self._owner.is_left_out(buffer.sequence):
            self._light = self._owner.light(buffer.sequence)
            pixels = self._device.read_out(buffer)
            level = float(pixels.mean()) / (2**self._exposer.sensor.bits - 1)
            assert self._exposed is not None  # reading out has made it
            self._owner.write_outputs(self, self._exposed, level, self._pack(pixels))
        self._schedule(buffer.sequence + 1)

    def _render(self, slot: Slot) -> Pixels:
        # As the wire counts it, so that the time is the float nearest to its decimal.
        time_s = round(slot.time_s * TICKS_PER_S) / TICKS_PER_S
        ended_s = self._began_s + (slot.sequence + 1) * self._mode.interval_s
        self._exposed = Exposed(slot.sequence, time_s, slot.gain, self._light, ended_s)
        return self._exposer.expose(time_s * self._light, slot.gain, slot.sequence)

    def _pack(self, pixels: Pixels) -> bytes:
        """Return a frame's bytes: the sensor's own numbers, or luma of 8 bits."""
        form = FORMATS[self._mode.format]
        if form.layout is not None:
            return pixels.astype("<u2" if form.bytes_a_pixel == 2 else np.uint8).tobytes()
        luma = self._luma(pixels)
        if not form.code:
            return bytes(cv2.imencode(".jpg", luma, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1])
        if self._mode.is_limited:
            luma = np.rint(16 + luma * (219 / 255)).astype(np.uint8)
        packed = np.full((*luma.shape, 2), 128, np.uint8)
        packed[..., 0] = luma
        return packed.tobytes()

    def _luma(self, pixels: Pixels) -> NDArray[np.uint8]:
        luma = (pixels >> max(0, self._exposer.sensor.bits - 8)).astype(np.uint8)
        if luma.ndim == 3:
            luma = np.asarray(cv2.cvtColor(luma, cv2.COLOR_RGB2GRAY), np.uint8)
        if offset := self._owner.brightness():
            luma = np.clip(luma.astype(np.int16) + offset, 0, 255).astype(np.uint8)
        return luma
