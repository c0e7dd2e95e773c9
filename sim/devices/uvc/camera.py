"""A webcam on USB (USB Video Class, bulk streaming) with a simulated sensor before a scene.

It streams by itself from a `sim.streaming_device.SimulatedDevice`: frame slots of one interval,
controls that land late, at most a few finished frames for a slow host.  A control that
is written in slot k is in force from slot k + 1 + delay on.  Exposures end with their slot: a time
beyond the frame interval can be set and read back, and is cut to the interval without a word.

What formats hold: yuyv and mjpg luma of 8 bits (of deeper sensors the upper ones); grey, y10, y12,
y16 and Bayer formats the sensor's own numbers, in the low bits of a word.  With ``luma: full``
yuyv is lossless for a mono sensor of 8 bits; ``limited`` maps 0..255 to 16..235.

Automatics are on at first and really change the picture while they are: exposure is metered,
frames come at half their rate in the dark's favour (ae_priority), white balance lets the light
wander by a fifth, and each step of backlight compensation adds a quarter of it.
"""

from __future__ import annotations

import math
import random
import struct
from collections import deque
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from camctl.errors import UsageError
from sim.devices.clock import DeviceClock
from sim.devices.scenery import Exposer, checked, split_config
from sim.devices.usb.device import SILENCE, STALL, Answer, UsbDevice
from sim.devices.uvc.config import UvcConfig, check_format
from sim.devices.uvc.controls import CAN_GET_AND_SET, INFO, LENGTH, SET, Controls
from sim.devices.uvc.descriptors import (
    CONTROLS,
    FORMATS,
    STREAM_IN,
    Transfer,
    configuration_descriptor,
    device_descriptor,
)
from sim.devices.uvc.stream import Exposed, Mode, Stream
from sim.scenes.scene import DEFAULT_SCENE, load_scene

_PROBE, _COMMIT = 1, 2
_PROBE_BYTES = 26  # of UVC 1.0 (4.3.1.1)
_STREAM_INTERFACE = 1
_END_OF_FRAME, _END_OF_HEADER, _HEADER_BYTES = 0x02, 0x80, 2
_STREAM = STREAM_IN & 15

_INTERVALS_PER_S = 10_000_000
_LOG = 400
_WANDER, _WANDER_SLOTS = 0.2, 9.0  # of the light, while white balance is automatic
_BACKLIGHT = 0.25  # more light for each step of backlight compensation


