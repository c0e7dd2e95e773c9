"""What is behind the protocol of any still camera: a shutter, a sensor, files and a card."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

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
    """

    time_s: float | None
    gain: float
    light: float
    kinds: tuple[str, ...]


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


class StillBody:
    """Takes one picture at a time, each in a thread of its own.

    Args:
        exposer: the sensor before its scene
        lock: of the device; held while a picture is handed over
        stem: of file names, four letters
        delay_s: from the end of an exposure until its files are on the card
        grey: one channel in the JPEG and TIFF of a mono sensor
        quality: of JPEGs, 1 to 100
        object_bytes: files shorter than this are padded with zeros at their end
    """

    def __init__(
        self,
        exposer: Exposer,
        lock: threading.RLock,
        *,
        stem: str,
        delay_s: float = 0.0,
        grey: bool = True,
        quality: int = 95,
        object_bytes: int = 0,
    ) -> None:
        self.exposer = exposer
        self.faults = Faults()
        self.quality = quality
        self.taken = 0
        self.log: deque[dict[str, Any]] = deque(maxlen=_LOG)
        self._lock = lock
        self._stem = stem
        self._delay_s = delay_s
        self._grey = grey
        self._object_bytes = object_bytes
        self._released = threading.Event()
        self._worker: threading.Thread | None = None

    @property
    def is_exposing(self) -> bool:
        """True from the release until the files are on the card."""
        return self._worker is not None

    @property
    def largest_file(self) -> int:
        """No file of one exposure is larger, bytes."""
        rows, columns = self.exposer.shape[:2]
        return max(self._object_bytes, rows * columns * 3 * 2 + 65536)

    def mend(self) -> None:
        """End all faults."""
        self.faults = Faults()

    def release(self, exposure: Exposure, done: Callable[[Sequence[Picture]], None]) -> None:
        """Open the shutter; another thread calls `done`, with the lock, when the files are there.

        Not to be called while it is exposing.
        """
        assert self._worker is None
        self._released.clear()
        self._worker = threading.Thread(
            target=self._expose, args=(exposure, done), name=f"{self._stem}-shutter", daemon=True
        )
        self._worker.start()

    def note_download(self, name: str) -> None:
        """Hear that a file has been handed to the host to its end."""
        for shot in reversed(self.log):
            if name in shot["names"]:
                shot["downloaded_s"] = shot["downloaded_s"] or time.monotonic()
                return

    def state(self) -> dict[str, Any]:
        """Return how many pictures were taken, and the last exposure, ready for JSON."""
        return {"shots": self.taken, "exposure": self.log[-1] if self.log else None}

    def end_bulb(self) -> None:
        """Close the shutter of a bulb exposure."""
        self._released.set()

    def wait(self, timeout_s: float = 10.0) -> None:
        """Wait until nothing is exposed, and nothing that was waiting for that."""
        deadline = time.monotonic() + timeout_s
        while (worker := self._worker) and time.monotonic() < deadline:
            worker.join(timeout_s)

    def _expose(self, exposure: Exposure, done: Callable[[Sequence[Picture]], None]) -> None:
        began = time.monotonic()
        time_s = exposure.time_s
        if time_s is None:
            self._released.wait(BULB_MAX_S)
            time_s = time.monotonic() - began
        pictures = self._develop(exposure, time_s)
        time.sleep(max(0.0, began + time_s + self._delay_s - time.monotonic()))
        with self._lock:
            shot = asdict(replace(exposure, time_s=time_s))
            ended_s = began + time_s
            names = [picture.name for picture in pictures]
            self.log.append(
                {"began_s": began, "ended_s": ended_s, "downloaded_s": None, "names": names, **shot}
            )
            self._worker = None
            done(pictures)

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
        pictures = []
        for kind in exposure.kinds:
            data = encode(kind, exposed, grey=self._grey, quality=self.quality)
            data += bytes(max(0, self._object_bytes - len(data)))
            name = f"{self._stem}{self.taken:04d}.{SUFFIXES[kind]}"
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
