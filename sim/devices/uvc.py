"""A webcam on USB (USB Video Class, bulk streaming) with a simulated sensor before a scene.

It streams by itself, in real time, like `sim.device.SimulatedDevice`, which it is built on: frame
slots of one interval, controls that land late, at most a few finished frames for a slow host.  A
control that is written in slot k is in force from slot k + 1 + delay on; exposures end with their
slot and never last longer than it.  Automatics really change the picture while they are on.

What the formats hold: yuyv, grey and mjpg the luma of 8 bits (samples of more bits lose the lower
ones); y10, y12, y16 and Bayer formats the sensor's own numbers.  With ``luma: full`` yuyv is
lossless for an 8-bit sensor; ``limited`` maps it to 16..235.
"""

from __future__ import annotations

import math
import random
import struct
import threading
from collections import deque
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from camctl.camera import ExposureSetting, Pixels
from camctl.clock import RealClock
from camctl.errors import UsageError, unknown_name
from sim.device import SimulatedDevice, Slot
from sim.devices.stillbody import checked, split_config
from sim.devices.usb import SILENCE, STALL, Answer, UsbDevice
from sim.devices.uvc_descriptors import (
    CONTROLS,
    FORMATS,
    MANUAL,
    STREAM_IN,
    ControlSpec,
    configuration_descriptor,
    device_descriptor,
)
from sim.exposer import Exposer
from sim.road import parse_size
from sim.scene import load_scene

_SET, _GET, _MIN, _MAX, _RES, _LEN, _INFO, _DEF = 0x01, 0x81, 0x82, 0x83, 0x84, 0x85, 0x86, 0x87
_ERROR_CODE = 0x02  # the control interface's selector for why a request was refused (4.2.1.2)
_WRONG_STATE, _OUT_OF_RANGE, _INVALID_CONTROL, _INVALID_REQUEST = 2, 4, 6, 7
_CAN_GET_AND_SET, _DISABLED, _CHANGES_ITSELF = 0x03, 0x04, 0x08  # GET_INFO (4.1.2)
_PROBE, _COMMIT = 1, 2
_CONTROL_INTERFACE, _STREAM_INTERFACE = 0, 1
_END_OF_FRAME, _END_OF_HEADER, _FRAME_ID, _HEADER_BYTES = 0x02, 0x80, 0x01, 2
_STREAM = STREAM_IN & 15

TICKS_PER_S = 10_000  # exposure times are counted in 100 us
_INTERVALS_PER_S = 10_000_000
_LOG = 400
_METERED_TO = 0.46  # of full scale, what automatic exposure aims at
_WANDER, _WANDER_SLOTS = 0.2, 9.0  # of the light, while white balance is automatic
_BACKLIGHT = 0.25  # more light for each step of backlight compensation


def _listed(value: Any) -> Any:
    return value if isinstance(value, list | tuple) else (value,)


