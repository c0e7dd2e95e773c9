"""A list of exposures on one body: set, released, fetched while the next one runs.

The order for each exposure: dials turned and read back, shutter released, the file of the exposure
before fetched and handed over, then waited for the end of this one.  A camera that answers "busy"
to a release while a picture waits in it gets its pictures fetched first from then on.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePath

from camctl.camera import Frame, OriginalFile
from camctl.clock import Clock
from camctl.controls import ExposureSetting
from camctl.errors import CameraError, CameraProtocolError, CameraTimeoutError
from drivers.common.exif import exposure_time_s
from drivers.common.still_file import read_still
from drivers.ptp.body import Body
from drivers.ptp.dials import Dial
from drivers.ptp.shooting import PendingExposure, Shooter, Shot
from drivers.ptp.still_formats import KnownFormat, pixels_of
from drivers.ptp.transport import NORMAL_S

# Labels and true times of one setting differ by up to 10 %, neighbouring settings by 26 %.
_SAME_TIME = 1.2
_LATE_S = 0.25  # that a bulb exposure may be off before it is no longer what was asked for


@dataclass(frozen=True)
class Dials:
    """What sets the exposure; None where the camera has no such dial."""

    time_s: Dial
    gain: Dial | None
    f_number: Dial | None


class ExposureSequence:
    """What is under way between a body and the frames it gives.

    Args:
        body: the camera
        shooter: releases and finds files
        dials: its dials
        who: how errors call it
        clock: of timestamps
        delete: delete files from the card once they have been fetched
    """

    def __init__(
        self, body: Body, shooter: Shooter, dials: Dials, who: str, clock: Clock, *, delete: bool
    ) -> None:
        self._body, self._shooter, self._dials = body, shooter, dials
        self._who, self._clock, self._delete = who, clock, delete
        self._flight: PendingExposure | None = None
        self._overlaps = True

    def run(
        self, settings: Sequence[ExposureSetting], known: KnownFormat
    ) -> Generator[Frame, None, None]:
        """Yield a frame for each setting; `known` is what its file must be.

        Raises:
            CameraError: as `camctl.camera.Camera.shoot`; it names what was shot and not fetched
        """
        waiting: Shot | None = None
        handed_over: list[Shot] = []
        if settings:
            self.settle()
            self._shooter.begin()
        try:
            for index, setting in enumerate(settings):
                # Holding the shutter of a bulb exposure leaves no time for anything else.
                in_turn = not self._overlaps or self._is_bulb(setting)
                if waiting is not None and in_turn:
                    frame = self._frame(waiting, known)
                    handed_over.append(waiting)
                    waiting = None
                    yield frame
                applied = self._apply(setting)
                flight = self._release(setting, applied, index, patient=waiting is None)
                if flight is None and waiting is not None:
                    self._overlaps = False
                    frame = self._frame(waiting, known)
                    handed_over.append(waiting)
                    waiting = None
                    yield frame
                    flight = self._release(setting, applied, index, patient=True)
                assert flight is not None
                if waiting is not None:
                    frame = self._frame(waiting, known)
                    handed_over.append(waiting)
                    waiting = None
                    yield frame
                waiting = self._wait(flight, known.format)
                self._clear(handed_over)
            if waiting is not None:
                frame = self._frame(waiting, known)
                handed_over.append(waiting)
                waiting = None
                yield frame
                self._clear(handed_over)
        except CameraError as error:
            self._say_what_is_left(error, waiting)
            raise

    def take(self, setting: ExposureSetting, wanted: str | None) -> Shot:
        """Take one picture and return its file; `wanted` as `Shooter.wait` has it."""
        self._shooter.begin()
        flight = self._release(setting, self._apply(setting), 0, patient=True)
        assert flight is not None
        return self._wait(flight, wanted)

    def _wait(self, flight: PendingExposure, wanted: str | None) -> Shot:
        try:
            shot = self._shooter.wait(flight, wanted)
        except (CameraTimeoutError, CameraProtocolError):
            raise  # it may still come
        except CameraError:
            self._flight = None
            raise
        self._flight = None
        return shot

    def settle(self, limit_s: float = NORMAL_S) -> None:
        """Wait until an exposure that was given up has ended, `limit_s` beyond it at most."""
        flight, self._flight = self._flight, None
        if flight is not None:
            self._shooter.settle(flight, limit_s)

    def _clear(self, handed_over: list[Shot]) -> None:
        """Delete what the consumer has taken, where that is wanted; not while the shutter is open.

        A frame counts as taken when the next one is asked for.
        """
        while handed_over:
            shot = handed_over.pop()
            if self._delete:
                self._shooter.delete(shot)

    def _apply(self, setting: ExposureSetting) -> ExposureSetting:
        """Turn the dials; return what the camera says they show."""
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

    def _release(
        self, setting: ExposureSetting, applied: ExposureSetting, index: int, *, patient: bool
    ) -> PendingExposure | None:
        """Release; None where the camera wants the last picture to be fetched first."""
        # Until the camera has said clearly that it took no picture, it may have taken one, which
        # must not be mistaken for the next.
        now_s = time.monotonic()
        self._flight = self._shooter.flight(setting, applied, index, self._clock.now(), now_s)
        try:
            if self._is_bulb(setting):
                self._flight = self._hold(setting, applied, index)
            else:
                self._flight = self._shooter.release(setting, applied, index, patient=patient)
        except (CameraTimeoutError, CameraProtocolError):
            raise
        except CameraError:
            self._flight = None
            raise
        return self._flight

    def _hold(
        self, setting: ExposureSetting, applied: ExposureSetting, index: int
    ) -> PendingExposure:
        body = self._body
        released_s = self._clock.now()
        body.open_bulb(self._dials.time_s)
        began_s = time.monotonic()
        flight = self._shooter.flight(setting, applied, index, released_s, began_s)
        try:
            time.sleep(max(0.0, began_s + setting.time_s - time.monotonic()))
        finally:
            body.close_bulb()
        held_s = time.monotonic() - began_s
        if abs(held_s - setting.time_s) > _LATE_S:
            raise CameraTimeoutError(
                f"{self._who} kept its shutter open for {held_s:.2f} s instead of "
                f"{setting.time_s:g} s",
                hint="take load off this computer and resume",
            )
        return replace(flight, held_s=held_s)

    def _frame(self, shot: Shot, known: KnownFormat) -> Frame:
        """Fetch a file and return it as a frame."""
        busy_s = NORMAL_S + (self._flight.left_s if self._flight is not None else 0.0)
        refusals = self._body.session.times_busy
        data, took_s = self._shooter.fetch(shot, busy_s=busy_s)
        if self._flight is not None and self._body.session.times_busy > refusals:
            # It serves nothing while it exposes: then a frame need not wait for the next exposure.
            self._overlaps = False
        fetched_s = self._clock.now()
        self._check_exposure(shot, data)
        still = read_still(data, shot.info.name)
        pixels, changed = pixels_of(still, known, shot.info.name)
        flight = shot.flight
        details = {
            "object": shot.info.name,
            "handle": f"{shot.handle:08X}",
            "bytes": len(data),
            "download_s": round(took_s, 6),
            "released_s": flight.released_s,
            "fetched_s": fetched_s,
            **changed,
        }
        if shot.others:
            details["other_files"] = list(shot.others)
        if flight.held_s is not None:
            details["bulb_held_s"] = round(flight.held_s, 3)
        return Frame(
            pixels=pixels,
            requested=flight.setting,
            applied=flight.applied,
            timestamp_s=shot.ended_s,
            index=flight.index,
            black=known.record.black,
            white=known.record.white,
            original=OriginalFile(PurePath(shot.info.name).suffix.lower(), data),
            details=details,
        )

    def _check_exposure(self, shot: Shot, data: bytes) -> None:
        """Raise `CameraProtocolError` where the file itself says that it is of another exposure."""
        said_s, time_s = exposure_time_s(data), shot.flight.applied.time_s
        if said_s is not None and not 1 / _SAME_TIME < said_s / time_s < _SAME_TIME:
            raise CameraProtocolError(
                f"{shot.info.name} was exposed for {said_s:.6g} s by its own word, {time_s:.6g} s "
                "were set",
                hint="shoot it again; leave the camera's own buttons alone meanwhile",
            )

    def _say_what_is_left(self, error: CameraError, waiting: Shot | None) -> None:
        """Add to an error which pictures were taken and are still in the camera."""
        left = [] if waiting is None else [waiting.name]
        if self._flight is not None:
            left.append(f"an exposure of {self._flight.setting.time_s:.6g} s")
        if left:
            error.what = f"{error.what}; taken and not fetched: {' and '.join(left)}"
            error.args = (f"{error.what}; {error.hint}" if error.hint else error.what,)
