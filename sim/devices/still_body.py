"""The parts of a still camera that no protocol changes: shutter, sensor, files, faults."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any, Literal

from camctl.sim.devices.clock import DeviceClock, ScheduledCall
from camctl.sim.devices.common import VirtualSensor
from camctl.sim.devices.still_files import SUFFIXES, RawImage, encode

CARD_BYTES = 256 * 1024 * 1024  # 256 MB, a usual size of CompactFlash cards
BULB_MAX_S = 120.0  # a bulb exposure that no host ends stops by itself
_LOG_LENGTH = 256  # exposures: a host may never stop
_OVERHEAD_BYTES = 65536  # of headers, tags and thumbnail in a file, at most


@dataclass(frozen=True, eq=False)
class ImageFile:
    """An image file that the camera has made.

    Attributes:
        format: jpeg, tiff or dng
        name: on the card
        data: the file's bytes
        rows, columns: of the picture
        bits: per pixel
    """

    format: str
    name: str
    data: bytes
    rows: int
    columns: int
    bits: int


@dataclass(frozen=True)
class Exposure:
    """The settings of one exposure.

    Attributes:
        time_s: shutter time; None: until the shutter is closed (bulb)
        gain: linear, of the sensor
        light: share of the light that the aperture lets through, 1 for the widest
        formats: of the files to make
        quality: of JPEGs, 1 to 100
        f_number: that the files state; None: none
    """

    time_s: float | None
    gain: float
    light: float
    formats: tuple[str, ...]
    quality: int = 95
    f_number: float | None = None


@dataclass
class StillFaults:
    """Faults of a still camera, whatever its protocol.

    Attributes:
        light_factor, light_count: so many next exposures get so many times the light
        longest_s: longer shutter times are silently cut to this; None: they are not
        is_card_full: there is no room for a picture
        is_battery_low: there is too little charge for a picture
        state: what keeps the camera from taking pictures: "playback", "movie" (modes), "lens" (in a
            wrong position), "retracted lens", "no card"; "": nothing
    """

    light_factor: float = 1.0
    light_count: int = 0
    longest_s: float | None = None
    is_card_full: bool = False
    is_battery_low: bool = False
    state: str = ""


@dataclass(frozen=True)
class BodyOptions:
    """How a still camera names, pads and delays its files.

    Attributes:
        stem: of file names, four letters
        delay_s: from the end of an exposure until its files are on the card
        grey: one channel in the JPEG and TIFF of a mono sensor
        object_bytes: files shorter than this are padded with zeros at their end
        model: that files state
        states_iso: True if files state the sensitivity
        reduces_noise: True if a dark exposure of the same time follows each exposure
    """

    stem: str
    delay_s: float = 0.0
    grey: bool = True
    object_bytes: int = 0
    model: str = ""
    states_iso: bool = False
    reduces_noise: bool = False


@dataclass(frozen=True, eq=False)
class _Shot:
    """A running exposure: its settings, what is called with its files, and when it began."""

    exposure: Exposure
    done: Callable[[Sequence[ImageFile]], None]
    began_s: float


class StillBody:
    """Takes one picture at a time.

    Args:
        sensor: what is exposed
        lock: of the device; held in every call from outside, and while files are delivered
        clock: on which exposures are timed
        options: see `BodyOptions`

    Attributes:
        faults: see `StillFaults`
        taken: how many pictures were taken
        log: the last exposures, ready for JSON
    """

    def __init__(
        self, sensor: VirtualSensor, lock: threading.RLock, clock: DeviceClock, options: BodyOptions
    ) -> None:
        self.sensor = sensor
        self.faults = StillFaults()
        self.taken = 0
        self.log: deque[dict[str, Any]] = deque(maxlen=_LOG_LENGTH)
        self._lock = lock
        self._clock = clock
        self._options = options
        self._is_idle = threading.Event()
        self._is_idle.set()
        self._bulb: tuple[_Shot, ScheduledCall] | None = None  # with the end of its time limit
        self._delivery: tuple[_Shot, list[ImageFile], ScheduledCall] | None = None

    @property
    def is_exposing(self) -> bool:
        """True from the release until the files are on the card."""
        return not self._is_idle.is_set()

    @property
    def largest_file(self) -> int:
        """Upper bound on the size of a file, bytes."""
        rows, columns = self.sensor.shape[:2]
        return max(self._options.object_bytes, rows * columns * 3 * 2 + _OVERHEAD_BYTES)

    def clear_faults(self) -> None:
        self.faults = StillFaults()

    def release(self, exposure: Exposure, done: Callable[[Sequence[ImageFile]], None]) -> None:
        """Open the shutter; `done` is called, with the lock held, when the files are ready.

        Not to be called while the camera is exposing.
        """
        assert not self.is_exposing
        self._is_idle.clear()
        now_s = self._clock.now()
        shot = _Shot(exposure, done, now_s)
        if exposure.time_s is None:
            self._bulb = shot, self._clock.call_at(now_s + BULB_MAX_S, self.end_bulb)
        else:
            # The files are computed while the exposure runs, so that they are ready at its end.
            self._clock.call_at(now_s, partial(self._read_out, shot))

    def end_bulb(self) -> None:
        """Close the shutter of a bulb exposure; nothing happens where none is running."""
        with self._lock:
            if self._bulb is None:
                return
            (shot, limit), self._bulb = self._bulb, None
            limit.cancel()
            now_s = self._clock.now()
            exposure = replace(shot.exposure, time_s=now_s - shot.began_s)
            self._clock.call_at(now_s, partial(self._read_out, replace(shot, exposure=exposure)))

    def abort(self) -> None:
        """Close the shutter now, whatever the exposure time is; the picture is delivered."""
        self.end_bulb()
        with self._lock:
            if self._delivery is not None:
                (shot, files, delivery), self._delivery = self._delivery, None
                delivery.cancel()
                self._call_delivery(shot, files, self._clock.now(), self._clock.now())

    def now(self) -> float:
        return self._clock.now()

    def call_later(self, delay_s: float, act: Callable[[], None]) -> None:
        """Call `act` after `delay_s`, with the lock held."""

        def locked() -> None:
            with self._lock:
                act()

        self._clock.call_at(self._clock.now() + delay_s, locked)

    def note_download(self, name: str) -> None:
        """Record that the host has read a file to its end."""
        for shot in reversed(self.log):
            if name in shot["names"]:
                if shot["downloaded_s"] is None:
                    shot["downloaded_s"] = self._clock.now()
                return

    def state(self) -> dict[str, Any]:
        """Return the number of pictures taken and the last exposure, ready for JSON."""
        return {"shots": self.taken, "exposure": self.log[-1] if self.log else None}

    def wait(self, timeout_s: float = 60.0) -> None:
        """Wait until no exposure is running and the files of the last one are delivered.

        Raises:
            TimeoutError: an exposure is still running after `timeout_s`
        """
        deadline_s = self._clock.now() + timeout_s
        while self._clock.wait_for(self._is_idle, deadline_s):
            with self._lock:  # held while files are delivered, which may begin another exposure
                if self._is_idle.is_set():
                    return
        raise TimeoutError(f"the virtual camera is still exposing after {timeout_s:g} s")

    def _read_out(self, shot: _Shot) -> None:
        time_s = shot.exposure.time_s
        assert time_s is not None
        files = self._make_files(shot.exposure, time_s)
        ended_s = shot.began_s + time_s
        dark_s = time_s if self._options.reduces_noise else 0.0
        with self._lock:
            self._call_delivery(shot, files, ended_s, ended_s + dark_s + self._options.delay_s)

    def _call_delivery(
        self, shot: _Shot, files: list[ImageFile], ended_s: float, at_s: float
    ) -> None:
        call = self._clock.call_at(at_s, partial(self._deliver, shot, ended_s, files))
        self._delivery = shot, files, call

    def _deliver(self, shot: _Shot, ended_s: float, files: Sequence[ImageFile]) -> None:
        with self._lock:
            self._delivery = None
            names = [file.name for file in files]
            times = {"began_s": shot.began_s, "ended_s": ended_s, "downloaded_s": None}
            self.log.append({**times, "names": names, **asdict(shot.exposure)})
            self._is_idle.set()
            shot.done(files)

    def _make_files(self, exposure: Exposure, time_s: float) -> list[ImageFile]:
        light = exposure.light
        if self.faults.light_count > 0:
            self.faults.light_count -= 1
            light *= self.faults.light_factor
        sensor, options = self.sensor, self._options
        pixels = sensor.expose(time_s * light, exposure.gain, self.taken)
        self.taken += 1
        image = RawImage(
            pixels,
            sensor.layout,
            sensor.model.bits,
            sensor.black,
            sensor.white,
            time_s,
            round(100 * exposure.gain) if options.states_iso else None,
            exposure.f_number,
            options.model,
        )
        rows, columns = pixels.shape[:2]
        bits = image.bits * (3 if pixels.ndim == 3 else 1)
        files = []
        for form in exposure.formats:
            data = encode(form, image, grey=options.grey, quality=exposure.quality)
            data += bytes(max(0, options.object_bytes - len(data)))
            name = f"{options.stem}{self.taken:04d}.{SUFFIXES[form]}"
            files.append(ImageFile(form, name, data, rows, columns, bits))
        return files


class StillFaultCommands:
    """Control commands that set the faults of a `StillBody`."""

    body: StillBody

    def do_card_full(self) -> None:
        """Have no room for a picture."""
        self.body.faults.is_card_full = True

    def do_battery_low(self) -> None:
        """Have too little charge for a picture."""
        self.body.faults.is_battery_low = True

    def do_body_state(
        self, state: Literal["", "playback", "movie", "lens", "retracted lens", "no card"]
    ) -> None:
        """Be in a state in which no picture can be taken; "": end it."""
        self.body.faults.state = state

    def do_wrong_exposure(self, factor: float = 2.0, count: int = 1) -> None:
        """Give the next `count` pictures `factor` times the light."""
        self.body.faults.light_factor, self.body.faults.light_count = factor, count

    def do_clamp(self, max_s: float) -> None:
        """Silently cut shutter times to `max_s`."""
        self.body.faults.longest_s = max_s
