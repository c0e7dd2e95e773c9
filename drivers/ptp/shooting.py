"""Exposures and their files: the shutter is released, the file is found and fetched.

A camera announces a new picture by an event that may come early, late or never.  Events also
announce folders, and second files of cameras that save raw and JPEG.  So both events and lists of
object handles are read, and each new object is asked for its description.
"""

from __future__ import annotations

import logging
import math
from contextlib import suppress
from dataclasses import dataclass

from camctl.drivers.common.known_format import WrongFormatError
from camctl.drivers.ptp.body import Body
from camctl.drivers.ptp.codes import DEVICE_BUSY, FOLDER
from camctl.drivers.ptp.datasets import ObjectInfo
from camctl.drivers.ptp.session import UNKNOWN_SIZE
from camctl.drivers.ptp.still_formats import FileKey, format_of, key_of
from camctl.drivers.ptp.transport import CAPTURE_S, NORMAL_S
from camctl.errors import CameraBusyError, CameraError, CameraProtocolError, CameraTimeoutError
from camctl.interface.clock import check_cancelled
from camctl.interface.controls import ExposureSetting

# Handles are listed beside events: first this long after the exposure, then less and less often,
# since the list of a full card is long.
_FIRST_LIST_S, _LONGEST_LIST_S = 0.1, 1.0
# How long a poll waits for an event, at least and at most; the share of the time since the end of
# the exposure; and the wait for events that are already there.
# A capture that is cancelled is noticed after a poll.
_EVENT_S, _LONGEST_EVENT_S, _EVENT_SHARE, _WAITING_EVENT_S = 0.05, 0.25, 0.05, 0.001
# Added to the rest of an exposure, so that a poll ends after the exposure and not just before it.
_EVENT_MARGIN_S = 0.005
# How long after the end of an exposure its files may still appear.
_LATE_FILES_S = 3.0
# How long after the end of an exposure it is said that its picture is waited for: after late files.
_SILENT_S = 5.0
# A camera that answers "busy" is asked again this long: until it is clear that it needs its last
# picture to be fetched first.  Pauses are doubled from the first to the longest.
_SHORT_BUSY_S = 0.3
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.02, 0.3
# A camera may take a dark exposure of the same time, to reduce the noise, and answer "busy" until
# its end.  This is what libgphoto2 waits; it is added to both exposures here.
_BUSY_AFTER_EXPOSURE_S = 1000.0
# A camera that has not answered that it is busy for so long is no longer busy.
_BUSY_PAUSE_S = 3 * _LONGEST_LIST_S
# More pictures than a camera can have in its memory.
_MAX_IN_MEMORY = 32

