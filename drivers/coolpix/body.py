"""A CoolPix 990 body: prepared, exposing, and found again after the line was disconnected.

A picture is on the card before it is transferred, so that a broken transfer costs time but no
picture: `CoolpixBody.take` looks for it before it takes another.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

from camctl.drivers.common.serial_link import SerialLink
from camctl.drivers.coolpix.pictures import (
    CardPicture,
    download,
    is_next,
    newest_picture,
    no_picture_error,
    wait_for_picture,
)
from camctl.drivers.coolpix.settings import FORMATS, CoolpixDials, read_register_or_none
from camctl.drivers.coolpix.sierra.packets import (
    FIRST_SPEED,
    Action,
    RefusedCommandError,
    Register,
    SessionOverError,
)
from camctl.drivers.coolpix.sierra.session import Sierra
from camctl.errors import (
    CameraDisconnectedError,
    CameraError,
    CameraProtocolError,
    CameraTimeoutError,
)
from camctl.interface.clock import Clock
from camctl.interface.controls import ExposureSetting
from camctl.stills.decoding import Still

# How long the camera may take to write a picture to its card.
_WRITING_S = 10.0
_SUMMARY_BYTES = 32


@dataclass(frozen=True, eq=False)
class Shot:
    """A picture that was taken and downloaded.

    Attributes:
        name: on the card
        data: the file
        still: its contents
        applied: the setting read back before the shutter was released
        taken_s: when the camera reported the end of the exposure, on the clock
        download_s: how long the file took to be transferred and decoded
        was_pending: True if it was taken before the line was disconnected, and downloaded after
    """

    name: str
    data: bytes
    still: Still
    applied: ExposureSetting
    taken_s: float
    download_s: float
    was_pending: bool


@dataclass(frozen=True)
class _Pending:
    """A picture that was requested and not downloaded; `before` was the newest one then."""

    requested: ExposureSetting
    applied: ExposureSetting
    before: CardPicture
    taken_s: float


class CoolpixBody:
    """A camera with an open session.

    Args:
        url: the line, see `SerialLink`
        file_format: a name in `camctl.drivers.coolpix.settings.FORMATS`
        speed: the highest speed to use, baud
        timeout_s: see `Sierra`
        clock: of timestamps, and for all waiting

    Raises:
        UsageError, CameraNotFoundError, CameraBusyError, CameraTimeoutError: it cannot be opened
        CameraError: it is in a mode that allows no remote control
    """

    def __init__(
        self,
        url: str,
        file_format: str,
        *,
        speed: int,
        timeout_s: float,
        clock: Clock,
    ) -> None:
        self._url = url
        self._format = file_format
        self._clock = clock
        self._pending: _Pending | None = None
        self._link = SerialLink(url, FIRST_SPEED)
        try:
            self.sierra = Sierra(self._link, clock, speed=speed, timeout_s=timeout_s)
            self.sierra.open()
            self.dials = CoolpixDials(self.sierra, file_format)
        except BaseException:
            self._link.close()
            raise
        self._is_connected = True

    def close(self) -> None:
        """Restore the camera's settings and close the line; a second call does nothing."""
        if self._is_connected:
            with suppress(CameraError):
                self.dials.restore()
                self.sierra.close()
        self._is_connected = False
        self._link.close()

    def take(self, setting: ExposureSetting) -> Shot:
        """Take and download a picture, or download the one taken when the line was disconnected.

        Args:
            setting: a time and an f-number that the dials have

        Raises:
            RefusedSettingError: the camera applied another shutter time or aperture
            CameraError: it takes no pictures: no card, card full, battery low, lens
            CameraTimeoutError, CameraDisconnectedError, CameraProtocolError
        """
        try:
            self._reconnect()
            picture = self._pending_picture(setting)
            was_pending = picture is not None
            if picture is None:
                picture = self._release(setting)
            pending = self._pending
            assert pending is not None
            began_s = self._clock.now()
            data, still = download(self.sierra, picture)
            download_s = self._clock.now() - began_s
        except SessionOverError:
            raise
        except (CameraDisconnectedError, CameraTimeoutError) as error:
            self._is_connected = False
            raise self._with_pending(error) from error
        self._pending = None
        return Shot(
            name=picture.label,
            data=data,
            still=still,
            applied=pending.applied,
            taken_s=pending.taken_s,
            download_s=download_s,
            was_pending=was_pending,
        )

    def fetch_newest(self) -> tuple[str, Still] | None:
        """Return name and contents of the newest picture; None if its format or size differs."""
        picture = newest_picture(self.sierra)
        if not picture.name.upper().endswith(FORMATS[self._format].suffixes):
            return None
        try:
            summary = self.sierra.read(Register.PICTURE_SUMMARY, 256, picture=picture.number)
        except RefusedCommandError:
            return None
        resolution = read_register_or_none(self.sierra, Register.RESOLUTION)
        if len(summary) != _SUMMARY_BYTES or int.from_bytes(summary[12:16], "little") != resolution:
            return None
        _, still = download(self.sierra, picture)
        return picture.name, still

    # ---- the exposure

    def _release(self, setting: ExposureSetting) -> CardPicture:
        """Take one picture and return it; its exposure is certain."""
        failure: CameraError | None = SessionOverError(
            f"the camera at {self._url} ends every session",
            hint="switch it off and on, then resume",
        )
        for _ in range(2):
            self.dials.prepare()
            before = newest_picture(self.sierra)
            applied = self.dials.set_exposure(setting)
            if not self.dials.are_prepared:
                continue  # a new session began, and may have lost the settings
            self._pending = _Pending(setting, applied, before, self._clock.now())
            is_refused = False
            try:
                self.sierra.act(Action.TAKE_PICTURE, wait_s=2 * setting.time_s + _WRITING_S)
                failure = None
            except RefusedCommandError:
                is_refused = True
            except (SessionOverError, CameraTimeoutError, CameraProtocolError) as error:
                failure = error
            self._pending = _Pending(setting, applied, before, self._clock.now())
            wait_s = 0.0 if is_refused else _WRITING_S
            picture = wait_for_picture(self.sierra, before, self._clock, wait_s)
            if picture is not None:
                return picture
            self._pending = None
            if is_refused or failure is None:
                raise no_picture_error(self.sierra)
        assert failure is not None
        raise failure

    # ---- after the line was disconnected

    def _reconnect(self) -> None:
        """Open the line again if it was disconnected, and prepare the camera again if necessary."""
        if not self._is_connected:
            self._link.close()
            self._link = SerialLink(self._url, FIRST_SPEED)
            self.sierra.reopen(self._link)
            self._is_connected = True
        self.dials.prepare()

    def _pending_picture(self, setting: ExposureSetting) -> CardPicture | None:
        """Return the picture that was not downloaded if it certainly has `setting`, else None."""
        pending = self._pending
        if pending is None:
            return None
        last = newest_picture(self.sierra)
        if pending.requested == setting and is_next(last, pending.before):
            return last
        self._pending = None
        return None

    def _with_pending(self, error: CameraError) -> CameraError:
        if self._pending is None:
            return error
        return type(error)(
            f"{error.what}, and a picture of {self._pending.requested.time_s:g} s that was not "
            "downloaded may be on its card",
            hint=error.hint,
            remedies=error.remedies,
        )
