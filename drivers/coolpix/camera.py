"""The Nikon CoolPix 990 on a serial line, as a `camctl.Camera`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import field_validator

from camctl.drivers.common.response_option import ResponseOptions
from camctl.drivers.common.still_camera import StillTimes
from camctl.drivers.coolpix.body import CoolpixBody, Shot
from camctl.drivers.coolpix.pictures import KnownFiles
from camctl.drivers.coolpix.sierra.packets import SPEEDS, RefusedCommandError, Register
from camctl.drivers.coolpix.sierra.session import Sierra
from camctl.findings import note
from camctl.interface.backends import LowerCase
from camctl.interface.camera import CameraBase, CameraInfo, Frame, OriginalFile
from camctl.interface.clock import CaptureTiming, Clock, RealClock
from camctl.interface.colour import BT709
from camctl.interface.controls import Choices, ExposureControls, ExposureSetting, Layout
from camctl.model.response.camera import named_response
from camctl.profiles.profile import StillRecord

DRIVER = "coolpix"
_TOLERANCE = 1e-4  # the camera sets 1/60 s as 16,666 us
# Shutter time of a picture that is taken to learn the file format, s: short, with little blur.
_TEST_PICTURE_S = 1 / 60


class CoolpixOptions(ResponseOptions):
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


class CoolpixCamera(CameraBase):
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
        super().__init__(f"the camera at {url}", clock if clock is not None else RealClock())
        self._url = url
        self._options = options if options is not None else CoolpixOptions()
        self._timeout_s = timeout_s

    def _open(self) -> None:
        self._body = CoolpixBody(
            self._url,
            self._options.format,
            speed=self._options.speed,
            timeout_s=self._timeout_s,
            clock=self._clock,
        )
        try:
            self._info = identity(self._body.sierra, self._url)
            self._files = KnownFiles(self._info, self._options.format)
            self._times_taken = StillTimes(self._info, self._options.format)
        except BaseException:
            self._body.close()
            raise

    def _close(self) -> None:
        self._body.close()

    @property
    def controls(self) -> ExposureControls:
        """The settings of the camera; the first use may take a picture, and minutes.

        Raises:
            CameraError: the format of the frames could not be learnt, or the camera is not open
        """
        self._check_open()
        record = self._files.record or self._learn_format()
        apertures = self._body.dials.apertures
        word = self._options.response
        return ExposureControls(
            time_s=self._times,
            f_number=Choices(tuple(apertures)) if apertures else None,
            shape=(record.rows, record.columns),
            layout=record.layout,
            bits=record.bits,
            black=record.black,
            white=record.white,
            response=named_response(word, record.bits, record.white - record.black),
            response_origin=self._options.response_origin,
            timing=self._times_taken.timing or self._line_timing(),
            tolerance=_TOLERANCE,
            colour=BT709 if record.layout is Layout.RGB else None,
            findings=tuple(map(note, self._notes())),
        )

    def _frames(self, settings: tuple[ExposureSetting, ...]) -> Iterator[Frame]:
        controls = self.controls
        for index, setting in enumerate(settings):
            self._check_open()
            shot = self._take(_nearest(controls, setting))
            still = shot.still
            self._files.update(still)
            yield Frame(
                pixels=still.pixels,
                requested=setting,
                applied=shot.applied,
                timestamp_s=shot.taken_s,
                index=index,
                black=still.black,
                white=still.white,
                original=OriginalFile(_suffix(shot), shot.data),
                details=_details(shot),
            )

    def _take(self, setting: ExposureSetting) -> Shot:
        """Take and download a picture, and keep what it took beside the exposure."""
        began_s = self._clock.now()
        shot = self._body.take(setting)
        rest_s = self._clock.now() - began_s - setting.time_s - shot.download_s
        if not shot.found_again:
            self._times_taken.add_exposure(rest_s, 0.0)  # the line does not show when it began
            self._times_taken.add_download(shot.download_s)
            self._times_taken.save(overlaps=False)
        return shot

    def _learn_format(self) -> StillRecord:
        """Learn the format of the frames from a picture, taken if there is none of this format."""
        found = self._body.fetch_newest()
        if found is not None:
            name, still = found
            self._files.notes.append(f"the format of its files was learnt from {name} on its card")
        else:
            shot = self._take(ExposureSetting(self._times.nearest(_TEST_PICTURE_S)))
            name, still = shot.name, shot.still
            self._files.notes.append(f"{name} was taken to learn the format of its files")
        return self._files.update(still)

    @property
    def _times(self) -> Choices:
        return Choices(tuple(us / 1e6 for us in self._body.dials.times_us))

    def _line_timing(self) -> CaptureTiming:
        """Return what follows from the speed of the line, until a picture was timed."""
        return CaptureTiming(download_s=self._files.transfer_s(self._body.sierra.link.speed))

    def _notes(self) -> tuple[str, ...]:
        notes = [self._files.transfer_note(self._body.sierra.link.speed)]
        if self._options.format == "jpeg":
            notes.append(
                "JPEG loses levels; the format tiff keeps them, but a picture takes minutes"
            )
        if self._body.dials.apertures:
            numbers = ", ".join(f"f/{number:g}" for number in self._body.dials.apertures)
            notes.append(
                f"its apertures low, medium and high are assumed to be {numbers} (wide end of the "
                "zoom; 1.6 times as large at the long end), not measured"
            )
        return (*notes, *self._body.dials.notes, *self._files.notes)


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


def _suffix(shot: Shot) -> str:
    stem, dot, suffix = shot.name.rpartition(".")
    if stem and suffix.isalnum():
        return dot + suffix.lower()
    return ".tif" if shot.data[:2] in (b"II", b"MM") else ".jpg"


def _details(shot: Shot) -> dict[str, str | bool]:
    details: dict[str, str | bool] = {"name_on_card": shot.name, **shot.still.details}
    if shot.found_again:
        details["found_again"] = True
    if shot.left_on_card:
        details["left_on_card"] = shot.left_on_card
    return details