class UvcConfig(BaseModel):
    """What a virtual webcam is like; all but what it looks at.

    Attributes:
        serial: its serial number
        formats: names in `sim.devices.uvc_descriptors.FORMATS`
        sizes: WIDTHxHEIGHT beside the picture's own, which comes first
        fps: frame rates, the default first
        delay: of exposure and gain, frames
        jitter: up to so many frames more, at random
        luma: range of yuyv
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    serial: str = Field(default="UVC00001", min_length=1, max_length=60, pattern=r"^[ -~]+$")
    formats: Annotated[tuple[str, ...], BeforeValidator(_listed)] = ("yuyv", "mjpg")
    sizes: Annotated[tuple[str, ...], BeforeValidator(_listed)] = ()
    fps: Annotated[tuple[Annotated[float, Field(ge=1, le=240)], ...], BeforeValidator(_listed)] = (
        Field(default=(10.0,), min_length=1)
    )
    delay: int = Field(default=2, ge=0, le=30)
    jitter: int = Field(default=0, ge=0, le=30)
    luma: Literal["full", "limited"] = "limited"


class UvcCamera(UsbDevice):
    """The webcam; `make` builds one of a configuration."""

    device_descriptor = device_descriptor()

    def __init__(
        self, config: UvcConfig, exposers: Mapping[tuple[int, int], Exposer], seed: int
    ) -> None:
        self.config = config
        self._sizes = tuple(exposers)  # (rows, columns)
        self._exposers = exposers
        self._intervals = tuple(round(_INTERVALS_PER_S / rate) for rate in config.fps)
        self.strings = ("", "camctl", "virtual webcam", config.serial)
        self.configuration_descriptor = configuration_descriptor(
            config.formats, self._sizes, self._intervals
        )
        super().__init__()
        self.zero_length.discard(_STREAM)
        self.controls = {name: control.default for name, control in CONTROLS.items()}
        self.clamp_s = math.inf
        self._wrong_factor, self._wrong_left = 1.0, 0
        self._truncated = self._rubbish = 0
        self._is_hanging = self._is_frozen = False
        self._error = 0
        self._seed = seed
        self._chosen = (1, 1, self._intervals[0])  # format and frame number, interval
        self._committed = self._chosen
        self._stream: _Stream | None = None
        self.log: deque[dict[str, Any]] = deque(maxlen=_LOG)
        self.writes: deque[dict[str, Any]] = deque(maxlen=_LOG)
        self.sent = 0
        self.late = 0

    # ---- what the host asks

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
        if entity == 0 and selector == _ERROR_CODE and request == _GET:
            return bytes([self._error])
        for name, control in CONTROLS.items():
            if (control.entity, control.selector) == (entity, selector):
                return self._ask(name, control, request, data)
        return self._refuse(_INVALID_CONTROL)

    def halt_cleared(self, endpoint: int) -> None:
        """Stop streaming: hosts clear the halt of a bulk endpoint for that."""
        if endpoint & 15 == _STREAM:
            self._stop()

    def detached(self) -> None:
        """Forget all that was set, as a camera without current does."""
        self._stop()
        with self.lock:
            self.controls = {name: control.default for name, control in CONTROLS.items()}

    def _refuse(self, why: int) -> Answer:
        self._error = why
        return STALL

    def _ask(self, name: str, control: ControlSpec, request: int, data: bytes) -> Answer:
        if request == _INFO:
            return bytes([self._abilities(name)])
        if request == _LEN:
            return control.size.to_bytes(2, "little")
        if request == _SET:
            return self._set(name, control, int.from_bytes(data[: control.size], "little"))
        answers = {
            _GET: self.controls[name],
            _MIN: control.minimum,
            _MAX: control.maximum,
            _RES: control.step,
            _DEF: control.default,
        }
        if request not in answers:
            return self._refuse(_INVALID_REQUEST)
        return control.pack(answers[request])

    def _is_automatic(self, name: str) -> bool:
        if name in ("exposure", "gain"):
            return self.controls["ae_mode"] != MANUAL
        return name == "wb_temperature" and self.controls["wb_auto"] == 1

    def _abilities(self, name: str) -> int:
        changes = _CHANGES_ITSELF if name in ("exposure", "gain", "wb_temperature") else 0
        return _CAN_GET_AND_SET | changes | (_DISABLED if self._is_automatic(name) else 0)

    def _set(self, name: str, control: ControlSpec, value: int) -> Answer:
        if self._is_automatic(name):
            return self._refuse(_WRONG_STATE)
        allowed = value in (1, 8) if name == "ae_mode" else (value - control.minimum) >= 0
        if not allowed or value > control.maximum:
            return self._refuse(_OUT_OF_RANGE)
        with self.lock:
            if name == "exposure":
                value = min(value, max(1, round(min(self.clamp_s, 1e5) * TICKS_PER_S)))
            self.controls[name] = value
            if name in ("exposure", "gain", "ae_mode") and self._stream is not None:
                self._stream.write(*self.exposure())
        return b""

    def exposure(self) -> tuple[float, float]:
        """Return the shutter time, s, and the linear gain that are set."""
        return self.controls["exposure"] / TICKS_PER_S, 1 + self.controls["gain"] / 16

    def _negotiate(self, request: int, selector: int, data: bytes) -> Answer:
        if selector not in (_PROBE, _COMMIT):
            return STALL
        if request == _INFO:
            return bytes([_CAN_GET_AND_SET])
        if request == _LEN:
            return (26).to_bytes(2, "little")
        if request != _SET:
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

    # ---- streaming

    def _start(self) -> None:
        self._stop()
        with self.lock:
            self.flush(STREAM_IN)
            self._committed = self._chosen
            form, frame, interval = self._committed
            stream = _Stream(
                self,
                self._exposers[self._sizes[frame - 1]],
                self.config.formats[form - 1],
                interval / _INTERVALS_PER_S,
                self._seed,
            )
            self._stream = stream
        stream.start()

    def _stop(self) -> None:
        with self.lock:
            stream, self._stream = self._stream, None
            self.flush(STREAM_IN)
        if stream is not None:
            stream.stop()

    def light(self, slot: int) -> float:
        """Return how many times the light frame `slot` gets, by automatics and by faults."""
        with self.lock:
            light = 1 + _BACKLIGHT * self.controls["backlight"]
            if self.controls["wb_auto"]:
                light *= 1 + _WANDER * math.sin(slot / _WANDER_SLOTS)
            if self._wrong_left > 0:
                self._wrong_left -= 1
                light *= self._wrong_factor
            return light

    def is_slowed(self) -> bool:
        """Say whether frames come at half their rate, for more light."""
        return self.controls["ae_priority"] == 1 and self.controls["ae_mode"] != MANUAL

    def meter(self, light: float) -> None:
        """Change the exposure by the mean of a frame, 0 to 1, where that is automatic."""
        with self.lock:
            if self.controls["ae_mode"] == MANUAL:
                return
            wanted = self.controls["exposure"] * min(2.0, _METERED_TO / max(light, 0.05))
            interval_s = self._committed[2] / _INTERVALS_PER_S
            most = max(1, math.floor(min(interval_s, self.clamp_s) * TICKS_PER_S))
            self.controls["exposure"] = min(max(1, round(wanted)), most)
            if self._stream is not None:
                self._stream.write(*self.exposure())

    def hand_over(self, data: bytes, is_second: bool) -> None:
        """Send one frame as one payload, or what a fault makes of it."""
        with self.lock:
            if self._is_frozen:
                return
            if self.pending(STREAM_IN):
                self.late += 1  # the host has not taken the last one yet
                return
            flags = _END_OF_HEADER | _END_OF_FRAME | (_FRAME_ID if is_second else 0)
            payload = bytes([_HEADER_BYTES, flags]) + data
            if self._truncated > 0:
                self._truncated -= 1
                payload = payload[: len(payload) // 2]
            if self._rubbish > 0:
                self._rubbish -= 1
                payload = random.Random(self.sent).randbytes(len(payload))
            self.sent += 1
            self.send(_STREAM, payload)

    # ---- verbs

    def do_ok(self) -> None:
        """End all faults."""
        with self.lock:
            self._is_hanging = self._is_frozen = False
            self._truncated = self._rubbish = self._wrong_left = 0
            self.clamp_s = math.inf

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
        """Cut shutter times to `max_s` without a word."""
        if not max_s > 0:
            raise UsageError(f"shutter times up to {max_s} s", hint="give seconds above 0")
        self.clamp_s = max_s

    def do_wrong(self, factor: float = 2.0, count: int = 1) -> None:
        """Give the next frames so many times the light."""
        self._wrong_factor, self._wrong_left = factor, count

    def do_truncate(self, count: int = 1) -> None:
        """Send half of the next frames."""
        self._truncated = count

    def do_garbage(self, count: int = 1) -> None:
        """Send rubbish instead of the next frames."""
        self._rubbish = count

    def do_log(self) -> dict[str, Any]:
        """Return the last frames (slot, exposure in force, light, and when they ended), and writes.

        A write has its exposure and the first slot that had not begun when it came.
        """
        with self.lock:
            return {"frames": list(self.log), "writes": list(self.writes)}

    def do_delay(self, frames: int, jitter: int = 0) -> None:
        """Be so many frames late, and at random up to `jitter` more, from the next stream on."""
        late = {"delay": frames, "jitter": jitter}
        self.config = UvcConfig.model_validate({**self.config.model_dump(), **late})

    def state(self) -> dict[str, Any]:
        """Return controls, what is streamed, and how many frames went out and were too late."""
        with self.lock:
            form, frame, interval = self._committed
            rows, columns = self._sizes[frame - 1]
            return {
                "controls": dict(self.controls),
                "is_streaming": self._stream is not None,
                "format": self.config.formats[form - 1],
                "size": f"{columns}x{rows}",
                "fps": _INTERVALS_PER_S / interval,
                "sent": self.sent,
                "late": self.late,
            }


class _Stream:
    """Frames from commit to stop, in a thread of their own."""

    def __init__(
        self, camera: UvcCamera, exposer: Exposer, form: str, interval_s: float, seed: int
    ) -> None:
        self._camera = camera
        self._exposer = exposer
        self._format = form
        self._interval_s = interval_s
        longest_s = max(1, math.floor(interval_s * TICKS_PER_S)) / TICKS_PER_S
        sensor = exposer.sensor.model_copy(
            update={
                "time_minimum_s": 1 / TICKS_PER_S,
                "time_maximum_s": longest_s,
                "line_s": 1 / TICKS_PER_S,
                "gain_maximum": 16.0,
                "gain_step": 1 / 16,
                "delay_frames": camera.config.delay,
                "delay_jitter_frames": camera.config.jitter,
                "frame_interval_s": interval_s,
            }
        )
        self._lock = threading.Lock()  # of the sensor's registers; never held while it sleeps
        self._is_over = threading.Event()
        self._clock = RealClock()
        self._began_s = self._clock.now()
        self._device = SimulatedDevice(sensor, self._render, self._clock, seed=seed)
        self._device.write(ExposureSetting(*camera.exposure()))
        self._thread = threading.Thread(target=self._run, name="uvc-stream", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        self._is_over.set()
        if self._thread is not threading.current_thread():
            self._thread.join(timeout=5)

    def write(self, time_s: float, gain: float) -> None:
        """Set the exposure; it lands as late as the camera's delay says."""
        with self._lock:
            upcoming, setting = self._device.write(ExposureSetting(time_s, gain))
        self._camera.writes.append(
            {"upcoming": upcoming, "time_s": setting.time_s, "gain": setting.gain}
        )

    def _render(self, slot: Slot) -> Pixels:
        # As the wire counts them, so that the time is the float nearest to its decimal.
        ticks = slot.time_s * TICKS_PER_S
        time_s = round(ticks) / TICKS_PER_S if abs(ticks - round(ticks)) < 1e-6 else slot.time_s
        self._camera.log.append(
            {
                "slot": slot.sequence,
                "time_s": time_s,
                "gain": slot.gain,
                "ended_s": self._began_s + (slot.sequence + 1) * self._interval_s,
            }
        )
        return self._exposer.expose(time_s, slot.gain, slot.sequence)

    def _run(self) -> None:
        is_second = False
        slot = 0
        while not self._is_over.is_set():
            slot += 1
            # Slots are even: no exposure is longer than the interval.
            self._clock.sleep_until(self._began_s + slot * self._interval_s)
            with self._lock:
                buffer = self._device.dequeue(0.0)
                slot = buffer.sequence + 1 if buffer is not None else slot
            if buffer is None or (self._camera.is_slowed() and buffer.sequence % 2):
                continue
            pixels = self._device.read_out(buffer, light=self._camera.light(buffer.sequence))
            self._camera.meter(float(pixels.mean()) / (2**self._exposer.sensor.bits - 1))
            self._camera.hand_over(self._pack(pixels), is_second)
            is_second = not is_second

    def _pack(self, pixels: Pixels) -> bytes:
        form = FORMATS[self._format]
        if form.layout is not None:
            if form.bytes_a_pixel == 1:
                return pixels.astype(np.uint8).tobytes()
            return pixels.astype("<u2").tobytes()
        luma = self._luma(pixels)
        if self._format == "mjpg":
            return bytes(cv2.imencode(".jpg", luma, [cv2.IMWRITE_JPEG_QUALITY, 95])[1])
        packed = np.full((*luma.shape, 2), 128, np.uint8)
        packed[..., 0] = luma
        return packed.tobytes()

    def _luma(self, pixels: Pixels) -> NDArray[np.uint8]:
        """Return the picture as 8-bit luma in the range of the format."""
        luma = (pixels >> max(0, self._exposer.sensor.bits - 8)).astype(np.uint8)
        if luma.ndim == 3:
            luma = np.asarray(cv2.cvtColor(luma, cv2.COLOR_RGB2GRAY), np.uint8)
        offset = self._camera.controls["brightness"] - CONTROLS["brightness"].default
        if offset:
            luma = np.clip(luma.astype(np.int16) + offset, 0, 255).astype(np.uint8)
        if self._camera.config.luma == "limited" and self._format == "yuyv":
            luma = np.rint(16 + luma * (219 / 255)).astype(np.uint8)
        return luma


