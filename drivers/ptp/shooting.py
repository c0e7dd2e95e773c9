"""Exposures and their files: released, waited for by events and by lists, fetched.

Cameras tell of a new picture by an event that comes early, late or never; they tell of its folder
too, and of a second file where they make raw and JPEG.  So both events and lists of handles are
looked at, and every new object is asked what it is.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

from camctl.clock import Clock
from camctl.controls import ExposureSetting
from camctl.errors import CameraBusyError, CameraError, CameraProtocolError, CameraTimeoutError
from drivers.ptp.body import Body
from drivers.ptp.codes import DEVICE_BUSY, FOLDER
from drivers.ptp.datasets import ObjectInfo
from drivers.ptp.session import UNKNOWN_SIZE
from drivers.ptp.still_formats import format_of, stem_of
from drivers.ptp.transport import CAPTURE_S, NORMAL_S

# Lists of handles are long on a full card: they are asked for now and then, beside events.
_FIRST_LIST_S, _LONGEST_LIST_S = 0.1, 1.0
_EVENT_S = 0.05
# How long after an exposure was told to be complete its files may still come.
_GRACE_S = 3.0
_MOST_IN_MEMORY = 32


@dataclass(frozen=True)
class PendingExposure:
    """An exposure that has been released.

    Attributes:
        setting: what it was asked for
        applied: what the camera said it had set
        index: position in the list of settings
        released_s: when, on the clock of the timestamps
        began_s, deadline_s: the same on the machine's monotonic clock, and when silence is too long
        held_s: how long a bulb exposure was held; None: the camera timed it
    """

    setting: ExposureSetting
    applied: ExposureSetting
    index: int
    released_s: float
    began_s: float
    deadline_s: float
    held_s: float | None = None

    @property
    def left_s(self) -> float:
        """Seconds until its shutter should have closed."""
        return max(0.0, self.began_s + self.setting.time_s - time.monotonic())


@dataclass(frozen=True)
class Shot:
    """An exposure whose file waits in the camera.

    Attributes:
        flight: the exposure
        handle, info: the file that is wanted
        ended_s: when the exposure ended, on the clock of the timestamps
        others: names of files that the camera made of it beside this one
    """

    flight: PendingExposure
    handle: int
    info: ObjectInfo
    ended_s: float
    others: tuple[str, ...]

    @property
    def name(self) -> str:
        """What it is, for a person."""
        return f"the picture of {self.flight.setting.time_s:.6g} s ({self.info.name})"


class Shooter:
    """Releases one exposure after another and finds their files.

    Args:
        body: the camera
        who: how errors call it
        clock: of timestamps
        silence_s: how long the camera may take for a picture beyond its exposure
    """

    def __init__(self, body: Body, who: str, clock: Clock, *, silence_s: float = CAPTURE_S) -> None:
        self._body, self._who, self._clock = body, who, clock
        self._silence_s = silence_s
        self._known: set[int] = set()
        self._used_stems: set[str] = set()

    def begin(self) -> None:
        """Take what is on the card now as old."""
        for _ in range(_MOST_IN_MEMORY):
            if self._body.dialect.memory not in self._body.news(0.001).added:
                break
            self._drop_from_memory()
        self._known.update(self._body.handles() or ())

    def release(
        self,
        setting: ExposureSetting,
        applied: ExposureSetting,
        index: int,
        *,
        patient: bool,
    ) -> PendingExposure | None:
        """Release an exposure; None where the camera is busy and `patient` is False.

        Raises:
            CameraBusyError: it stays busy
            CameraError: it says why it does not
        """
        deadline = time.monotonic() + (NORMAL_S if patient else 0.3)
        pause_s = 0.02
        while True:
            began_s, released_s = time.monotonic(), self._clock.now()
            if self._body.release(self._silence_s + setting.time_s) != DEVICE_BUSY:
                return self.flight(setting, applied, index, released_s, began_s)
            if time.monotonic() > deadline:
                if not patient:
                    return None
                raise CameraBusyError(
                    f"{self._who} is busy and takes no picture",
                    hint="wait until its lamp is off, then resume",
                )
            time.sleep(pause_s)
            pause_s = min(2 * pause_s, 0.3)

    def flight(
        self,
        setting: ExposureSetting,
        applied: ExposureSetting,
        index: int,
        released_s: float,
        began_s: float,
    ) -> PendingExposure:
        """Return an exposure that has begun; arguments as `PendingExposure` has them."""
        deadline_s = began_s + setting.time_s + self._silence_s
        return PendingExposure(setting, applied, index, released_s, began_s, deadline_s)

    def wait(self, flight: PendingExposure, wanted: str | None) -> Shot:
        """Return the file of an exposure, once it is there.

        Args:
            flight: the exposure
            wanted: one of `objects.FORMATS`; None: whichever comes first

        Raises:
            CameraTimeoutError: no file came within the exposure and `silence_s`
            CameraError: the camera made other files, or its card is full
        """
        found: dict[int, ObjectInfo] = {}
        passed_over: list[ObjectInfo] = []
        complete_s: float | None = None
        list_pause_s = _FIRST_LIST_S
        next_list_s = flight.began_s + flight.setting.time_s + list_pause_s
        while True:
            news = self._body.news(min(_EVENT_S, 0.005 + flight.left_s))
            if news.is_full:
                raise CameraError(
                    f"{self._who}: its card is full",
                    hint="make room on the card or put another one in",
                )
            new = set(news.added)
            if time.monotonic() >= next_list_s:
                list_pause_s = min(2 * list_pause_s, _LONGEST_LIST_S)
                new |= self._body.handles() or frozenset()
                next_list_s = time.monotonic() + list_pause_s
            for handle in sorted(new - self._known - set(found)):
                self._look_at(handle, found)
            chosen = self._pick(found, wanted)
            if chosen is not None:
                return self._shot(flight, chosen, found)
            if self._body.dialect.memory in found:
                # What waits in memory is served one after the other, and this one is in the way.
                self._drop_from_memory()
                dropped = found.pop(self._body.dialect.memory)
                passed_over.append(dropped)
            now = time.monotonic()
            made = (*found.values(), *passed_over)
            if made and complete_s is None:
                complete_s = max(now, flight.began_s + flight.setting.time_s)
            if complete_s is not None and now > complete_s + min(_GRACE_S, self._silence_s / 2):
                kinds = sorted({format_of(info) or "?" for info in made})
                self._known.update(found)
                raise CameraError(
                    f"{self._who} made {' and '.join(kinds)} where {wanted} was wanted",
                    hint=f"set its image quality to {wanted}, or give -O format={kinds[0]}",
                )
            if now > flight.deadline_s:
                raise CameraTimeoutError(
                    f"{self._who} was released {now - flight.began_s:.0f} s ago, and no picture "
                    "has come",
                    hint="look at its display: focus, card and battery; then resume",
                )

    def _look_at(self, handle: int, found: dict[int, ObjectInfo]) -> None:
        """Ask what a new object is; what is no picture of this exposure is not asked again."""
        try:
            info = self._body.session.object_info(handle)
        except CameraProtocolError:
            return  # gone again, or not yet there: the next list will tell
        is_memory = handle == self._body.dialect.memory
        is_sibling = not is_memory and stem_of(info) in self._used_stems
        if info.format == FOLDER or format_of(info) is None or is_sibling:
            self._known.add(handle)
        else:
            found[handle] = info

    @staticmethod
    def _pick(found: dict[int, ObjectInfo], wanted: str | None) -> int | None:
        for handle, info in found.items():
            if wanted is None or format_of(info) == wanted:
                return handle
        return None

    def _shot(self, flight: PendingExposure, handle: int, found: dict[int, ObjectInfo]) -> Shot:
        info = found[handle]
        memory = self._body.dialect.memory
        self._known.update(h for h in found if h != memory)
        if handle != memory:
            self._used_stems.add(stem_of(info))
        others = tuple(other.name for h, other in found.items() if h != handle)
        ended_s = min(self._clock.now(), flight.released_s + flight.setting.time_s)
        return Shot(flight, handle, info, ended_s, others)

    def fetch(self, shot: Shot, *, busy_s: float) -> tuple[bytes, float]:
        """Return the bytes of a shot's file and how many seconds they took."""
        began = time.monotonic()
        session = self._body.session
        data = session.object(shot.handle, shot.info.size, busy_s=busy_s)
        return data, time.monotonic() - began

    def delete(self, shot: Shot) -> None:
        """Delete a shot's file from the card."""
        if shot.handle != self._body.dialect.memory:
            self._body.session.delete(shot.handle)

    def settle(self, flight: PendingExposure, limit_s: float) -> None:
        """Wait for the end of an exposure that nobody wants any more; its files stay on the card.

        Returns after `limit_s` beyond the exposure at the latest.
        """
        deadline = time.monotonic() + flight.left_s + limit_s
        while time.monotonic() < deadline:
            news = self._body.news(_EVENT_S)
            handles = self._body.handles() if flight.left_s == 0 else None
            new = (set(news.added) | set(handles or ())) - self._known
            self._known.update(new)
            memory = self._body.dialect.memory
            if memory in new:
                self._known.discard(memory)
                self._drop_from_memory()
                return
            if (news.is_complete and flight.left_s == 0) or self._has_pictures(new):
                return

    def _drop_from_memory(self) -> None:
        """Make room for the next picture in a memory that serves them one after the other."""
        memory = self._body.dialect.memory
        assert memory is not None
        self._body.session.object(memory, UNKNOWN_SIZE)

    def _has_pictures(self, handles: set[int]) -> bool:
        found: dict[int, ObjectInfo] = {}
        for handle in sorted(handles):
            self._look_at(handle, found)
        self._used_stems.update(stem_of(info) for info in found.values())
        return bool(found)
