"""The Nikon CoolPix 990 on a serial line, as a `camctl.Camera`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, Literal

from pydantic import field_validator

from camctl.drivers.common.known_format import (
    KnownFormat,
    WrongFormatError,
    checked_exposure,
    matched_pixels,
    saved_format,
)
from camctl.drivers.common.still_camera import StillCamera, StillOptions
from camctl.drivers.coolpix.body import CoolpixBody, Shot
from camctl.drivers.coolpix.settings import FORMATS
from camctl.drivers.coolpix.sierra.packets import SPEEDS, RefusedCommandError, Register
from camctl.drivers.coolpix.sierra.session import Sierra
from camctl.findings import note
from camctl.interface.backends import LowerCase
from camctl.interface.camera import CameraInfo, Frame, OriginalFile
from camctl.interface.clock import CaptureTiming, Clock, RealClock
from camctl.interface.colour import BT709
from camctl.interface.controls import (
    Choices,
    Control,
    ExposureControls,
    ExposureSetting,
    Layout,
)

DRIVER = "coolpix"

_TOLERANCE = 1e-4  # the camera sets 1/60 s as 16,666 us
# Shutter time of a picture that is taken to learn the file format, s: short, with little blur.
_TEST_PICTURE_S = 1 / 60
_BITS_PER_BYTE = 10  # on the line, with start and stop bit


class CoolpixOptions(StillOptions):
    """Options of a CoolPix, besides `ResponseOptions`.

    Attributes:
        format: of the frames' files
        speed: the highest speed of the line to use, baud: 9600, 19200, 38400, 57600 or 115200
    """

    format: Annotated[Literal["jpeg", "tiff"], LowerCase] = "jpeg"
    speed: int = 115_200

    @field_validator("speed")
    @classmethod
    def _is_a_speed(cls, speed: int) -> int:
        if speed not in SPEEDS:
            raise ValueError(f"the camera has the speeds {', '.join(map(str, SPEEDS))} baud")
        return speed


class CoolpixCamera(StillCamera):
    """A CoolPix 990, or a camera with the same protocol, behind any pyserial URL.

    Exposures cannot overlap with transfers, since the line carries one thing at a time.  A frame's
    timestamp is when the camera reported the end of the exposure, slightly late.  The format of the
    frames is read from the camera's profile, from the newest picture on its card, or from a picture
    taken for this purpose when `controls` is first used.

    `open` raises `CameraNotFoundError` if there is no such port or no permission to use it,
    `CameraBusyError` if another process holds it, `CameraTimeoutError` if no camera answers, and
    `CameraError` if the camera is in an automatic mode, in which it accepts no shutter times.

    Args:
        url: a port such as /dev/ttyUSB0, or a URL such as socket://host:port
        options: see `CoolpixOptions`
        clock: of timestamps, and for all waiting
        timeout_s: time without a valid answer after which a call fails; exposures take longer
    """

    def __init__(
        self,
        url: str,
        options: CoolpixOptions | None = None,
        *,
        clock: Clock | None = None,
        timeout_s: float = 12.0,
    ) -> None:
        self._options = options or CoolpixOptions()
        super().__init__(f"the camera at {url}", clock or RealClock(), self._options)
        self._url = url
        self._timeout_s = timeout_s

    def _open(self) -> None:
        self._forget()
        self._body = CoolpixBody(
            self._url,
            self._options.format,
            speed=self._options.speed,
            timeout_s=self._timeout_s,
            clock=self._clock,
        )
        try:
            self._info = identity(self._body.sierra, self._url)
        except BaseException:
            self._body.close()
            raise

    def _close(self) -> None:
        self._body.close()

    def _make_controls(self) -> ExposureControls:
        made, record, speed = super()._make_controls(), self._known_format().record, self._speed
        size = FORMATS[self._options.format].typical_bytes
        if self._options.format == "tiff":
            size = record.rows * record.columns * (3 if record.layout is Layout.RGB else 1)
        transfer_s = size * _BITS_PER_BYTE / speed
        time = f"{transfer_s / 60:.2g} minutes" if transfer_s >= 60 else f"{transfer_s:.2g} s"
        notes = [
            f"a picture ({self._options.format}, about {size / 1e6:.2g} MB) takes {time} over the "
            f"line at {speed} baud, and the next exposure begins after that"
        ]
        if self._options.format == "jpeg":
            notes.append(
                "JPEG loses levels; the format tiff keeps them, but a picture takes minutes"
            )
        dials = self._body.dials
        if dials.apertures:
            numbers = ", ".join(f"f/{number:g}" for number in dials.apertures)
            notes.append(
                f"its apertures low, medium and high are assumed to be {numbers} (wide end of the "
                "zoom; 1.6 times as large at the long end), not measured"
            )
        return replace(
            made,
            timing=made.timing or CaptureTiming(download_s=transfer_s),
            tolerance=_TOLERANCE,
            colour=BT709 if record.layout is Layout.RGB else None,
            findings=(*map(note, (*notes, *dials.notes)), *made.findings),
        )

    @property
    def _speed(self) -> int:
        return self._body.sierra.link.speed

    def _dial_controls(self) -> tuple[Control, Control | None, Control | None]:
        apertures = self._body.dials.apertures
        return self._times, None, Choices(tuple(apertures)) if apertures else None

    @property
    def _times(self) -> Choices:
        return Choices(tuple(us / 1e6 for us in self._body.dials.times_us))

    def _frames(self, settings: tuple[ExposureSetting, ...]) -> Iterator[Frame]:
        known, times = self._known_format(), self._times_taken
        for index, setting in enumerate(settings):
            self._check_open()
            began_s = self._clock.now()
            with self._following_format(known):
                shot = self._take(_nearest(self.controls, setting))
                # Of the lens only the light at its wide end is known: its stop is not compared.
                applied = replace(shot.applied, f_number=None)
                details = checked_exposure(shot.name, shot.data, applied, has_gain=False)
                pixels, changes = matched_pixels(shot.still, known, shot.name)
            if not shot.was_pending:  # the line does not show when an exposure began
                rest_s = self._clock.now() - began_s - setting.time_s - shot.download_s
                times.add_exposure(rest_s, 0.0)
                times.add_download(shot.download_s)
            yield Frame(
                pixels=pixels,
                requested=setting,
                applied=shot.applied,
                timestamp_s=shot.taken_s,
                index=index,
                black=known.record.black,
                white=known.record.white,
                original=OriginalFile(FORMATS[known.format].suffixes[0].lower(), shot.data),
                details={"object": shot.name, **details, **changes},
            )
        self._save_times(overlaps=False)

    def _take(self, setting: ExposureSetting) -> Shot:
        """Take and download a picture of the requested format."""
        shot, name = self._body.take(setting), self._options.format
        if not shot.data.startswith(FORMATS[name].magic):
            raise WrongFormatError(
                f"the camera's file {shot.name} is not {name}",
                hint="choose the quality with the camera's own menu (HI is tiff)",
            )
        return shot

    def _find_format(self) -> KnownFormat:
        """Return the format from the profile, or from a picture, taken if there is none of it."""
        name = self._options.format
        known = saved_format(self.info, name)
        if known is not None:
            return known
        found = self._body.fetch_newest()
        if found is not None:
            picture, still = found
            self._notes.append(f"the format of its files was learnt from {picture} on its card")
        else:
            shot = self._take(ExposureSetting(self._times.nearest(_TEST_PICTURE_S)))
            still = shot.still
            self._notes.append(f"{shot.name} was taken to learn the format of its files")
        return self._learnt(name, still)


def identity(sierra: Sierra, url: str) -> CameraInfo:
    """Return the identity of the camera in a session, from its registers."""

    def text(register: Register) -> str:
        try:
            return sierra.text(register)
        except RefusedCommandError:
            return ""

    return CameraInfo(
        id=f"{DRIVER}:{url}",
        make=text(Register.MAKER) or "unknown",
        model=text(Register.MODEL) or "camera with the Sierra protocol",
        serial=text(Register.SERIAL_NUMBER),
        driver=DRIVER,
    )


def _nearest(controls: ExposureControls, setting: ExposureSetting) -> ExposureSetting:
    """Return the camera's exact values for a setting within the tolerance."""
    number = setting.f_number
    if number is not None and controls.f_number is not None:
        number = controls.f_number.nearest(number)
    return ExposureSetting(controls.time_s.nearest(setting.time_s), 1.0, number)
