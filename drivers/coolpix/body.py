"""A CoolPix 990 as it is at the other end of the line: prepared, exposing, and found again.

A picture exists on the card before it comes over the line, so that whatever breaks in between
costs time but no picture: `CoolpixBody.take` looks for it before it takes another.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

from camctl.clock import Clock
from camctl.controls import ExposureSetting
from camctl.errors import (
    CameraDisconnectedError,
    CameraError,
    CameraProtocolError,
    CameraTimeoutError,
)
from drivers.common.exif import exposure_time_s
from drivers.common.serial_link import SerialLink
from drivers.common.still_file import Still
from drivers.coolpix.pictures import (
    OnCard,
    Progress,
    download,
    follows,
    newest,
    wait_for_picture,
    why_no_picture,
)
from drivers.coolpix.settings import FORMATS, CoolpixDials, told
from drivers.coolpix.sierra.packets import (
    FIRST_SPEED,
    Action,
    RefusedCommandError,
    Register,
    SessionOverError,
)
from drivers.coolpix.sierra.session import Sierra

#: Seconds from the end of an exposure until the camera has written the picture to its card.
WRITING_S = 10.0
_ATTEMPTS = 2
# Files give times as the dial does: 1/60 s for 16,666 us, 1/1000 s for what may be 1/1024 s.
_LABEL_SLACK = 0.15


@dataclass(frozen=True, eq=False)
class Shot:
    """A picture that was taken and fetched.

    Attributes:
        name: on the card
        data: the file
        still: what it holds
        applied: the exposure read back before the shutter was released
        taken_s: when the camera said that it was done, on the clock, s
        found_again: True where it was taken before the line broke, and fetched afterwards
        left_on_card: name of a picture that was taken and not fetched, "" where there is none
    """

    name: str
    data: bytes
    still: Still
    applied: ExposureSetting
    taken_s: float
    found_again: bool
    left_on_card: str


@dataclass(frozen=True)
class _Pending:
    """A picture that was asked for and has not been fetched; `before` was the newest then."""

    wanted: ExposureSetting
    applied: ExposureSetting
    before: OnCard
    taken_s: float


class CoolpixBody:
    """The camera, in session.

    Args:
        url: the line, see `SerialLink`
        file_format: a name in `FORMATS`
        speed: the highest speed to use, baud
        timeout_s: see `Sierra`
        clock: what exposures are timed on
        progress: takes name, bytes and size while a picture comes

    Raises:
        UsageError, CameraNotFoundError, CameraBusyError, CameraTimeoutError: it cannot be opened
        CameraError: it is in a mode in which it cannot be used
    """

    def __init__(
        self,
        url: str,
        file_format: str,
        *,
        speed: int,
        timeout_s: float,
        clock: Clock,
        progress: Progress | None,
    ) -> None:
        self.url = url
        self._format = file_format
        self._clock = clock
        self._progress = progress
        self._pending: _Pending | None = None
        self._left = ""
        self._link = SerialLink(url, FIRST_SPEED)
        try:
            self.sierra = Sierra(self._link, speed=speed, timeout_s=timeout_s, clock=clock)
            self.sierra.open()
            self.dials = CoolpixDials(self.sierra, file_format)
        except BaseException:
            self._link.close()
            raise
        self._is_well = True

    def close(self) -> None:
        """Give the camera back as it was found; a second call does nothing."""
        if self._is_well:
            with suppress(CameraError):
                self.dials.restore()
                self.sierra.close()
        self._is_well = False
        self._link.close()

    def take(self, setting: ExposureSetting) -> Shot:
        """Take a picture, or find the one that was taken when the line broke, and fetch it.

        Args:
            setting: times and f-numbers as the dials have them

        Raises:
            RefusedSettingError: the camera applied another shutter time or aperture
            CameraError: it will not take pictures: no card, card full, battery low, lens
            CameraTimeoutError, CameraDisconnectedError, CameraProtocolError
        """
        try:
            self._come_back()
            picture = self._found_again(setting)
            is_found = picture is not None
            if picture is None:
                picture = self._release(setting)
            pending = self._pending
            assert pending is not None
            data, still = download(self.sierra, picture, self._progress)
            self._check_file(data, picture, pending.applied)
        except SessionOverError:
            raise
        except (CameraDisconnectedError, CameraTimeoutError) as error:
            self._is_well = False
            raise self._with_what_is_left(error) from error
        left, self._left, self._pending = self._left, "", None
        return Shot(picture.name, data, still, pending.applied, pending.taken_s, is_found, left)

    def fetch_newest(self) -> tuple[str, Still] | None:
        """Return name and contents of the newest picture, if of the format and size in force."""
        picture = newest(self.sierra)
        if not picture.name.upper().endswith(FORMATS[self._format].suffixes):
            return None
        try:
            summary = self.sierra.read(Register.PICTURE_SUMMARY, 256, picture=picture.number)
        except RefusedCommandError:
            return None
        resolution = told(self.sierra, Register.RESOLUTION)
        if len(summary) != 32 or int.from_bytes(summary[12:16], "little") != resolution:
            return None
        _, still = download(self.sierra, picture, self._progress)
        return picture.name, still

    # ---- before the exposure

    def _come_back(self) -> None:
        """Open the line again where it broke, and prepare a camera that has forgotten."""
        if not self._is_well:
            self._link.close()
            self._link = SerialLink(self.url, FIRST_SPEED)
            self.sierra.reopen(self._link)
            self._is_well = True
        self.dials.prepare()

    # ---- the exposure

    def _release(self, setting: ExposureSetting) -> OnCard:
        """Take one picture and return it; its exposure is certain."""
        trouble: CameraError = SessionOverError(
            f"the camera at {self.url} ends every session", hint="switch it off and on, then resume"
        )
        for _ in range(_ATTEMPTS):
            self.dials.prepare()
            before = newest(self.sierra)
            applied = self.dials.expose_for(setting)
            if not self.dials.are_prepared:
                continue  # a new session may have forgotten what was set a moment ago
            self._pending = _Pending(setting, applied, before, self._clock.now())
            refused = False
            try:
                self.sierra.act(Action.TAKE_PICTURE, wait_s=2 * setting.time_s + WRITING_S)
            except RefusedCommandError:
                refused = True
            except SessionOverError as error:
                trouble = error
            except CameraDisconnectedError:
                raise
            except (CameraTimeoutError, CameraProtocolError) as error:
                trouble = error
            else:
                trouble = CameraError("")
            self._pending = _Pending(setting, applied, before, self._clock.now())
            wait_s = 0.0 if refused else WRITING_S
            picture = wait_for_picture(self.sierra, before, self._clock, wait_s)
            if picture is not None:
                return picture
            self._pending = None
            if refused or not trouble.what:
                raise why_no_picture(self.sierra)
        raise trouble

    def _check_file(self, data: bytes, picture: OnCard, applied: ExposureSetting) -> None:
        if not data.startswith(FORMATS[self._format].magic):
            raise CameraProtocolError(
                f"the camera's file {picture.name} is not {self._format}",
                hint="choose the quality with the camera's own menu (HI is tiff)",
            )
        written_s = exposure_time_s(data)
        if written_s and abs(written_s / applied.time_s - 1) > _LABEL_SLACK:
            self._pending = None
            raise CameraProtocolError(
                f"the camera says in {picture.name} that it exposed for {written_s:.6g} s, "
                f"not for {applied.time_s:.6g} s",
                hint="turn its dial to M, and shoot again with times that it keeps",
            )

    # ---- after a break

    def _found_again(self, setting: ExposureSetting) -> OnCard | None:
        """Return the picture that is still to be fetched, if it is certainly the one wanted."""
        pending = self._pending
        if pending is None:
            return None
        last = newest(self.sierra)
        if pending.wanted == setting and follows(last, pending.before):
            return last
        if last != pending.before:
            self._left = last.name or f"picture {last.number}"
        self._pending = None
        return None

    def _with_what_is_left(self, error: CameraError) -> CameraError:
        if self._pending is None:
            return error
        return type(error)(
            f"{error.what}, and a picture of {self._pending.wanted.time_s:g} s may be on its card "
            "that was not fetched",
            hint=error.hint,
        )
