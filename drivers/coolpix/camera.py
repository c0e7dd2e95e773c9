"""The Nikon CoolPix 990 on a serial line, as a camera: what it can set, and frames."""

from __future__ import annotations

from collections.abc import Generator, Sequence

from camctl.camera import CameraInfo, Closing, Frame, FrameStream, OriginalFile
from camctl.clock import Clock, RealClock
from camctl.controls import Choices, ExposureControls, ExposureSetting
from camctl.errors import CameraDisconnectedError, UsageError, unknown_name
from camctl.profile import StillRecord
from camctl.response.camera import named_response
from drivers.coolpix.body import CoolpixBody, Shot
from drivers.coolpix.discovery import describe
from drivers.coolpix.pictures import KnownFiles, Progress
from drivers.coolpix.settings import FORMATS
from drivers.coolpix.sierra.packets import SPEEDS

_MICRO = 1_000_000
_TOLERANCE = 1e-4  # 1/60 s is 16,666 us to the camera
_PROBE_S = 1 / 60
_OPTIONS = ("format", "response", "speed")


class CoolpixCamera(Closing):
    """A CoolPix 990 (or a sister with the same protocol) behind any pyserial URL.

    Exposures cannot overlap with transfers: the line carries one thing at a time.  A frame's
    timestamp is when the camera said that it was done, which is a little after the exposure ended.
    What its files are is taken from its profile, or from the newest picture on the card, or else
    from a picture that is taken for it when `controls` is first read.

    Args:
        url: a port such as /dev/ttyUSB0, or a URL such as socket://host:port
        format: jpeg or tiff
        speed: the highest speed to use, baud: 9600, 19200, 38400, 57600 or 115200
        response: of its files: linear, srgb, rec709 or power:GAMMA
        timeout_s: seconds of silence after which a call gives up; an exposure may take its time
        clock: the clock of its timestamps
        progress: takes name, bytes and size while a picture comes over the line

    Raises:
        UsageError: an unknown format, speed or response, or no such kind of URL
        CameraNotFoundError: no such port, or no permission to use it
        CameraBusyError: another process holds the port
        CameraTimeoutError: nobody answers at the other end
        CameraError: the camera takes no shutter times: it is in an automatic mode
    """

    def __init__(
        self,
        url: str,
        *,
        format: str = "jpeg",
        speed: int = 115_200,
        response: str = "srgb",
        timeout_s: float = 12.0,
        clock: Clock | None = None,
        progress: Progress | None = None,
    ) -> None:
        if format not in FORMATS:
            raise unknown_name("format of the CoolPix", format, FORMATS)
        # An impossible response is told now, not after the first picture.
        named_response(response, 8, 255)
        self._response_name = response
        self._format = format
        self._clock = clock or RealClock()
        self._body = CoolpixBody(
            url,
            format,
            speed=speed,
            timeout_s=timeout_s,
            clock=self._clock,
            progress=progress,
        )
        self._is_open = True
        try:
            self._info = describe(self._body.sierra, url)
            self._files = KnownFiles(self._info, format)
        except BaseException:
            self.close()
            raise

    @property
    def info(self) -> CameraInfo:
        """Who it is, from its own registers."""
        return self._info

    @property
    def clock(self) -> Clock:
        """The clock of its timestamps."""
        return self._clock

    @property
    def controls(self) -> ExposureControls:
        """What it can set; finding out what its files are may take a picture, and minutes."""
        record = self._files.record or self._learn()
        apertures = self._body.dials.apertures
        return ExposureControls(
            time_s=self._times,
            f_number=Choices(tuple(apertures)) if apertures else None,
            shape=(record.rows, record.columns),
            layout=record.layout,
            bits=record.bits,
            black=record.black,
            white=record.white,
            response=named_response(self._response_name, record.bits, record.white - record.black),
            tolerance=_TOLERANCE,
            notes=self._notes(),
        )

    def shoot(self, settings: Sequence[ExposureSetting]) -> FrameStream:
        """Take pictures one after the other; see `camctl.camera.Camera.shoot`."""
        self._check_open()
        controls = self.controls
        for setting in settings:
            controls.check(setting)
        return self._frames([(wanted, _nearest(controls, wanted)) for wanted in settings])

    def close(self) -> None:
        """Give the camera back as it was found, and let go of the port."""
        self._is_open = False
        self._body.close()

    def _check_open(self) -> None:
        if not self._is_open:
            raise CameraDisconnectedError(
                f"the camera at {self._body.url} is closed", hint="open it again"
            )

    def _frames(
        self, pairs: Sequence[tuple[ExposureSetting, ExposureSetting]]
    ) -> Generator[Frame, None, None]:
        for index, (wanted, exact) in enumerate(pairs):
            self._check_open()
            shot = self._body.take(exact)
            still = shot.still
            self._files.learn(still)
            yield Frame(
                pixels=still.pixels,
                requested=wanted,
                applied=shot.applied,
                timestamp_s=shot.taken_s,
                index=index,
                black=still.black,
                white=still.white,
                original=OriginalFile(_suffix(shot), shot.data),
                details=_details(shot),
            )

    def _learn(self) -> StillRecord:
        """Find out what its files are, by fetching one, and by taking one if there is none."""
        self._check_open()
        found = self._body.fetch_newest()
        if found is not None:
            name, still = found
            self._files.notes.append(f"what its files are was taken from {name} on its card")
        else:
            shot = self._body.take(ExposureSetting(self._times.nearest(_PROBE_S)))
            name, still = shot.name, shot.still
            self._files.notes.append(f"{name} was taken to see what its files are")
        return self._files.learn(still)

    @property
    def _times(self) -> Choices:
        return Choices(tuple(us / _MICRO for us in self._body.dials.times_us))

    def _notes(self) -> tuple[str, ...]:
        notes = [self._files.note_of_line(self._body.sierra.link.speed)]
        if self._format == "jpeg":
            notes.append(
                "JPEG loses levels; -O format=tiff keeps them, and takes minutes a picture"
            )
        if self._response_name == "srgb":
            notes.append(
                "the response of its files is assumed to be sRGB, not measured (-O response=... "
                "says another)"
            )
        if self._body.dials.apertures:
            numbers = ", ".join(f"f/{number:g}" for number in self._body.dials.apertures)
            notes.append(
                f"its apertures low, medium and high are assumed to be {numbers} (wide end of the "
                "zoom; 1.6 times as much at the long end), not measured"
            )
        return (*notes, *self._body.dials.steadied, *self._files.notes)


def _speed(text: str) -> int:
    known = {str(speed): speed for speed in SPEEDS}
    if text.strip() not in known:
        raise UsageError(f"a speed of '{text}'", hint=f"the camera knows {', '.join(known)} baud")
    return known[text.strip()]


def _nearest(controls: ExposureControls, wanted: ExposureSetting) -> ExposureSetting:
    """Return the exact values that stand for a setting within the tolerance."""
    number = wanted.f_number
    if number is not None and controls.f_number is not None:
        number = controls.f_number.nearest(number)
    return ExposureSetting(controls.time_s.nearest(wanted.time_s), 1.0, number)


def _suffix(shot: Shot) -> str:
    stem, dot, suffix = shot.name.rpartition(".")
    if stem and suffix.isalnum():
        return dot + suffix.lower()
    return ".tif" if shot.data[:2] in (b"II", b"MM") else ".jpg"


def _details(shot: Shot) -> dict[str, str | bool]:
    details: dict[str, str | bool] = {"name_on_card": shot.name}
    if shot.found_again:
        details["found_again"] = True
    if shot.left_on_card:
        details["left_on_card"] = shot.left_on_card
    return details
