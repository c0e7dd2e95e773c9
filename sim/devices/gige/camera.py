"""A camera on GigE Vision with a simulated sensor: triggers, free run, chunk data and a sequencer.

A setting that is written while slot k is exposed is in force from slot k + 1 + delay on; in free
run a slot is as long as the frame interval or the exposure, whichever is longer, and with triggers
it is one exposure.  A trigger that comes while an exposure runs is ignored.  After power-on
exposure, gain and gamma are automatic, and each changes the picture.  A controller that is silent
longer than the heartbeat allows has lost control, and the acquisition stops.
"""

from __future__ import annotations

import math
import struct
import threading
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np

from camctl.errors import CameraBusyError
from camctl.interface.camera import Pixels
from camctl.interface.clock import RealClock
from camctl.sim.devices.common import Controllable, VirtualSensor
from camctl.sim.devices.gige import control
from camctl.sim.devices.gige.config import GigeConfig
from camctl.sim.devices.gige.control import ControlChannel
from camctl.sim.devices.gige.exposures import DelayedSettings, Exposure, Sequencer, SequencerSet
from camctl.sim.devices.gige.features import (
    BASE,
    CHUNKS,
    SLOT,
    XML_ADDRESS,
    camera_features,
    describe,
    formats,
)
from camctl.sim.devices.gige.stream import FramePacket, StreamChannel, pack, payload_bytes

MAKE, MODEL = "camctl", "virtual GigE camera"
_LOG_LENGTH = 400  # frames
_BOOTSTRAP_BYTES = 0xB000
_CAPABILITY = 1 << 31 | 1 << 30 | 1 << 2 | 1 << 1 | 1  # name, serial, resend, memory, several
_PACKET_SIZE, _STREAM_PORT, _STREAM_IP = 0xD04, 0xD00, 0xD18
_FIRE_TEST = 1 << 31
_POLL_S = 0.02  # how often a wait for a trigger looks whether the acquisition has ended
_GAMMA = 0.45  # of the picture where gamma is on
_FLICKER, _FLICKER_FRAMES = 0.2, 9.0  # light under automatic exposure or gain, and its period
_POWER_ON = Exposure(5000.0, 0.0)


