"""A still camera that libgphoto2 controls, as a `camctl.Camera`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import PurePath
from typing import Annotated, Literal

from camctl.errors import CameraError, CameraProtocolError
from camctl.interface.backends import LowerCase
from camctl.interface.camera import CameraBase, CameraInfo, Frame, OriginalFile
from camctl.interface.clock import Clock, RealClock
from camctl.interface.controls import Choices, ExposureControls, ExposureSetting, ResponseOrigin
from camctl.model.response.camera import named_response
from camctl.stills.decoding import read_still
from drivers.common.known_format import (
    FORMATS,
    FormatChangedError,
    KnownFormat,
    WrongFormatError,
    checked_exposure,
    format_of_name,
    matched_pixels,
    saved_format,
)
from drivers.common.response_option import ResponseOptions
from drivers.common.still_camera import (
    StillTimes,
    save_record,
)
from drivers.gphoto2.body import Body
from drivers.gphoto2.process import CameraProcess, FullError

DRIVER = "gphoto2"
#: How long a picture may take beyond twice its exposure time, s: noise reduction takes the
#: exposure time again, and libgphoto2 itself waits for 1,000 s.
_CAPTURE_S = 1030.0
#: How long a busy camera is asked again to take or to send a picture, s.
_BUSY_S = 30.0
#: Quiet time after which a camera has reported all files of an exposure, ms.
_QUIET_MS, _LAST_CHANCE_MS = 50, 2000
#: Shutter time of a picture that is taken to learn the file format, s: short, with little blur.
_TEST_PICTURE_S = 0.01


class Gphoto2Options(ResponseOptions):
    """Options of a camera through libgphoto2, besides `ResponseOptions`.

    Attributes:
        format: of the frames' files; "auto": the best that the camera is set to save
        target: where the camera stores pictures until they are fetched: its memory (ram), which is
            faster and needs no card, or its card; "auto": its memory where it has that
        delete: True to delete files from the card once their frames were taken
    """

    format: Annotated[Literal["auto", "raw", "tiff", "jpeg"], LowerCase] = "auto"
    target: Annotated[Literal["auto", "ram", "card"], LowerCase] = "auto"
    delete: bool = False


@dataclass(frozen=True)
class _Picture:
    """A picture that was taken: its file, others of the same exposure, and when."""

    folder: str
    name: str
    others: tuple[str, ...]
    released_s: float
    ended_s: float


class Gphoto2Camera(CameraBase):
    """A still camera in a process of its own, through libgphoto2.

    Args:
        port: as libgphoto2 names it, such as usb:001,004, or ptpip:192.168.1.1
        options: see `Gphoto2Options`
        clock: of timestamps, and for pauses while the camera is busy

    Raises:
        CameraError: the package gphoto2 is missing, or the camera cannot be controlled
        CameraNotFoundError, CameraBusyError, CameraDisconnectedError, CameraTimeoutError
    """

    _body: Body
    _process: CameraProcess

    def __init__(
        self, port: str, options: Gphoto2Options | None = None, *, clock: Clock | None = None
    ) -> None:
        super().__init__(f"{DRIVER}:{port}", clock or RealClock())
        self._port = port
        self._options = options or Gphoto2Options()
        self._format_name = None if self._options.format == "auto" else self._options.format
        self._known: KnownFormat | None = None

    def _open(self) -> None:
        self._controls = self._known = None
        self._notes: list[str] = []
        self._fetched: list[_Picture] = []  # and not deleted
        with ExitStack() as undo:
            self._process = undo.enter_context(CameraProcess(self._name, self._clock))
            self._process.ask("open", port=self._port, busy_s=_BUSY_S)
            undo.callback(self._disconnect)
            self._body = body = Body(self._process, self._options.target)
            self._info = CameraInfo(
                self._name, body.make, body.model or "camera", body.serial, DRIVER
            )
            self._closing = undo.pop_all()

    def _disconnect(self) -> None:
        with suppress(CameraError):
            self._delete_fetched()
            self._process.ask("close")

    def _close(self) -> None:
        self._closing.close()

    @property
    def controls(self) -> ExposureControls:
        """The settings of the camera, and the format of its frames.

        The format is read from the camera's profile, or from a picture taken for this purpose when
        this property is first used.
        """
        if self._controls is None:
            self._check_open()
            self._controls = self._make_controls()
        return self._controls

    def _frames(self, settings: tuple[ExposureSetting, ...]) -> Iterator[Frame]:
        known, times = self._known_format(), self._times_taken
        for index, setting in enumerate(settings):
            began_s = self._clock.now()
            applied = self._body.apply(setting)
            settled_s = self._clock.now()
            picture = self._take(applied, known.format)
            times.add_exposure(
                settled_s - began_s, picture.ended_s - picture.released_s - applied.time_s
            )
            frame = self._fetch(picture, known, setting, applied)
            times.add_download(self._clock.now() - picture.ended_s)
            yield replace(frame, index=index)
            self._check_open()
        times.save(overlaps=False)
        self._controls = replace(self.controls, timing=times.timing)

    # ---- pictures

    def _take(self, setting: ExposureSetting, format_name: str | None) -> _Picture:
        """Take a picture; return its file of that format."""
        self._process.ask("added", timeout_ms=0)  # files of an exposure that was cancelled
        released_s = self._clock.now()
        first = self._capture(2 * setting.time_s + _CAPTURE_S)
        ended_s = self._clock.now()
        files = [tuple(first)]
        for wait_ms in (0, _QUIET_MS, _LAST_CHANCE_MS):
            chosen = self._chosen(files, format_name)
            if chosen is not None:
                break
            files += [tuple(each) for each in self._process.ask("added", timeout_ms=wait_ms)]
        else:
            chosen = self._chosen(files, format_name, is_last=True)
        names = tuple(name for _, name in files)
        if chosen is None:
            raise WrongFormatError(
                f"{self._name} saved {', '.join(names)} and no {format_name or 'known'} file",
                hint="set its image quality to that format, or give -O format=...",
            )
        others = tuple(name for name in names if name != chosen[1])
        return _Picture(chosen[0], chosen[1], others, released_s, ended_s)

    def _capture(self, silence_s: float) -> list[str]:
        """Take a picture; where there is no room for it, delete those that were fetched."""
        try:
            found = self._process.ask("capture", silence_s=silence_s, busy_s=_BUSY_S)
        except FullError:
            if not self._delete_fetched():
                raise
            found = self._process.ask("capture", silence_s=silence_s, busy_s=_BUSY_S)
        return [str(each) for each in found]

    def _chosen(
        self, files: list[tuple[str, ...]], format_name: str | None, *, is_last: bool = False
    ) -> tuple[str, ...] | None:
        """Return the file to fetch; None while a better one may come."""
        formats = {format_of_name(each[1]): each for each in reversed(files)}
        if format_name is not None:
            return formats.get(format_name)
        if self._body.makes_raw and "raw" not in formats and not is_last:
            return None
        return next((formats[name] for name in FORMATS if name in formats), None)

    def _fetch(
        self,
        picture: _Picture,
        known: KnownFormat,
        requested: ExposureSetting,
        applied: ExposureSetting,
    ) -> Frame:
        data = self._file(picture)
        try:
            has_gain = self._body.gain is not None
            speed = checked_exposure(picture.name, data, applied, has_gain=has_gain)
            still = read_still(data, picture.name)
            pixels, changes = matched_pixels(still, known, picture.name)
        except FormatChangedError as error:
            save_record(self.info, known.format, error.record)
            self._controls = self._known = None
            raise
        details = {
            "object": f"{picture.folder}/{picture.name}",
            "bytes": len(data),
            "released_s": picture.released_s,
            **({"other_files": list(picture.others)} if picture.others else {}),
            **speed,
            **changes,
        }
        return Frame(
            pixels=pixels,
            requested=requested,
            applied=applied,
            timestamp_s=picture.ended_s,
            index=0,
            black=known.record.black,
            white=known.record.white,
            original=OriginalFile(PurePath(picture.name).suffix.lower(), data),
            details=details,
        )

    def _file(self, picture: _Picture) -> bytes:
        data = self._process.ask("file", folder=picture.folder, name=picture.name, busy_s=_BUSY_S)
        self._fetched.append(picture)
        if not isinstance(data, bytes):
            raise CameraProtocolError(
                f"{self._name} sent an empty file {picture.name}", hint="shoot again"
            )
        return data

    def _delete_fetched(self) -> bool:
        """Delete the fetched files: from its memory always, from its card if requested.

        It takes libgphoto2 0.3 s a file, so it is done when the memory is full, and at the end.
        """
        fetched, self._fetched = self._fetched, []
        if not fetched or not (self._options.delete or self._body.target == "ram"):
            return False
        for picture in fetched:
            with suppress(CameraProtocolError):  # many cameras delete what is fetched themselves
                self._process.ask("delete", folder=picture.folder, name=picture.name)
        return True

    # ---- controls

    def _make_controls(self) -> ExposureControls:
        known, body = self._known_format(), self._body
        record, word = known.record, self._options.response
        response, origin = None, ResponseOrigin.STATED
        notes = [
            *body.notes,
            *self._notes,
            "shutter times are the true values of the labels on the camera's dial: exact stops of "
            "Canon and Fujifilm, else as labelled; compare the ratios measured in the report",
        ]
        if known.format != "raw":
            response = named_response(word, record.bits, record.white - record.black)
            origin = self._options.response_origin
        return ExposureControls(
            time_s=body.time_s.control,
            gain=body.gain.control if body.gain is not None else Choices((1.0,)),
            f_number=body.f_number.control if body.f_number is not None else None,
            shape=(record.rows, record.columns),
            layout=record.layout,
            bits=record.bits,
            black=record.black,
            white=record.white,
            response=response,
            response_origin=origin,
            timing=self._times_taken.timing,
            notes=tuple(notes),
        )

    def _known_format(self) -> KnownFormat:
        """Return the format from the profile, or from a test picture."""
        if self._known is None:
            self._known = saved_format(self.info, self._format_name) or self._format_of_picture()
            self._times_taken = StillTimes(self.info, self._known.format)
        return self._known

    def _format_of_picture(self) -> KnownFormat:
        body = self._body
        self._notes.append("one picture was taken to learn the format of the files")
        gain = body.gain.control.nearest(1.0) if body.gain is not None else 1.0
        setting = ExposureSetting(body.time_s.control.nearest(_TEST_PICTURE_S), gain)
        picture = self._take(body.apply(setting), self._format_name)
        name = format_of_name(picture.name)
        assert name is not None  # `_chosen` takes no other file
        still = read_still(self._file(picture), picture.name)
        problem = save_record(self.info, name, still.record)
        self._notes.extend((*still.notes, *((problem,) if problem else ())))
        return KnownFormat(name, still.record)