def make(config: Mapping[str, Any]) -> UvcCamera:
    """Return the webcam that a configuration describes.

    Raises:
        UsageError, DataError: something in it is unknown or out of range
    """
    exposer, own = split_config(config)
    camera = checked(UvcConfig, own)
    for name in camera.formats:
        if name not in FORMATS:
            raise unknown_name("pixel format", name, FORMATS)
        form = FORMATS[name]
        if form.layout is not None and (
            form.layout is not exposer.layout or form.bits < exposer.sensor.bits
        ):
            raise UsageError(
                f"{name} for a sensor of {exposer.sensor.bits} bits, {exposer.layout}",
                hint="choose another format or sensor",
            )
        if form.layout is None and exposer.layout.is_mosaic:
            raise UsageError(f"{name} for a Bayer sensor", hint="choose a Bayer format")
    exposers = {exposer.shape: exposer}
    seed = int(config.get("seed", 0))
    for size in camera.sizes:
        shape = parse_size(size)
        scene = load_scene(str(config["scene"]), shape, usual=exposer.sensor.shape)
        repeat = bool(config.get("repeat_noise", False))
        exposers[shape] = Exposer(scene, exposer.sensor, seed=seed, repeat_noise=repeat)
    return UvcCamera(camera, exposers, seed)