class UvcCamera(UsbDevice):
    """The webcam; `make` builds one of a configuration.

    Args:
        config: see `UvcConfig`
        exposers: the sensor before its scene for each (rows, columns), the default first
        seed: of the jitter of its delay
        clock: the time that it streams in
    """

    device_descriptor = device_descriptor()

    def __init__(
        self,
        config: UvcConfig,
        exposers: Mapping[tuple[int, int], Exposer],
        seed: int,
        clock: DeviceClock | None = None,
    ) -> None:
        self.config = config
        self._sizes = tuple(exposers)
        self._exposers = exposers
        self._intervals = tuple(round(_INTERVALS_PER_S / rate) for rate in config.fps)
        self.strings = ("", "camctl", "virtual webcam", config.serial)
        curve = next(iter(exposers.values())).sensor.curve
        self.configuration_descriptor = configuration_descriptor(
            config.formats, self._sizes, self._intervals, Transfer.of(curve)
        )
        super().__init__(clock=clock)
        self.controls = Controls(self._write_exposure)
        self._wrong_factor, self._wrong_left = 1.0, 0
        self._truncated = self._rubbish = 0
        self._is_hanging = self._is_frozen = False
        self._seed = seed
        self._chosen = (1, 1, self._intervals[0])  # format and frame number, interval
        self._committed = self._chosen
        self._stream: Stream | None = None
        self._frame_id = 0
        self._log: deque[dict[str, Any]] = deque(maxlen=_LOG)
        self._writes: deque[dict[str, Any]] = deque(maxlen=_LOG)
        self._sent = self._late = 0

    # What the host asks.

    def control(
        self, request_type: int, request: int, value: int, index: int, length: int, data: bytes
    ) -> Answer:
        """Answer a class request to a control, a probe or a commit."""
        if self._is_hanging:
            return SILENCE
        if request_type & 0x60 != 0x20:
            return STALL
        interface, entity, selector = index & 255, index >> 8, value >> 8
        if interface == _STREAM_INTERFACE:
            return self._negotiate(request, selector, data)
        return self.controls.answer(request, entity, selector, data)

    def halt_cleared(self, endpoint: int) -> None:
        """Stop streaming: hosts clear the halt of a bulk endpoint for that."""
        if endpoint == STREAM_IN:
            self._stop()

    def detached(self) -> None:
        """Forget all that was set, as a camera without current does."""
        with self.lock:
            self._stop()
            self.controls.reset()

    def _negotiate(self, request: int, selector: int, data: bytes) -> Answer:
        if selector not in (_PROBE, _COMMIT):
            return STALL
        if request == INFO:
            return bytes([CAN_GET_AND_SET])
        if request == LENGTH:
            return _PROBE_BYTES.to_bytes(2, "little")
        if request != SET:
            return self._probe()
        if len(data) < 8:
            return STALL
        _, form, frame, interval = struct.unpack_from("<HBBI", data)
        self._chosen = (
            min(max(form, 1), len(self.config.formats)),
            min(max(frame, 1), len(self._sizes)),
            min(self._intervals, key=lambda each: abs(each - interval)),
        )
        if selector == _COMMIT:
            self._start()
        return b""

    def _probe(self) -> bytes:
        form, frame, interval = self._chosen
        rows, columns = self._sizes[frame - 1]
        size = rows * columns * FORMATS[self.config.formats[form - 1]].bytes_a_pixel
        payload = size + _HEADER_BYTES
        return struct.pack("<HBBI5HII", 1, form, frame, interval, 0, 0, 0, 0, 0, size, payload)

    # Streaming.

    def _start(self) -> None:
        self._stop()
        self._committed = self._chosen
        form, frame, interval = self._committed
        mode = Mode(
            format=self.config.formats[form - 1],
            interval_s=interval / _INTERVALS_PER_S,
            delay=self.config.delay,
            jitter=self.config.jitter,
            is_limited=self.config.luma == "limited",
            seed=self._seed,
        )
        exposer = self._exposers[self._sizes[frame - 1]]
        self._log.clear()
        self._writes.clear()
        self._stream = Stream(self, exposer, mode, self.controls.exposure, self.clock)
        self._stream.start()

    def _stop(self) -> None:
        if self._stream is not None:
            self._stream.stop()
            self._stream = None
        self.flush(STREAM_IN)

    def _write_exposure(self) -> None:
        if self._stream is not None:
            upcoming, setting = self._stream.write(*self.controls.exposure)
            self._writes.append(
                {"upcoming": upcoming, "time_s": setting.time_s, "gain": setting.gain}
            )

    def light(self, slot: int) -> float:
        """Return how many times the light a slot gets, by automatics and by faults."""
        with self.lock:
            light = 1 + _BACKLIGHT * self.controls.values["backlight"]
            if self.controls.values["wb_auto"]:
                light *= 1 + _WANDER * math.sin(slot / _WANDER_SLOTS)
            if self._wrong_left > 0:
                self._wrong_left -= 1
                light *= self._wrong_factor
            return light

    def is_left_out(self, slot: int) -> bool:
        """Say whether automatic exposure has halved the frame rate and this slot is the other."""
        is_slowed = self.controls.values["ae_priority"] == 1 and self.controls.is_metering
        return is_slowed and slot % 2 == 1

    def brightness(self) -> int:
        """Return what the brightness control adds to luma."""
        return self.controls.values["brightness"] - CONTROLS["brightness"].default

    def write_outputs(self, stream: Stream, exposed: Exposed, level: float, data: bytes) -> None:
        """Send a frame as one payload, or what a fault makes of it, unless the host is too slow."""
        with self.lock:
            if stream is not self._stream:
                return
            interval_s = self._committed[2] / _INTERVALS_PER_S
            self.controls.meter(level, exposed.time_s, interval_s)
            is_late = self.pending(STREAM_IN) > 0
            is_sent = not (is_late or self._is_frozen)
            self._log.append({**asdict(exposed), "is_sent": is_sent})
            self._late += is_late
            if is_sent:
                self._sent += 1
                self.send(_STREAM, self._payload(data))

    def _payload(self, data: bytes) -> bytes:
        flags = _END_OF_HEADER | _END_OF_FRAME | self._frame_id
        self._frame_id ^= 1
        payload = bytes([_HEADER_BYTES, flags]) + data
        if self._truncated > 0:
            self._truncated -= 1
            payload = payload[: len(payload) // 2]
        if self._rubbish > 0:
            self._rubbish -= 1
            payload = random.Random(self._sent).randbytes(len(payload))
        return payload

    # Verbs.

    def do_ok(self) -> None:
        """End all faults."""
        with self.lock:
            self._is_hanging = self._is_frozen = False
            self._truncated = self._rubbish = self._wrong_left = 0
            self.controls.clamp_s = math.inf

    def do_freeze(self) -> None:
        """Send no more frames, without a word."""
        self._is_frozen = True

    def do_thaw(self) -> None:
        """Send frames again."""
        self._is_frozen = False

    def do_hang(self) -> None:
        """Answer no control request."""
        self._is_hanging = True

    def do_clamp(self, max_s: float) -> None:
        """Cut shutter times that are written from now on to `max_s`, without a word."""
        if not max_s > 0:
            raise UsageError(f"shutter times up to {max_s} s", hint="give seconds above 0")
        self.controls.clamp_s = max_s

    def do_wrong(self, factor: float = 2.0, count: int = 1) -> None:
        """Give the next frames so many times the light."""
        with self.lock:
            self._wrong_factor, self._wrong_left = factor, count

    def do_truncate(self, count: int = 1) -> None:
        """Send half of the next frames."""
        self._truncated = count

    def do_garbage(self, count: int = 1) -> None:
        """Send rubbish instead of the next frames, headers and all."""
        self._rubbish = count

    def do_log(self) -> dict[str, Any]:
        """Return the last frames of this or the last stream (see `Exposed`), and writes.

        A write has its exposure and the first slot that had not begun when it came.
        """
        with self.lock:
            return {"frames": list(self._log), "writes": list(self._writes)}

    def do_delay(self, frames: int, jitter: int = 0) -> None:
        """Be so many frames late, and at random up to `jitter` more, from the next stream on."""
        late = {"delay": frames, "jitter": jitter}
        self.config = checked(UvcConfig, {**self.config.model_dump(), **late})

    def state(self) -> dict[str, Any]:
        """Return controls, what is streamed, and how many frames went out and were too late."""
        with self.lock:
            form, frame, interval = self._committed
            rows, columns = self._sizes[frame - 1]
            return {
                "controls": dict(self.controls.values),
                "is_streaming": self._stream is not None,
                "format": self.config.formats[form - 1],
                "size": f"{columns}x{rows}",
                "fps": _INTERVALS_PER_S / interval,
                "sent": self._sent,
                "late": self._late,
            }


def make(config: Mapping[str, Any], clock: DeviceClock | None = None) -> UvcCamera:
    """Return the webcam that a configuration describes.

    Raises:
        UsageError, DataError: something in it is unknown or out of range
    """
    exposer, own = split_config(config)
    camera = checked(UvcConfig, own)
    for name in camera.formats:
        check_format(name, exposer)
    exposers = {exposer.shape: exposer}
    seed = int(config.get("seed", 0))
    for shape in camera.sizes:
        scene = load_scene(
            str(config.get("scene", DEFAULT_SCENE)), shape, usual=exposer.sensor.shape
        )
        repeat = bool(config.get("repeat_noise", False))
        exposers[shape] = Exposer(scene, exposer.sensor, seed=seed, repeat_noise=repeat)
    return UvcCamera(camera, exposers, seed, clock)
