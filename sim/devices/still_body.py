"""What is behind the protocol of any still camera: a shutter, a sensor, files and a card."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

from sim.devices.clock import DeviceClock, ScheduledCall
from sim.devices.scenery import Exposer
from sim.devices.still_files import SUFFIXES, Exposed, encode, thumbnail

CARD_BYTES = 256 * 1024 * 1024
_LOG = 256  # exposures that are remembered
BULB_MAX_S = 120.0  # a bulb exposure that nobody ends ends itself


@dataclass(frozen=True, eq=False)
class Picture:
    """A file on the card.

    Attributes:
        kind: jpeg, tiff or dng
        name: on the card
        data: the file
        thumbnail: a small JPEG of it
        rows, columns: of the picture
        bits: a pixel
        time_s: what it was exposed for
    """

    kind: str
    name: str
    data: bytes
    thumbnail: bytes
    rows: int
    columns: int
    bits: int
    time_s: float


@dataclass(frozen=True)
class Exposure:
    """What the shutter is told.

    Attributes:
        time_s: how long; None: until it is released (bulb)
        gain: linear, of the sensor
        light: what the aperture lets through, 1 for the widest
        kinds: the files to make
        quality: of JPEGs, 1 to 100
    """

    time_s: float | None
    gain: float
    light: float
    kinds: tuple[str, ...]
    quality: int = 95


@dataclass
class Faults:
    """What is wrong with a still camera at the moment, whatever its protocol.

    Attributes:
        wrong_factor: so many times the light ..
        wrong_left: .. in so many next exposures
        clamp_s: longer shutter times are cut to this without a word; None: they are not
        is_card_full: no room for a picture
        is_battery_low: too low to take one
    """

    wrong_factor: float = 1.0
    wrong_left: int = 0
    clamp_s: float | None = None
    is_card_full: bool = False
    is_battery_low: bool = False


@dataclass(frozen=True)
class BodyOptions:
    """How a still camera names, pads and delays its files.

    Attributes:
        stem: of file names, four letters
        delay_s: from the end of an exposure until its files are on the card
        grey: one channel in the JPEG and TIFF of a mono sensor
        object_bytes: files shorter than this are padded with zeros at their end
    """

    stem: str
    delay_s: float = 0.0
    grey: bool = True
    object_bytes: int = 0


@dataclass(frozen=True, eq=False)
class _Shot:
    """An exposure that is running: when it began, and what follows it."""

    exposure: Exposure
    done: Callable[[Sequence[Picture]], None]
    began_s: float


class StillBody:
    """Takes one picture at a time; what it does by itself it schedules on its clock.

    Args:
        exposer: the sensor before its scene
        lock: of the device; held in every call from outside, and while a picture is handed over
        clock: on which exposures are timed
        options: see `BodyOptions`

    Attributes:
        taken: how many pictures were taken
        log: the last exposures, ready for JSON
    """

    def __init__(
        self, exposer: Exposer, lock: threading.RLock, clock: DeviceClock, options: BodyOptions
    ) -> None:
        self.exposer = exposer
        self.faults = Faults()
        self.taken = 0
        self.log: deque[dict[str, Any]] = deque(maxlen=_LOG)
        self._lock = lock
        self._clock = clock
        self._options = options
        self._is_idle = threading.Event()
        self._is_idle.set()
        self._bulb: tuple[_Shot, ScheduledCall] | None = None  # with the end of its time limit

    @property
    def is_exposing(self) -> bool:
        """True from the release until the files are on the card."""
        return not self._is_idle.is_set()

    @property
    def largest_file(self) -> int:
        """No file of one exposure is larger, bytes."""
        rows, columns = self.exposer.shape[:2]
        return max(self._options.object_bytes, rows * columns * 3 * 2 + 65536)

    def mend(self) -> None:
        """End all faults."""
        self.faults = Faults()

    def release(self, exposure: Exposure, done: Callable[[Sequence[Picture]], None]) -> None:
        """Open the shutter; `done` is called, with the lock held, when the files are on the card.

        Not to be called while it is exposing.
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

    def note_download(self, name: str) -> None:
        """Record that the host has read a file to its end."""
        for shot in reversed(self.log):
            if name in shot["names"]:
                if shot["downloaded_s"] is None:
                    shot["downloaded_s"] = self._clock.now()
                return

    def state(self) -> dict[str, Any]:
        """Return how many pictures were taken, and the last exposure, ready for JSON."""
        return {"shots": self.taken, "exposure": self.log[-1] if self.log else None}

    def wait(self, timeout_s: float = 60.0) -> None:
        """Wait until no exposure is running, and what was to follow it has been done.

        Raises:
            TimeoutError: an exposure is still running after `timeout_s`
        """
        deadline_s = self._clock.now() + timeout_s
        while self._clock.wait_for(self._is_idle, deadline_s):
            with self._lock:  # held until the files have been handed over
                if self._is_idle.is_set():
                    return
        raise TimeoutError(f"the virtual camera is still exposing after {timeout_s:g} s")

    def _read_out(self, shot: _Shot) -> None:
        time_s = shot.exposure.time_s
        assert time_s is not None
        pictures = self._develop(shot.exposure, time_s)
        ended_s = shot.began_s + time_s
        finish = partial(self._finish, shot, ended_s, pictures)
        self._clock.call_at(ended_s + self._options.delay_s, finish)

    def _finish(self, shot: _Shot, ended_s: float, pictures: Sequence[Picture]) -> None:
        with self._lock:
            names = [picture.name for picture in pictures]
            times = {"began_s": shot.began_s, "ended_s": ended_s, "downloaded_s": None}
            self.log.append({**times, "names": names, **asdict(shot.exposure)})
            self._is_idle.set()
            shot.done(pictures)

    def _develop(self, exposure: Exposure, time_s: float) -> list[Picture]:
        light, faults = exposure.light, self.faults
        if faults.wrong_left > 0:
            faults.wrong_left -= 1
            light *= faults.wrong_factor
        exposer = self.exposer
        number = self.taken
        self.taken += 1
        pixels = exposer.expose(time_s * light, exposure.gain, number)
        bits = exposer.sensor.bits
        exposed = Exposed(pixels, exposer.layout, bits, exposer.black, exposer.white, time_s)
        small = thumbnail(exposed)
        rows, columns = pixels.shape[:2]
        options = self._options
        pictures = []
        for kind in exposure.kinds:
            data = encode(kind, exposed, grey=options.grey, quality=exposure.quality)
            data += bytes(max(0, options.object_bytes - len(data)))
            name = f"{options.stem}{self.taken:04d}.{SUFFIXES[kind]}"
            depth = bits * (3 if pixels.ndim == 3 else 1)
            pictures.append(Picture(kind, name, data, small, rows, columns, depth, time_s))
        return pictures


class StillVerbs:
    """Verbs for what can be wrong with any still camera."""

    body: StillBody

    def do_card_full(self) -> None:
        """Have no room for a picture."""
        self.body.faults.is_card_full = True

    def do_battery_low(self) -> None:
        """Have too little charge for a picture."""
        self.body.faults.is_battery_low = True

    def do_wrong(self, factor: float = 2.0, count: int = 1) -> None:
        """Expose the next pictures with so many times the light."""
        self.body.faults.wrong_factor, self.body.faults.wrong_left = factor, count

    def do_clamp(self, max_s: float) -> None:
        """Cut shutter times to `max_s` without a word."""
        self.body.faults.clamp_s = max_s
