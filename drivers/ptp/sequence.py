"""A sequence of exposures on one body: dials set, shutter released, files fetched.

For each exposure the dials are set and read back, the shutter is released, the file of the exposure
before is fetched and its frame yielded, and then the end of this exposure is awaited.  If a camera
answers "busy" to a release while a picture waits in it, pictures are fetched before the next
release from then on.
"""

from __future__ import annotations

import logging
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePath

from camctl.drivers.common.known_format import (
    KnownFormat,
    OtherExposureError,
    checked_exposure,
    matched_pixels,
)
from camctl.drivers.common.still_camera import StillTimes
from camctl.drivers.ptp.body import Body
from camctl.drivers.ptp.dials import Dial
from camctl.drivers.ptp.shooting import ExposureRequest, PendingExposure, Shooter, Shot
from camctl.drivers.ptp.transport import NORMAL_S
from camctl.errors import (
    CameraError,
    CameraProtocolError,
    CameraTimeoutError,
    InterruptedCaptureError,
)
from camctl.interface.camera import Frame, OriginalFile
from camctl.interface.clock import cancelled_by
from camctl.interface.controls import ExposureSetting
from camctl.stills.decoding import read_still
from camctl.system.interrupts import uninterrupted

# Largest error of a bulb exposure, s; the load of the computer decides how precisely it is held.
_MAX_BULB_ERROR_S = 0.25
# After so long without an answer, beyond its exposure, a cancelled camera is not waited for, s: as
# after which a camera in the network is asked whether it is still there.
_HANGING_S = 5.0
# How often a sequence begins anew because the camera sent a picture of an exposure before: one that
# another session has left running, and the two of its own that it takes for later ones then.
_MOST_STALE = 3

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Dials:
    """The dials that set the exposure; None if the camera does not have it."""

    time_s: Dial
    gain: Dial | None
    f_number: Dial | None


