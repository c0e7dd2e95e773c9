"""Exposures and their files: the shutter is released, the file is found and fetched.

A camera announces a new picture by an event that may come early, late or never.  Events also
announce folders, and second files of cameras that save raw and JPEG.  So both events and lists of
object handles are read, and each new object is asked for its description.
"""

from __future__ import annotations

from dataclasses import dataclass

from camctl.controls import ExposureSetting
from camctl.errors import CameraBusyError, CameraError, CameraProtocolError, CameraTimeoutError
from drivers.ptp.body import Body
from drivers.ptp.codes import DEVICE_BUSY, FOLDER
from drivers.ptp.datasets import ObjectInfo
from drivers.ptp.session import UNKNOWN_SIZE
from drivers.ptp.still_formats import format_of, stem_of
from drivers.ptp.transport import CAPTURE_S, NORMAL_S

# Handles are listed beside events: first this long after the exposure, then less and less often,
# since the list of a full card is long.
_FIRST_LIST_S, _LONGEST_LIST_S = 0.1, 1.0
# How long a poll waits for an event, and a poll of those that are already there.
_EVENT_S, _WAITING_EVENT_S = 0.05, 0.001
# Added to the rest of an exposure, so that a poll ends after the exposure and not just before it.
_EVENT_MARGIN_S = 0.005
# How long after the end of an exposure its files may still appear.
_LATE_FILES_S = 3.0
# A camera that answers "busy" is asked again this long: until it is clear that it needs its last
# picture to be fetched first.  Pauses are doubled from the first to the longest.
_SHORT_BUSY_S = 0.3
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.02, 0.3
# More pictures than a camera can have in its memory.
_MAX_IN_MEMORY = 32


@dataclass(frozen=True)
class ExposureRequest:
    """An exposure to take.

    Attributes:
        setting: as requested
        applied: as read back from the camera
        index: position in the list of settings
    """

    setting: ExposureSetting
    applied: ExposureSetting
    index: int


@dataclass(frozen=True)
class PendingExposure:
    """An exposure that has been released; its file has not been found.

    Attributes:
        request: the exposure
        released_s: when the shutter was released, on the camera's clock
        deadline_s: when the camera counts as unresponsive if there is no file
        held_s: how long the computer held a bulb exposure; None: the camera timed the exposure
    """

    request: ExposureRequest
    released_s: float
    deadline_s: float
    held_s: float | None = None

    @property
    def ends_s(self) -> float:
        """When the shutter should close, on the camera's clock."""
        return self.released_s + self.request.setting.time_s


@dataclass(frozen=True)
class Shot:
    """An exposure whose file is in the camera.

    Attributes:
        exposure: the exposure
        handle, info: the file
        ended_s: when the exposure ended, on the camera's clock
        others: names of other files of the same exposure
    """

    exposure: PendingExposure
    handle: int
    info: ObjectInfo
    ended_s: float
    others: tuple[str, ...]

    @property
    def name(self) -> str:
        """Exposure time and file name, for error messages."""
        time_s = self.exposure.request.setting.time_s
        return f"the picture of {time_s:.6g} s ({self.info.name})"