_log = logging.getLogger(__name__)


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
        deadline_s: when the camera counts as unresponsive if there is no file; it includes a dark
            exposure of the same time
        held_s: how long the computer held a bulb exposure; None: the camera timed the exposure
        aborted_s: when the exposure was ended early, on the camera's clock; None: it was not
    """

    request: ExposureRequest
    released_s: float
    deadline_s: float
    held_s: float | None = None
    aborted_s: float | None = None

    @property
    def ends_s(self) -> float:
        """When the shutter should close, on the camera's clock."""
        if self.aborted_s is not None:
            return self.aborted_s
        return self.released_s + self.request.setting.time_s

    @property
    def busy_until_s(self) -> float:
        """Until when the camera may answer that it is busy."""
        dark_s = self.request.setting.time_s
        return max(self.ends_s + dark_s + _BUSY_AFTER_EXPOSURE_S, self.deadline_s)


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
        self._undescribed: set[int] = set()  # announced while the camera was busy
        # Files of one exposure share folder and stem; pictures that were deleted free theirs for a
        # file of the same format.
        self._used: set[FileKey] = set()
        self._last: set[FileKey] = set()
        self._deleted: dict[FileKey, int] = {}

    def ignore_existing(self) -> None:
        """Ignore the pictures that are in the camera now."""
        for _ in range(_MAX_IN_MEMORY):
            if self._body.dialect.memory not in self._body.poll_events(_WAITING_EVENT_S).added:
                break
            self._discard_from_memory()
        handles = self._body.handles()
        if handles is not None:  # else the camera is busy, or does not list them
            # Handles and names of pictures that were deleted since may be used again; files of the
            # latest exposure may still come.
            self._known, self._used = set(handles), set(self._last)

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
            if self._body.release(self._silence_s + 2 * request.setting.time_s) != DEVICE_BUSY:
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
        longest_s = 2 * request.setting.time_s + self._silence_s
        return PendingExposure(request, now_s, now_s + longest_s)

    def wait(self, exposure: PendingExposure, format_name: str | None) -> Shot:
        """Return the file of an exposure as soon as the camera has it.

        Args:
            exposure: the exposure
            format_name: one of `camctl.drivers.common.known_format.FORMATS`; None: the first file
                of any format

        Raises:
            CameraTimeoutError: no file appeared within twice the exposure time and `silence_s`, or
                longer if the camera answers that it is busy
            WrongFormatError: the camera saved files of other formats only, or its card is full
        """
        found: dict[int, ObjectInfo] = {}
        discarded: list[ObjectInfo] = []
        complete_s: float | None = None
        busy_s = -math.inf  # when the camera last answered that it is busy
        list_pause_s = _FIRST_LIST_S
        next_list_s = exposure.ends_s + list_pause_s
        is_said = False
        while True:
            check_cancelled()
            if not is_said and self._clock.now() > exposure.ends_s + _SILENT_S:
                is_said = True
                _log.info(
                    "%s has not saved its picture of %.6g s yet: waiting for it for up to %.0f s "
                    "more, and longer while the camera answers that it is busy",
                    self._name,
                    exposure.request.setting.time_s,
                    max(0.0, exposure.deadline_s - self._clock.now()),
                )
            events = self._body.poll_events(self._event_wait_s(exposure))
            if events.is_full:
                raise CameraError(
                    f"the card of {self._name} is full",
                    hint="make room on it or put another one in",
                )
            new, is_busy = set(events.added), False
            if self._clock.now() >= next_list_s:
                list_pause_s = min(2 * list_pause_s, _LONGEST_LIST_S)
                handles = self._body.handles()
                is_busy = handles is None and self._body.lists_objects
                new |= handles or frozenset()
                next_list_s = self._clock.now() + list_pause_s
            is_busy |= events.is_busy
            for handle in sorted((new | self._undescribed) - self._known - set(found)):
                is_busy |= not self._describe(handle, found)
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
            busy_s = now_s if is_busy else busy_s
            is_waiting = now_s < busy_s + _BUSY_PAUSE_S and now_s < exposure.busy_until_s
            if now_s > exposure.deadline_s and not is_waiting:
                raise CameraTimeoutError(
                    f"{self._name} has saved no picture in the "
                    f"{now_s - exposure.released_s:.0f} s since its shutter was released",
                    hint="look at its display: focus, card and battery; then resume",
                )

    def _event_wait_s(self, exposure: PendingExposure) -> float:
        """Return how long to wait for an event: to the end of the exposure, then a share of it.

        An event ends the wait; only pictures that are reported on request come later by it.
        """
        after_s = self._clock.now() - exposure.ends_s
        if after_s < 0:
            return min(_LONGEST_EVENT_S, _EVENT_MARGIN_S - after_s)
        return min(_LONGEST_EVENT_S, max(_EVENT_S, _EVENT_SHARE * after_s))

    def _remaining_s(self, exposure: PendingExposure) -> float:
        return max(0.0, exposure.ends_s - self._clock.now())

    def _describe(self, handle: int, found: dict[int, ObjectInfo]) -> bool:
        """Add a new object to `found` if it is a picture of this exposure; else ignore it.

        Returns False if the camera is busy; the object is then described later.
        """
        try:
            info = self._body.session.object_info(handle, busy_s=0)
        except CameraBusyError:
            self._undescribed.add(handle)
            return False
        except CameraProtocolError:
            return True  # deleted, or not yet complete: the next list will show
        self._undescribed.discard(handle)
        is_memory = handle == self._body.dialect.memory
        key = key_of(info)
        is_new = is_memory or key not in self._used or self._deleted.get(key) == info.format
        if info.format == FOLDER or format_of(info) is None or not is_new:
            self._known.add(handle)
        else:
            found[handle] = info
        return True

    def _shot(self, exposure: PendingExposure, handle: int, found: dict[int, ObjectInfo]) -> Shot:
        info = found[handle]
        memory = self._body.dialect.memory
        self._known.update(h for h in found if h != memory)
        if handle != memory:
            self._last = {key_of(info)}
            self._used |= self._last
            self._deleted.pop(key_of(info), None)
        others = tuple(other.name for h, other in found.items() if h != handle)
        return Shot(exposure, handle, info, min(self._clock.now(), exposure.ends_s), others)

    def _wrong_format(
        self, saved: tuple[ObjectInfo, ...], format_name: str | None
    ) -> WrongFormatError:
        formats = sorted({format_of(info) or "?" for info in saved})
        return WrongFormatError(
            f"{self._name} saved {' and '.join(formats)} instead of {format_name}",
            hint=f"set its image quality to {format_name}, or say that it saves {formats[0]}",
            remedies={"option:format": formats[0]},
        )

    def fetch(self, shot: Shot, *, busy_s: float) -> tuple[bytes, float]:
        """Return a shot's file, and how long the transfer took, s.

        `busy_s` is how long the camera may answer that it is busy.
        """
        began_s = self._clock.now()
        data = self._body.session.object(shot.handle, shot.info.size, busy_s=busy_s)
        return data, self._clock.now() - began_s

    def delete(self, shot: Shot) -> None:
        """Delete a shot's file from the card; its handle and its name may then be used again."""
        if shot.handle != self._body.dialect.memory:
            self._body.session.delete(shot.handle)
            self._known.discard(shot.handle)
            self._deleted[key_of(shot.info)] = shot.info.format

    def wait_for_end(self, exposure: PendingExposure, limit_s: float) -> None:
        """Wait for the end of an exposure whose file is not needed; the file stays on the card.

        Returns `limit_s` after the exposure time at the latest, or after as long a dark exposure if
        the camera answers that it is busy.
        """
        deadline_s = self._clock.now() + self._remaining_s(exposure) + limit_s
        latest_s = max(deadline_s, exposure.deadline_s)
        is_busy = False
        while self._clock.now() < (latest_s if is_busy else deadline_s):
            events = self._body.poll_events(_EVENT_S)
            is_over = self._remaining_s(exposure) == 0
            handles = self._body.handles() if is_over else None
            is_busy = events.is_busy or (is_over and handles is None and self._body.lists_objects)
            new = (set(events.added) | set(handles or ())) - self._known
            self._known.update(new)
            if self._body.dialect.memory in new:  # `ignore_existing` removes it from there
                self._known.discard(self._body.dialect.memory)
                return
            if (events.is_complete and is_over) or self._have_pictures(new):
                return

    def _discard_from_memory(self) -> None:
        """Fetch the first picture in the camera's memory, which removes it from there."""
        memory = self._body.dialect.memory
        assert memory is not None
        with suppress(CameraProtocolError):  # it was fetched, and the camera states it still
            self._body.session.object(memory, UNKNOWN_SIZE)

    def _have_pictures(self, handles: set[int]) -> bool:
        found: dict[int, ObjectInfo] = {}
        for handle in sorted(handles):
            self._describe(handle, found)
        self._used.update(key_of(info) for info in found.values())
        return bool(found)


def _first_of_format(found: dict[int, ObjectInfo], format_name: str | None) -> int | None:
    for handle, info in found.items():
        if format_name is None or format_of(info) == format_name:
            return handle
    return None