class GigeCamera(Controllable):
    """The camera; `make` builds one from a configuration.

    Args:
        config: see `GigeConfig`
        sensor: what is exposed
    """

    def __init__(self, config: GigeConfig, sensor: VirtualSensor) -> None:
        self.config = config
        self._sensor = sensor
        self._clock = RealClock()
        self._formats = formats(sensor.layout, sensor.model.bits)
        left_out = {
            "Trigger": not config.has_trigger,
            "Chunk": not config.has_chunks,
            "Sequencer": config.sets == 0,
        }
        self.features = [
            each
            for each in camera_features(sensor.shape, self._formats, sets=config.sets)
            if not any(away and each.name.startswith(start) for start, away in left_out.items())
        ]
        self._place = {each.name: index for index, each in enumerate(self.features)}
        self._xml = describe(self.features, MAKE, MODEL)
        self._bootstrap = self._bootstrap_registers()
        self._lock = threading.RLock()  # of everything below
        self._values: dict[str, float] = {}
        gain_delay = config.delay if config.gain_delay is None else config.gain_delay
        self._settings = DelayedSettings(
            _POWER_ON, config.delay, gain_delay, config.jitter, config.seed
        )
        self._sequencer = Sequencer(config.sets, _POWER_ON, config.lead)
        self._chunks_on: set[int] = set()
        self._is_exposing, self._slot = False, 0
        self._block = 0
        self._stated: deque[Exposure] = deque(maxlen=1 + config.chunk_delay)
        self._trigger = threading.Event()
        self._is_over: threading.Event | None = None
        self._thread: threading.Thread | None = None
        self._log: deque[dict[str, Any]] = deque(maxlen=_LOG_LENGTH)
        self._is_frozen, self._light = False, 1.0
        self._ignored_triggers = 0
        self.reset()
        self.channel = ControlChannel(self, config.ip, self._clock)
        self.stream: StreamChannel | None = None

    # As a device that can be plugged in and out.

    def attach(self) -> None:
        """Connect it to the network.

        Raises:
            CameraBusyError: another camera has its address
        """
        config = self.config
        self.stream = StreamChannel(
            config.ip, loss=config.loss, can_resend=config.resend, seed=config.seed
        )
        try:
            self.channel.start()
        except OSError as error:
            self.stream.close()
            raise CameraBusyError(
                f"the port of GigE Vision at {config.ip} is taken", hint="choose another address"
            ) from error

    def detach(self) -> None:
        """Disconnect it and switch it off."""
        self._stop()
        self.channel.stop()
        if self.stream is not None:
            self.stream.close()
            self.stream = None
        with self._lock:
            self.reset()

    def reset(self) -> None:
        """Set every register as it is after power-on."""
        automatic = 2 if self.config.automatic else 0
        self._values = {each.name: each.minimum for each in self.features}
        first = next(iter(self._formats.values()))
        self._values |= {
            "PixelFormat": first.code,
            "AcquisitionFrameRate": self.config.fps,
            "ExposureTime": _POWER_ON.time_us,
            "Gain": _POWER_ON.gain_db,
            "ExposureAuto": automatic,
            "GainAuto": automatic,
            "GammaEnable": int(self.config.automatic),
            "BlackLevel": self._sensor.black,
            "GevTimestampTickFrequency": self.config.ticks_per_s,
        }
        self._chunks_on = set()

    def state(self) -> dict[str, Any]:
        stream = self.stream
        return {
            "time_s": self._values["ExposureTime"] / 1e6,
            "gain": Exposure(0, self._values["Gain"]).gain,
            "is_acquiring": self._thread is not None,
            "has_controller": self.channel.controller is not None,
            "ignored_triggers": self._ignored_triggers,
            "lost_packets": stream.lost if stream else 0,
            "resent_packets": stream.resent if stream else 0,
        }

    def do_log(self) -> dict[str, Any]:
        """Return the last frames."""
        return {"frames": list(self._log)}

    def do_freeze(self) -> None:
        """Expose, but send no frame, and answer no command."""
        self._is_frozen = self.channel.is_silent = True

    def do_ok(self) -> None:
        """End all faults."""
        self._is_frozen = self.channel.is_silent = False
        self._light = 1.0
        if self.stream is not None:
            self.stream.lose_next, self.stream.loss = 0, self.config.loss

    def do_lose(self, frames: int = 1) -> None:
        """Lose one packet of each of the next frames."""
        if self.stream is not None:
            self.stream.lose_next = frames

    def do_delay(self, frames: int, jitter: int = 0, gain: int | None = None) -> None:
        """Let settings take effect at another frame."""
        self._settings.delays = (frames, frames if gain is None else gain)
        self._settings.jitter = jitter

    def do_light(self, factor: float = 1.0) -> None:
        """Multiply the light."""
        self._light = factor

    def do_seize(self) -> None:
        """Take control away from the controller, as after a lost heartbeat."""
        self.channel.release()

    # As the control channel sees it.

    def discovery(self) -> bytes:
        return bytes(self._bootstrap[:0xF8])

    def read(self, address: int, size: int) -> bytes | int:
        if XML_ADDRESS <= address < XML_ADDRESS + len(self._xml) + SLOT:
            place = address - XML_ADDRESS
            return self._xml[place : place + size].ljust(size, b"\0")
        if BASE <= address < BASE + SLOT * len(self.features):
            first, last = (address - BASE) // SLOT, (address + size - 1 - BASE) // SLOT
            with self._lock:
                found = [
                    each.pack(self._value(each.name)) for each in self.features[first : last + 1]
                ]
            place = (address - BASE) % SLOT
            return b"".join(found)[place : place + size]
        if address + size <= len(self._bootstrap):
            return bytes(self._bootstrap[address : address + size])
        return control.INVALID_ADDRESS

    def write(self, address: int, data: bytes) -> int:
        if BASE <= address < BASE + SLOT * len(self.features):
            feature = self.features[(address - BASE) // SLOT]
            if feature.name == "AcquisitionStop":
                self._stop()
                return control.OK
            with self._lock:
                return self._write_feature(feature.name, data)
        if address + len(data) > len(self._bootstrap):
            return control.INVALID_ADDRESS
        self._bootstrap[address : address + len(data)] = data
        return self._stream_changed(address)

    def resend(self, block: int, first: int, last: int) -> None:
        if self.stream is not None:
            self.stream.resend(block, first, last)

    def control_lost(self) -> None:
        self._stop()

    def _stream_changed(self, address: int) -> int:
        if self.stream is None:
            return control.BUSY
        port, size = (self._word(place) for place in (_STREAM_PORT, _PACKET_SIZE))
        ip = ".".join(map(str, self._bootstrap[_STREAM_IP : _STREAM_IP + 4]))
        self.stream.target = (ip, port & 0xFFFF) if port & 0xFFFF else None
        self.stream.packet_bytes = max(100, size & 0xFFFC)
        if address == _PACKET_SIZE and size & _FIRE_TEST:
            struct.pack_into(">I", self._bootstrap, _PACKET_SIZE, size & ~_FIRE_TEST)
            self.stream.send_test(size & 0xFFFC)
        return control.OK

    def _word(self, address: int) -> int:
        return int(struct.unpack_from(">I", self._bootstrap, address)[0])

    # Features.

    def _value(self, name: str) -> float:
        values = self._values
        if name == "PayloadSize":
            form = next(
                each for each in self._formats.values() if each.code == values["PixelFormat"]
            )
            return payload_bytes(self._sensor.shape, form, self._chunk_count)
        if name == "ChunkEnable":
            return int(values["ChunkSelector"] in self._chunks_on)
        if name == "SequencerSetActive":
            return self._sequencer.active
        return values[name]

    @property
    def _chunk_count(self) -> int:
        return len(self._chunks_on) if self._values.get("ChunkModeActive") else 0

    def _write_feature(self, name: str, data: bytes) -> int:
        feature = self.features[self._place[name]]
        if feature.is_read_only or name in self.config.refused:
            return control.WRITE_PROTECT
        if len(data) not in (4, 8):
            return control.INVALID_PARAMETER
        value = feature.unpack(data)
        if not feature.allows(value):
            return control.INVALID_PARAMETER
        if self._is_locked(name):
            return control.ACCESS_DENIED
        command = getattr(self, f"_on_{name}", None)
        if command is not None:
            command(value)
            return control.OK
        if name == "ExposureTime":
            step = self.config.time_step_us
            value = max(round(value / step), 1) * step
        self._values[name] = value
        if name in ("ExposureTime", "Gain"):
            upcoming = self._slot + self._is_exposing
            self._settings.write(self._exposure, upcoming)
        return control.OK

    def _is_locked(self, name: str) -> bool:
        """Return whether a feature cannot be written in the present state."""
        values = self._values
        is_running = self._thread is not None
        is_configuring = bool(values.get("SequencerConfigurationMode"))
        if name in ("PixelFormat", "ChunkModeActive", "ChunkEnable", "SequencerMode"):
            return is_running or (name == "SequencerMode" and is_configuring)
        if name == "SequencerConfigurationMode":
            return is_running or bool(values.get("SequencerMode"))
        if name in ("SequencerSetSave", "SequencerSetNext", "SequencerSetStart"):
            return not is_configuring
        automatic = {"ExposureTime": "ExposureAuto", "Gain": "GainAuto"}.get(name)
        return automatic is not None and bool(values[automatic] or values.get("SequencerMode"))

    @property
    def _exposure(self) -> Exposure:
        return Exposure(self._values["ExposureTime"], self._values["Gain"])

    def _on_AcquisitionStart(self, _: float) -> None:  # noqa: N802
        self._start()

    def _on_TriggerSoftware(self, _: float) -> None:  # noqa: N802
        if self._values["TriggerSource"] != 0 or self._is_exposing or self._trigger.is_set():
            self._ignored_triggers += 1
        else:
            self._trigger.set()

    def _on_ChunkEnable(self, value: float) -> None:  # noqa: N802
        chosen = int(self._values["ChunkSelector"])
        (self._chunks_on.add if value else self._chunks_on.discard)(chosen)

    def _on_SequencerSetSave(self, _: float) -> None:  # noqa: N802
        following = int(self._values["SequencerSetNext"])
        place = int(self._values["SequencerSetSelector"])
        self._sequencer.sets[place] = SequencerSet(self._exposure, following)

    def _on_SequencerSetLoad(self, _: float) -> None:  # noqa: N802
        chosen = self._sequencer.sets[int(self._values["SequencerSetSelector"])]
        self._values["ExposureTime"] = chosen.exposure.time_us
        self._values["Gain"] = chosen.exposure.gain_db
        self._values["SequencerSetNext"] = chosen.following

    # Acquisition.

    def _start(self) -> None:
        if self._thread is not None or self.stream is None:
            return
        if self._values.get("SequencerMode"):
            self._sequencer.start(int(self._values["SequencerSetStart"]))
        self._block = 0
        self._trigger.clear()
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(self._is_over,), daemon=True)
        self._thread.start()

    def _stop(self) -> None:
        """End the acquisition; the lock must be free, as the thread that exposes needs it."""
        thread, self._thread = self._thread, None
        if self._is_over is not None:
            self._is_over.set()
        if thread is not None:
            thread.join()

    def _run(self, is_over: threading.Event) -> None:
        begin_s = self._clock.now()
        while not is_over.is_set():
            is_triggered = bool(self._values.get("TriggerMode"))
            if is_triggered:
                if not self._trigger.wait(_POLL_S) or is_over.is_set():
                    continue
                begin_s = self._clock.now()
            with self._lock:
                self._trigger.clear()
                self._is_exposing = True
                time_s = self._next_exposure().time_s
            end_s = begin_s + (time_s if is_triggered else max(time_s, self._interval_s))
            if is_over.wait(max(0.0, end_s - self._clock.now())):
                self._is_exposing = False
                return
            with self._lock:
                exposure, active = self._next_exposure(), self._sequencer.active
                self._is_exposing = False
                self._slot += 1
                if self._values.get("SequencerTriggerSource"):
                    self._sequencer.advance()
            self._finish(exposure, active, end_s)
            begin_s = end_s

    @property
    def _interval_s(self) -> float:
        rate = self._values["AcquisitionFrameRate"]
        return 1 / (
            min(rate, self.config.fps)
            if self._values["AcquisitionFrameRateEnable"]
            else self.config.fps
        )

    def _next_exposure(self) -> Exposure:
        if self._values.get("SequencerMode"):
            return self._sequencer.sets[self._sequencer.active].exposure
        return self._settings.at(self._slot)

    def _finish(self, exposure: Exposure, active: int, end_s: float) -> None:
        """Read a frame out and send it."""
        slot = self._slot - 1
        light = self._light * self._automatic_light(slot)
        pixels = self._sensor.expose(exposure.time_s * light, exposure.gain, slot)
        self._clock.sleep_until(end_s + self.config.readout_s)
        self._block = self._block % 65535 + 1
        self._stated.append(exposure)
        self._log.append(
            {
                "slot": slot,
                "block": self._block,
                "time_s": exposure.time_s,
                "gain": exposure.gain,
                "ended_s": end_s,
            }
        )
        stream = self.stream
        if stream is None or self._is_frozen:
            return
        form = next(
            each for each in self._formats.values() if each.code == self._values["PixelFormat"]
        )
        image = pack(self._developed(pixels), form, self._sensor.model.bits)
        ticks = round(end_s * self.config.ticks_per_s)
        chunks = self._chunk_data(active, ticks)
        stream.send(FramePacket(self._block, ticks, form.code, self._sensor.shape, image, chunks))

    def _automatic_light(self, slot: int) -> float:
        is_automatic = self._values["ExposureAuto"] or self._values["GainAuto"]
        if not is_automatic or self._values.get("SequencerMode"):
            return 1.0
        return 1 + _FLICKER * math.sin(2 * math.pi * slot / _FLICKER_FRAMES)

    def _developed(self, pixels: Pixels) -> Pixels:
        """Return the samples with the gamma and the black level that are set."""
        top = 2**self._sensor.model.bits - 1
        shift = self._values["BlackLevel"] - self._sensor.black
        if shift:
            pixels = np.clip(pixels + np.rint(shift), 0, top).astype(pixels.dtype)
        if self._values["GammaEnable"]:
            pixels = np.rint(top * (pixels / top) ** _GAMMA).astype(pixels.dtype)
        return pixels

    def _chunk_data(self, active: int, ticks: int) -> dict[int, bytes]:
        stated = self._stated[0]
        every = {
            "ExposureTime": struct.pack(">d", stated.time_us),
            "Gain": struct.pack(">d", stated.gain_db),
            "Timestamp": struct.pack(">Q", ticks),
            "FrameID": struct.pack(">Q", self._block),
            "SequencerSetActive": struct.pack(">Q", active),
        }
        if not self._chunk_count:
            return {}
        numbers = dict(zip(range(len(CHUNKS)), CHUNKS.items(), strict=True))
        return {numbers[i][1]: every[numbers[i][0]] for i in sorted(self._chunks_on)}

    def _bootstrap_registers(self) -> bytearray:
        """Return the bootstrap registers (GigE Vision 2.0, chapter 27)."""
        memory = bytearray(_BOOTSTRAP_BYTES)
        config = self.config
        mac = sum(byte << 8 * i for i, byte in enumerate(config.serial.encode()[:4])) & 0xFFFFFFFF
        ip = bytes(map(int, config.ip.split(".")))
        words = {
            0x000: 2 << 16,
            0x004: 1 << 31 | 1,  # big-endian, UTF-8
            0x008: 0x0200,
            0x00C: mac,
            0x010: 0b111,
            0x014: 0b001,
            0x034: 0xFF000000,
            0x600: 1,
            0x900: 0,
            0x904: 1,
            0x934: _CAPABILITY,
            0x93C: 0,
            0x940: config.ticks_per_s,
            _PACKET_SIZE: 1440,
        }
        for address, word in words.items():
            struct.pack_into(">I", memory, address, word)
        url = f"Local:camera.xml;{XML_ADDRESS:x};{len(self._xml):x}"
        texts = {0x48: MAKE, 0x68: MODEL, 0x88: "1.0", 0xD8: config.serial, 0x200: url}
        for address, text in texts.items():
            memory[address : address + len(text)] = text.encode()
        memory[0x24:0x28] = ip
        return memory


def make(config: Mapping[str, Any]) -> GigeCamera:
    """Return the camera of a configuration.

    Raises:
        UsageError, DataError: an option is invalid
    """
    chosen = GigeConfig.parse(config)
    return GigeCamera(chosen, chosen.load_sensor())