class Shooter:
    """Releases one exposure after another and finds their files.

    Args:
        body: the camera
        name: name of the camera in error messages
        silence_s: how long the camera may take for a picture beyond its exposure
    """

    def __init__(self, body: Body, name: str, *, silence_s: float = CAPTURE_S) -> None:
        self._body, self._name = body, name
        self._clock = body.session.clock
        self._silence_s = silence_s
        self._known: set[int] = set()
        self._used_stems: set[str] = set()

    def ignore_existing(self) -> None:
        """Ignore the pictures that are in the camera now."""
        for _ in range(_MAX_IN_MEMORY):
            if self._body.dialect.memory not in self._body.poll_events(_WAITING_EVENT_S).added:
                break
            self._discard_from_memory()
        self._known.update(self._body.handles() or ())

    def release(self, request: ExposureRequest, *, may_wait: bool) -> PendingExposure | None:
        """Release an exposure; None if the camera is busy and `may_wait` is False.

        Raises:
            CameraBusyError: the camera stays busy
            CameraError: the camera does not take the picture, with the reason it gives
        """
        deadline_s = self._clock.now() + (NORMAL_S if may_wait else _SHORT_BUSY_S)
        pause_s = _FIRST_PAUSE_S
        while True:
            pending = self.pending(request)
            if self._body.release(self._silence_s + request.setting.time_s) != DEVICE_BUSY:
                return pending
            if self._clock.now() > deadline_s:
                if not may_wait:
                    return None
                raise CameraBusyError(
                    f"{self._name} is busy and takes no picture",
                    hint="wait until its lamp is off, then resume",
                )
            self._clock.sleep_until(self._clock.now() + pause_s)
            pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)

    def pending(self, request: ExposureRequest) -> PendingExposure:
        """Return `request` as an exposure that is released now."""
        now_s = self._clock.now()
        return PendingExposure(request, now_s, now_s + request.setting.time_s + self._silence_s)

    def wait(self, exposure: PendingExposure, format_name: str | None) -> Shot:
        """Return the file of an exposure as soon as the camera has it.

        Args:
            exposure: the exposure
            format_name: one of `drivers.ptp.still_formats.FORMATS`; None: the first file of any
                format

        Raises:
            CameraTimeoutError: no file appeared within the exposure time and `silence_s`
            CameraError: the camera saved files of other formats only, or its card is full
        """
        found: dict[int, ObjectInfo] = {}
        discarded: list[ObjectInfo] = []
        complete_s: float | None = None
        list_pause_s = _FIRST_LIST_S
        next_list_s = exposure.ends_s + list_pause_s
        while True:
            events = self._body.poll_events(
                min(_EVENT_S, _EVENT_MARGIN_S + self._remaining_s(exposure))
            )
            if events.is_full:
                raise CameraError(
                    f"the card of {self._name} is full",
                    hint="make room on it or put another one in",
                )
            new = set(events.added)
            if self._clock.now() >= next_list_s:
                list_pause_s = min(2 * list_pause_s, _LONGEST_LIST_S)
                new |= self._body.handles() or frozenset()
                next_list_s = self._clock.now() + list_pause_s
            for handle in sorted(new - self._known - set(found)):
                self._describe(handle, found)
            chosen = _first_of_format(found, format_name)
            if chosen is not None:
                return self._shot(exposure, chosen, found)
            if self._body.dialect.memory in found:
                # Pictures in memory are served one after another: this one blocks the next.
                self._discard_from_memory()
                discarded.append(found.pop(self._body.dialect.memory))
            now_s = self._clock.now()
            saved = (*found.values(), *discarded)
            if saved and complete_s is None:
                complete_s = max(now_s, exposure.ends_s)
            late_s = min(_LATE_FILES_S, self._silence_s / 2)
            if complete_s is not None and now_s > complete_s + late_s:
                self._known.update(found)
                raise self._wrong_format(saved, format_name)
            if now_s > exposure.deadline_s:
                raise CameraTimeoutError(
                    f"{self._name} has saved no picture in the "
                    f"{now_s - exposure.released_s:.0f} s since its shutter was released",
                    hint="look at its display: focus, card and battery; then resume",
                )

    def _remaining_s(self, exposure: PendingExposure) -> float:
        return max(0.0, exposure.ends_s - self._clock.now())

    def _describe(self, handle: int, found: dict[int, ObjectInfo]) -> None:
        """Add a new object to `found` if it is a picture of this exposure; else ignore it."""
        try:
            info = self._body.session.object_info(handle)
        except CameraProtocolError:
            return  # deleted, or not yet complete: the next list will show
        is_memory = handle == self._body.dialect.memory
        is_sibling = not is_memory and stem_of(info) in self._used_stems
        if info.format == FOLDER or format_of(info) is None or is_sibling:
            self._known.add(handle)
        else:
            found[handle] = info

    def _shot(self, exposure: PendingExposure, handle: int, found: dict[int, ObjectInfo]) -> Shot:
        info = found[handle]
        memory = self._body.dialect.memory
        self._known.update(h for h in found if h != memory)
        if handle != memory:
            self._used_stems.add(stem_of(info))
        others = tuple(other.name for h, other in found.items() if h != handle)
        return Shot(exposure, handle, info, min(self._clock.now(), exposure.ends_s), others)

    def _wrong_format(self, saved: tuple[ObjectInfo, ...], format_name: str | None) -> CameraError:
        formats = sorted({format_of(info) or "?" for info in saved})
        return CameraError(
            f"{self._name} saved {' and '.join(formats)} instead of {format_name}",
            hint=f"set its image quality to {format_name}, or give -O format={formats[0]}",
        )

    def fetch(self, shot: Shot, *, busy_s: float) -> tuple[bytes, float]:
        """Return a shot's file, and how long the transfer took, s.

        `busy_s` is how long the camera may answer that it is busy.
        """
        began_s = self._clock.now()
        data = self._body.session.object(shot.handle, shot.info.size, busy_s=busy_s)
        return data, self._clock.now() - began_s

    def delete(self, shot: Shot) -> None:
        """Delete a shot's file from the card."""
        if shot.handle != self._body.dialect.memory:
            self._body.session.delete(shot.handle)

    def wait_for_end(self, exposure: PendingExposure, limit_s: float) -> None:
        """Wait for the end of an exposure whose file is not needed; the file stays on the card.

        Returns `limit_s` after the exposure time at the latest.
        """
        deadline_s = self._clock.now() + self._remaining_s(exposure) + limit_s
        while self._clock.now() < deadline_s:
            events = self._body.poll_events(_EVENT_S)
            is_over = self._remaining_s(exposure) == 0
            handles = self._body.handles() if is_over else None
            new = (set(events.added) | set(handles or ())) - self._known
            self._known.update(new)
            memory = self._body.dialect.memory
            if memory in new:
                self._known.discard(memory)
                self._discard_from_memory()
                return
            if (events.is_complete and is_over) or self._have_pictures(new):
                return

    def _discard_from_memory(self) -> None:
        """Fetch the first picture in the camera's memory, which removes it from there."""
        memory = self._body.dialect.memory
        assert memory is not None
        self._body.session.object(memory, UNKNOWN_SIZE)

    def _have_pictures(self, handles: set[int]) -> bool:
        found: dict[int, ObjectInfo] = {}
        for handle in sorted(handles):
            self._describe(handle, found)
        self._used_stems.update(stem_of(info) for info in found.values())
        return bool(found)


def _first_of_format(found: dict[int, ObjectInfo], format_name: str | None) -> int | None:
    for handle, info in found.items():
        if format_name is None or format_of(info) == format_name:
            return handle
    return None