class ExposureSequence:
    """Takes exposures on a body and yields their frames.

    Args:
        body: the camera
        shooter: releases exposures and finds their files
        dials: of the camera
        name: name of the camera in error messages
        delete: delete files from the card once their frames were taken
    """

    def __init__(
        self, body: Body, shooter: Shooter, dials: Dials, name: str, *, delete: bool
    ) -> None:
        self._body, self._shooter, self._dials = body, shooter, dials
        self._name, self._delete = name, delete
        self._clock = body.session.clock
        self._pending: PendingExposure | None = None
        self._is_released = False  # the camera has confirmed the release of the pending exposure
        self._waiting: Shot | None = None  # its file is in the camera, its frame not yet yielded
        self._fetched: list[Shot] = []
        self._overlaps = True
        self._stale = _MOST_STALE

    @property
    def overlaps(self) -> bool:
        """Whether files are fetched during exposures; it shows in the first sequence."""
        return self._overlaps

    def run(
        self, settings: Sequence[ExposureSetting], known: KnownFormat, times: StillTimes
    ) -> Generator[Frame, None, None]:
        """Yield a frame for each setting; `known` is the format of all frames.

        What the exposures and the files took is added to `times`.  Until the first frame, pictures
        of an exposure that an earlier session has left running are set aside.

        Raises:
            CameraError: as `camctl.Camera.shoot`; lists what was taken and not fetched
        """
        while True:
            try:
                return (yield from self._run(settings, known, times))
            except OtherExposureError as error:
                if not self._stale:
                    raise
                self._stale -= 1
                _log.warning(
                    "%s: it is of an exposure before, and left on the card; shooting again",
                    error.what.partition(";")[0],
                )
                if self._pending is None and self._waiting is not None:
                    self._pending = self._waiting.exposure  # its own picture is still to come

    def _run(
        self, settings: Sequence[ExposureSetting], known: KnownFormat, times: StillTimes
    ) -> Generator[Frame, None, None]:
        self._waiting, self._fetched = None, []
        if settings:
            self.finish_pending()
            self._shooter.ignore_existing()
        try:
            for index, setting in enumerate(settings):
                # While the computer holds the shutter of a bulb exposure it can fetch nothing;
                # beside a picture of an exposure before, none may be under way.
                is_stale = 0 < self._stale < _MOST_STALE
                if not self._overlaps or is_stale or self._is_bulb(setting):
                    yield from self._fetch_waiting(known, times)
                began_s = self._clock.now()
                request = ExposureRequest(setting, self._apply(setting), index)
                pending = self._release(request, may_wait=self._waiting is None)
                if pending is None:
                    self._overlaps = False
                    yield from self._fetch_waiting(known, times)
                    began_s = self._clock.now()
                    pending = self._release(request, may_wait=True)
                assert pending is not None
                is_alone = self._waiting is None
                yield from self._fetch_waiting(known, times)
                self._waiting = self._wait(pending, known.format)
                if is_alone:  # else its file may have waited for the end of the transfer
                    readout_s = self._clock.now() - pending.ends_s
                    times.add_exposure(pending.released_s - began_s, readout_s)
                self._delete_fetched()
            yield from self._fetch_waiting(known, times)
            self._delete_fetched()
        except CameraError as error:
            self._add_unfetched(error)
            raise
        except (GeneratorExit, KeyboardInterrupt, InterruptedCaptureError):
            self._abort()
            raise

    def take(self, setting: ExposureSetting, format_name: str | None) -> Shot:
        """Take one picture; return its file in the format `format_name`, see `Shooter.wait`."""
        self._shooter.ignore_existing()
        request = ExposureRequest(setting, self._apply(setting), 0)
        pending = self._release(request, may_wait=True)
        assert pending is not None
        return self._wait(pending, format_name)

    def finish_pending(self, limit_s: float = NORMAL_S) -> None:
        """Wait for the end of a cancelled exposure, at most `limit_s` beyond its exposure time."""
        pending, is_hanging = self._pending, self._is_hanging
        self._pending = None
        if pending is not None and not is_hanging:
            rest_s = max(0.0, pending.ends_s - self._clock.now())
            _log.info(
                "waiting until %s has ended its exposure of %.6g s, for up to %.0f s",
                self._name,
                pending.request.setting.time_s,
                rest_s + limit_s,
            )
            self._shooter.wait_for_end(pending, limit_s)

    @property
    def _is_hanging(self) -> bool:
        """Whether the camera has left a transaction without an answer, longer than it exposes."""
        asked_s, pending = self._body.session.asked_s, self._pending
        if asked_s is None:
            return False
        exposure_s = 0.0 if pending is None else pending.request.setting.time_s
        return self._clock.now() > asked_s + exposure_s + _HANGING_S

    @uninterrupted
    def _abort(self) -> None:
        """End the exposure that runs, where the camera can; it stays pending until its end."""
        pending = self._pending
        if pending is None or self._is_hanging:
            return
        with cancelled_by(None):
            is_over = self._is_bulb(pending.request.setting)  # `_hold` has closed the shutter
            if is_over or (self._is_released and self._body.abort()):
                self._pending = replace(pending, aborted_s=self._clock.now())

    # ---- exposures

    def _apply(self, setting: ExposureSetting) -> ExposureSetting:
        """Set the dials; return the setting read back."""
        dials, properties = self._dials, self._body.properties
        applied = setting
        if dials.gain is not None:
            applied = replace(applied, gain=properties.set_dial(dials.gain, setting.gain))
        if dials.f_number is not None and setting.f_number is not None:
            f_number = properties.set_dial(dials.f_number, setting.f_number)
            applied = replace(applied, f_number=f_number)
        if not self._is_bulb(setting):
            time_s = properties.set_dial(dials.time_s, setting.time_s)
            applied = replace(applied, time_s=time_s)
        return applied

    def _is_bulb(self, setting: ExposureSetting) -> bool:
        return setting.time_s > self._dials.time_s.control.maximum * (1 + 1e-6)

    def _release(self, request: ExposureRequest, *, may_wait: bool) -> PendingExposure | None:
        """Release; None if the camera needs its last picture to be fetched first."""
        # An exposure is pending until the camera has clearly refused it: after a time-out it may
        # have been taken, and must not be mistaken for the next one.
        self._pending, self._is_released = self._shooter.pending(request), False
        try:
            if self._is_bulb(request.setting):
                self._pending = self._hold(request)
            else:
                self._pending = self._shooter.release(request, may_wait=may_wait)
        except (CameraTimeoutError, CameraProtocolError):
            raise
        except CameraError:
            self._pending = None
            raise
        self._is_released = True
        return self._pending

    def _hold(self, request: ExposureRequest) -> PendingExposure:
        """Take a bulb exposure: open the shutter, wait, close it."""
        time_s = request.setting.time_s
        self._body.open_bulb(self._dials.time_s)
        pending = self._shooter.pending(request)
        try:
            self._clock.sleep_until(pending.ends_s)
        finally:
            self._body.close_bulb()
        held_s = self._clock.now() - pending.released_s
        if abs(held_s - time_s) > _MAX_BULB_ERROR_S:
            raise CameraTimeoutError(
                f"{self._name} kept its shutter open for {held_s:.2f} s instead of {time_s:g} s",
                hint="close other programs on this computer and resume",
            )
        return replace(pending, held_s=held_s)

    def _wait(self, pending: PendingExposure, format_name: str | None) -> Shot:
        try:
            shot = self._shooter.wait(pending, format_name)
        except (CameraTimeoutError, CameraProtocolError):
            raise  # the exposure stays pending: its file may still come
        except CameraError:
            self._pending = None
            raise
        self._pending = None
        return shot

    # ---- files

    def _fetch_waiting(self, known: KnownFormat, times: StillTimes) -> Iterator[Frame]:
        """Fetch the file that waits in the camera, if there is one, and yield its frame."""
        if self._waiting is not None:
            began_s = self._clock.now()
            frame = self._frame(self._waiting, known)
            times.add_download(self._clock.now() - began_s)
            self._fetched.append(self._waiting)
            self._waiting = None
            self._stale = 0
            yield frame

    def _delete_fetched(self) -> None:
        """Delete the files whose frames were taken, if requested; not while the shutter is open.

        A frame counts as taken when the caller asks for the next one.
        """
        while self._fetched:
            shot = self._fetched.pop()
            if self._delete:
                self._shooter.delete(shot)

    def _frame(self, shot: Shot, known: KnownFormat) -> Frame:
        """Fetch a file and return it as a frame."""
        busy_s, times_busy = NORMAL_S, self._body.session.times_busy
        if self._pending is not None:
            busy_s = max(busy_s, self._pending.busy_until_s - self._clock.now())
        data, took_s = self._shooter.fetch(shot, busy_s=busy_s)
        if self._pending is not None and self._body.session.times_busy > times_busy:
            # It sends nothing during an exposure: then a frame need not wait for the next one.
            self._overlaps = False
        fetched_s = self._clock.now()
        applied = shot.exposure.request.applied
        has_gain = self._dials.gain is not None
        speed = checked_exposure(shot.info.name, data, applied, has_gain=has_gain)
        still = read_still(data, shot.info.name)
        pixels, changes = matched_pixels(still, known, shot.info.name)
        exposure, request = shot.exposure, shot.exposure.request
        details = {
            "object": shot.info.name,
            "handle": f"{shot.handle:08X}",
            "bytes": len(data),
            "download_s": round(took_s, 6),
            "released_s": exposure.released_s,
            "fetched_s": fetched_s,
            **speed,
            **changes,
        }
        if shot.others:
            details["other_files"] = list(shot.others)
        if exposure.held_s is not None:
            details["bulb_held_s"] = round(exposure.held_s, 3)
        return Frame(
            pixels=pixels,
            requested=request.setting,
            applied=request.applied,
            timestamp_s=shot.ended_s,
            index=request.index,
            black=known.record.black,
            white=known.record.white,
            original=OriginalFile(PurePath(shot.info.name).suffix.lower(), data),
            details=details,
        )

    def _add_unfetched(self, error: CameraError) -> None:
        """Add to an error which pictures were taken and are still in the camera."""
        unfetched = [] if self._waiting is None else [self._waiting.name]
        if self._pending is not None:
            perhaps = "" if self._is_released else "perhaps "
            time_s = self._pending.request.setting.time_s
            unfetched.append(f"{perhaps}an exposure of {time_s:.6g} s")
        if unfetched:
            error.what = f"{error.what}; taken and not fetched: {' and '.join(unfetched)}"
            error.args = (f"{error.what}; {error.hint}" if error.hint else error.what,)
