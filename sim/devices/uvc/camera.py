"""A webcam on USB (USB Video Class, bulk streaming) with a simulated sensor.

It streams from a `camctl.sim.streaming_device.SimulatedDevice`: slots of one frame interval, a
control delay, and few finished frames for a slow host.  A control that is written in slot k is in
force from slot k + 1 + delay on.  An exposure ends with its slot: a shutter time longer than the
frame interval can be set and is read back unchanged, but is silently cut to the interval.

Contents of the formats: yuyv and mjpg have luma of 8 bits (the upper ones of deeper sensors); grey,
y10, y12, y16 and the Bayer formats have the sensor's digital numbers, in the low bits of a word.
With ``luma: full`` yuyv is lossless for a mono sensor of 8 bits; ``limited`` maps 0..255 to
16..235.

After power-on all automatic modes are on, and each changes the picture: exposure is metered,
ae_priority halves the frame rate, white balance makes the light vary by a fifth, and each step of
backlight compensation adds a quarter of the light.
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
from camctl.sim.devices.clock import DeviceClock
from camctl.sim.devices.common import VirtualSensor
from camctl.sim.devices.usb.device import NO_REPLY, STALL, ControlReply, UsbDevice
from camctl.sim.devices.uvc.controls import CAN_GET_AND_SET, CONTROLS, INFO, LENGTH, SET, Controls
from camctl.sim.devices.uvc.descriptors import (
    FORMATS,
    INTERVALS_PER_S,
    STREAM_IN,
    Transfer,
    UvcConfig,
    check_format,
    configuration_descriptor,
    device_descriptor,
)
from camctl.sim.devices.uvc.stream import FrameExposure, Stream, StreamMode

_PROBE, _COMMIT = 1, 2  # selectors (A.9.7)
_PROBE_BYTES = 26  # of UVC 1.0 (4.3.1.1)
_STREAM_INTERFACE = 1  # its number
_STREAM_ENDPOINT = STREAM_IN & 15
_END_OF_FRAME, _ERROR, _END_OF_HEADER, _HEADER_BYTES = 0x02, 0x40, 0x80, 2  # of a payload (2.4.3.3)

_LOG_LENGTH = 400  # frames: a host may stream without end
_WB_AMPLITUDE, _WB_PERIOD_SLOTS = 0.2, 9.0  # of the light under automatic white balance
_BACKLIGHT = 0.25  # more light for each step of backlight compensation


class UvcCamera(UsbDevice):
    """The webcam; `make` builds one from a configuration.

    Args:
        config: see `UvcConfig`
        sensors: for each frame size, (rows, columns); the default first
        clock: the time in which it streams
    """

    device_descriptor = device_descriptor()

    def __init__(
        self,
        config: UvcConfig,
        sensors: Mapping[tuple[int, int], VirtualSensor],
        clock: DeviceClock | None = None,
    ) -> None:
        self.config = config
        self._sizes = tuple(sensors)
        self._sensors = sensors
        self._intervals = tuple(round(INTERVALS_PER_S / rate) for rate in config.fps)
        self.strings = ("", "camctl", "virtual webcam", config.serial)
        curve = next(iter(sensors.values())).model.curve
        self.configuration_descriptor = configuration_descriptor(
            config.formats, self._sizes, self._intervals, Transfer.of(curve)
        )
        super().__init__(clock=clock)
        self.controls = Controls(self._write_exposure)
        self._light_factor, self._light_count = 1.0, 0
        self._truncations = self._garbage = self._errors = 0
        self._is_hanging = self._is_frozen = False
        self._probed = (1, 1, self._intervals[0])  # number of format and of frame, interval
        self._committed = self._probed
        self._stream: Stream | None = None
        self._frame_id = 0
        self._log: deque[dict[str, Any]] = deque(maxlen=_LOG_LENGTH)
        self._writes: deque[dict[str, Any]] = deque(maxlen=_LOG_LENGTH)
        self._sent = self._late = 0

    # Requests of the host.

    def control(
        self, request_type: int, request: int, value: int, index: int, length: int, data: bytes
    ) -> ControlReply:
        if self._is_hanging:
            return NO_REPLY
        if request_type & 0x60 != 0x20:
            return STALL
        interface, entity, selector = index & 255, index >> 8, value >> 8
        if interface == _STREAM_INTERFACE:
            return self._negotiate(request, selector, data)
        return self.controls.reply(request, entity, selector, data)

    def halt_cleared(self, endpoint: int) -> None:
        """Stop streaming: that is how hosts stop a bulk stream."""
        if endpoint == STREAM_IN:
            self._stop()

    def detached(self) -> None:
        """Reset all controls, as by loss of power."""
        with self.lock:
            self._stop()
            self.controls.reset()

    def _negotiate(self, request: int, selector: int, data: bytes) -> ControlReply:
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
        self._probed = (
            min(max(form, 1), len(self.config.formats)),
            min(max(frame, 1), len(self._sizes)),
            min(self._intervals, key=lambda each: abs(each - interval)),
        )
        if selector == _COMMIT:
            self._start()
        return b""

    def _probe(self) -> bytes:
        form, frame, interval = self._probed
        rows, columns = self._sizes[frame - 1]
        size = rows * columns * FORMATS[self.config.formats[form - 1]].pixel_bytes
        payload = size + _HEADER_BYTES
        return struct.pack("<HBBI5HII", 1, form, frame, interval, 0, 0, 0, 0, 0, size, payload)

    # Streaming.

    def _start(self) -> None:
        self._stop()
        self._committed = self._probed
        form, frame, interval = self._committed
        mode = StreamMode(
            format=self.config.formats[form - 1],
            interval_s=interval / INTERVALS_PER_S,
            delay=self.config.delay,
            gain_delay=self.config.gain_delay,
            jitter=self.config.jitter,
            is_limited=self.config.luma == "limited",
            seed=self.config.seed,
            setting=self.controls.exposure,
        )
        self._log.clear()
        self._writes.clear()
        self._stream = Stream(self, self._sensors[self._sizes[frame - 1]], mode, self.clock)
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
        """Return the factor on a slot's light by automatic modes and faults."""
        with self.lock:
            light = 1 + _BACKLIGHT * self.controls.values["backlight"]
            if self.controls.values["wb_auto"]:
                light *= 1 + _WB_AMPLITUDE * math.sin(slot / _WB_PERIOD_SLOTS)
            if self._light_count > 0:
                self._light_count -= 1
                light *= self._light_factor
            return light

    def is_skipped(self, slot: int) -> bool:
        """Return whether a slot gives no frame: every other one at half the frame rate."""
        is_slowed = self.controls.values["ae_priority"] == 1 and self.controls.is_metering
        return is_slowed and slot % 2 == 1

    def brightness(self) -> int:
        """Return the offset that the brightness control adds to luma."""
        return self.controls.values["brightness"] - CONTROLS["brightness"].default

    def send_frame(
        self, stream: Stream, exposure: FrameExposure, level: float, data: bytes
    ) -> None:
        """Send a frame as one payload, unless the host has not read the one before."""
        with self.lock:
            if stream is not self._stream:
                return
            interval_s = self._committed[2] / INTERVALS_PER_S
            self.controls.meter(level, exposure.time_s, interval_s)
            is_late = self.pending(STREAM_IN) > 0
            is_sent = not (is_late or self._is_frozen)
            self._log.append({**asdict(exposure), "is_sent": is_sent})
            self._late += is_late
            if is_sent:
                self._sent += 1
                self.send(_STREAM_ENDPOINT, self._payload(data))

    def _payload(self, data: bytes) -> bytes:
        flags = _END_OF_HEADER | _END_OF_FRAME | self._frame_id
        self._frame_id ^= 1
        if self._errors > 0:
            self._errors -= 1
            flags |= _ERROR
            data = bytes(byte ^ 0x55 for byte in data)
        payload = bytes([_HEADER_BYTES, flags]) + data
        if self._truncations > 0:
            self._truncations -= 1
            payload = payload[: len(payload) // 2]
        if self._garbage > 0:
            self._garbage -= 1
            payload = random.Random(self._sent).randbytes(len(payload))
        return payload

    # Control commands.

    def do_ok(self) -> None:
        with self.lock:
            self._is_hanging = self._is_frozen = False
            self._truncations = self._garbage = self._errors = self._light_count = 0
            self.controls.longest_s = math.inf

    def do_freeze(self) -> None:
        """Silently send no more frames."""
        self._is_frozen = True

    def do_hang(self) -> None:
        """Do not reply to control requests."""
        self._is_hanging = True

    def do_clamp(self, max_s: float) -> None:
        """Silently cut shutter times that are written from now on to `max_s`."""
        if not max_s > 0:
            raise UsageError(f"invalid max_s {max_s}: expected seconds above 0")
        self.controls.longest_s = max_s

    def do_wrong_exposure(self, factor: float = 2.0, count: int = 1) -> None:
        """Give the next `count` frames `factor` times the light."""
        with self.lock:
            self._light_factor, self._light_count = factor, count

    def do_truncate(self, count: int = 1) -> None:
        """Send half of the next `count` frames."""
        self._truncations = count

    def do_erroneous(self, count: int = 1) -> None:
        """Send the next `count` frames spoilt, whole, and with the error bit in their headers."""
        self._errors = count

    def do_garbage(self, count: int = 1) -> None:
        """Send random bytes instead of the next `count` frames and their headers."""
        self._garbage = count

    def do_log(self) -> dict[str, Any]:
        """Return the frames of the stream (see `FrameExposure`), and exposures written to it.

        A write has its exposure and the first slot that had not begun when it came.
        """
        with self.lock:
            return {"frames": list(self._log), "writes": list(self._writes)}

    def do_delay(self, frames: int, jitter: int = 0, gain: int | None = None) -> None:
        """Change the control delays and their jitter, frames, from the next stream on."""
        changes = {"delay": frames, "jitter": jitter, "gain_delay": gain}
        self.config = UvcConfig.parse({**self.config.model_dump(), **changes})

    def state(self) -> dict[str, Any]:
        """Return controls, stream mode, and how many frames were sent and were too late to be."""
        with self.lock:
            form, frame, interval = self._committed
            rows, columns = self._sizes[frame - 1]
            return {
                "controls": dict(self.controls.values),
                "is_streaming": self._stream is not None,
                "format": self.config.formats[form - 1],
                "size": f"{columns}x{rows}",
                "fps": INTERVALS_PER_S / interval,
                "sent": self._sent,
                "late": self._late,
            }


def make(config: Mapping[str, Any], clock: DeviceClock | None = None) -> UvcCamera:
    """Return the webcam of a configuration (`UvcConfig`)."""
    options = UvcConfig.parse(config)
    sensor = options.load_sensor()
    for name in options.formats:
        check_format(name, sensor)
    sensors = {sensor.shape: sensor}
    for size in options.sizes:
        sensors[size] = options.load_sensor(size)
    return UvcCamera(options, sensors, clock)
