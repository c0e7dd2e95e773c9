"""A still camera that libgphoto2 controls, as a `camctl.Camera`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import PurePath
from typing import Annotated, Literal

from camctl.drivers.common.known_format import (
    FORMATS,
    KnownFormat,
    WrongFormatError,
    checked_exposure,
    format_of_name,
    matched_pixels,
    saved_format,
)
from camctl.drivers.common.still_camera import TEST_PICTURE_S, StillCamera, StillOptions
from camctl.drivers.gphoto2.body import Body
from camctl.drivers.gphoto2.process import CameraProcess, FullError, UnexplainedError
from camctl.errors import (
    CameraDisconnectedError,
    CameraError,
    CameraProtocolError,
    CameraTimeoutError,
)
from camctl.interface.backends import LowerCase
from camctl.interface.camera import CameraInfo, Frame, OriginalFile
from camctl.interface.clock import Clock, RealClock
from camctl.interface.controls import Control, ExposureSetting
from camctl.stills.decoding import read_still

DRIVER = "gphoto2"
#: How long a picture may take beyond twice its exposure time, s, since noise reduction takes the
#: exposure time again; and likewise one of a capture that was cancelled.
_CAPTURE_S, _CANCELLED_S = 100.0, 5.0
#: How long a busy camera is asked again to take or to send a picture, s.
_BUSY_S = 30.0
#: Quiet time after which a camera has reported all files of an exposure, ms.
_QUIET_MS, _LAST_CHANCE_MS = 50, 2000


class Gphoto2Options(StillOptions):
    """Options of a camera through libgphoto2, besides `StillOptions`.

    Attributes:
        delete: True to delete files from the card once their frames were taken
        target: where the camera stores pictures until they are fetched: its memory (ram), which is
            faster and needs no card, or its card; "auto": its memory where it has that
    """

    delete: bool = False
    target: Annotated[Literal["auto", "ram", "card"], LowerCase] = "auto"


@dataclass(frozen=True)
class _Picture:
    """A picture that was taken: its file, folder and name of others of its exposure, and when."""

    folder: str
    name: str
    others: tuple[tuple[str, ...], ...]
    released_s: float
    ended_s: float


class Gphoto2Camera(StillCamera):
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
        self._options = options or Gphoto2Options()
        super().__init__(f"{DRIVER}:{port}", clock or RealClock(), self._options)
        self._port = port

    def _open(self) -> None:
        self._forget()
        # Files that are not deleted: of raw and JPEG one is fetched.
        self._fetched: list[tuple[str, ...]] = []
        self._unfetched: list[tuple[str, ...]] = []
        with ExitStack() as undo:
            self._process = undo.enter_context(CameraProcess(self._name, self._clock))
            self._process.ask("open", port=self._port, busy_s=_BUSY_S)
            undo.callback(self._disconnect)
            self._body = body = Body(self._process, self._options.target)
            undo.callback(self._empty_memory)
            self._notes += [
                *body.notes,
                "shutter times are the true values of the labels on the camera's dial: exact "
                "stops of Canon and Fujifilm, else as labelled; compare the ratios measured in the "
                "report",
            ]
            self._info = CameraInfo(
                self._name, body.make, body.model or "camera", body.serial, DRIVER
            )
            self._closing = undo.pop_all()

    def _disconnect(self) -> None:
        with suppress(CameraError):
            self._process.ask("close")

    def _empty_memory(self) -> None:
        with suppress(CameraError):
            self._delete_fetched()

    def _close(self) -> None:
        self._closing.close()

    def _frames(self, settings: tuple[ExposureSetting, ...]) -> Iterator[Frame]:
        known, times = self._known_format(), self._times_taken
        for index, setting in enumerate(settings):
            began_s = self._clock.now()
            applied = self._body.apply(setting)
            settled_s = self._clock.now()
            with self._following_format(known):
                picture = self._take(applied, known.format)
                times.add_exposure(
                    settled_s - began_s, picture.ended_s - picture.released_s - applied.time_s
                )
                frame = self._fetch(picture, known, setting, applied, index)
            times.add_download(self._clock.now() - picture.ended_s)
            yield frame
            self._check_open()
        self._save_times(overlaps=False)

    # ---- pictures

    def _take(self, setting: ExposureSetting, format_name: str | None) -> _Picture:
        """Take a picture; return its file of that format."""
        self._note_unfetched()
        released_s = self._clock.now()
        first = self._capture(2 * setting.time_s)
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
                hint="set its image quality to that format, or name the format that it saves",
                remedies={"option:format": None},
            )
        others = tuple(each for each in files if each != chosen)
        return _Picture(chosen[0], chosen[1], others, released_s, ended_s)

    def _capture(self, longest_s: float) -> list[str]:
        """Take a picture; where there is no room for it, delete those that were fetched."""
        try:
            return self._release(longest_s)
        except FullError:
            if not self._delete_fetched():
                raise
            return self._release(longest_s)
        except (UnexplainedError, CameraTimeoutError, CameraDisconnectedError) as error:
            reason = self._body.why_no_picture(is_silent=not isinstance(error, UnexplainedError))
            if reason is None:
                raise
            raise type(error)(f"{error.what}: {reason[0]}", hint=reason[1]) from error

    def _release(self, longest_s: float) -> list[str]:
        """Take a picture, which lasts so long at most if all is well; return its first file."""
        found = self._process.ask(
            "capture",
            silence_s=longest_s + _CAPTURE_S,
            cancelled_s=longest_s + _CANCELLED_S,
            busy_s=_BUSY_S,
        )
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
        index: int,
    ) -> Frame:
        data = self._file(picture)
        has_gain = self._body.gain is not None
        speed = checked_exposure(picture.name, data, applied, has_gain=has_gain)
        pixels, changes = matched_pixels(read_still(data, picture.name), known, picture.name)
        details = {
            "object": f"{picture.folder}/{picture.name}",
            "bytes": len(data),
            "released_s": picture.released_s,
            **({"other_files": [name for _, name in picture.others]} if picture.others else {}),
            **speed,
            **changes,
        }
        return Frame(
            pixels=pixels,
            requested=requested,
            applied=applied,
            timestamp_s=picture.ended_s,
            index=index,
            black=known.record.black,
            white=known.record.white,
            original=OriginalFile(PurePath(picture.name).suffix.lower(), data),
            details=details,
        )

    def _file(self, picture: _Picture) -> bytes:
        data = self._process.ask("file", folder=picture.folder, name=picture.name, busy_s=_BUSY_S)
        self._fetched.append((picture.folder, picture.name))
        self._keep_unfetched(picture.others)
        if not isinstance(data, bytes):
            raise CameraProtocolError(
                f"{self._name} sent an empty file {picture.name}", hint="shoot again"
            )
        return data

    def _delete_fetched(self) -> bool:
        """Delete the fetched files: from its memory always, from its card if requested.

        From its memory go the other files of the same exposures, too, which would fill it.  It
        takes libgphoto2 0.3 s a file, so it is done when the memory is full, and at the end.
        """
        files, self._fetched = self._fetched, []
        if self._body.target == "ram":
            self._note_unfetched()
            files += self._unfetched
            self._unfetched = []
        elif not self._options.delete:
            return False
        for folder, name in files:
            with suppress(CameraProtocolError):  # many cameras delete what is fetched themselves
                self._process.ask("delete", folder=folder, name=name)
        return bool(files)

    def _note_unfetched(self) -> None:
        """Keep which files came late: beside those that were fetched, or of what was cancelled."""
        self._keep_unfetched(map(tuple, self._process.ask("added", timeout_ms=0)))

    def _keep_unfetched(self, files: Iterable[tuple[str, ...]]) -> None:
        if self._body.target == "ram":  # on a card they may stay
            self._unfetched += files

    # ---- controls

    def _dial_controls(self) -> tuple[Control, Control | None, Control | None]:
        body = self._body
        return (
            body.time_s.control,
            body.gain.control if body.gain is not None else None,
            body.f_number.control if body.f_number is not None else None,
        )

    def _find_format(self) -> KnownFormat:
        """Return the format from the profile, or from a test picture."""
        known, body = saved_format(self.info, self._format_name), self._body
        if known is not None:
            return known
        self._notes.append("one picture was taken to learn the format of the files")
        gain = body.gain.control.nearest(1.0) if body.gain is not None else 1.0
        setting = ExposureSetting(body.time_s.control.nearest(TEST_PICTURE_S), gain)
        picture = self._take(body.apply(setting), self._format_name)
        name = format_of_name(picture.name)
        assert name is not None  # `_chosen` takes no other file
        return self._learnt(name, read_still(self._file(picture), picture.name))
