"""What drivers of still cameras share: the format of their files, their times, their controls."""

from __future__ import annotations

from abc import abstractmethod
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from statistics import median
from typing import Annotated, Literal

from camctl.drivers.common.known_format import FormatChangedError, KnownFormat, WrongFormatError
from camctl.drivers.common.response_option import ResponseOptions
from camctl.errors import DataError, StorageError
from camctl.findings import note
from camctl.interface.backends import LowerCase
from camctl.interface.camera import CameraBase, CameraInfo
from camctl.interface.clock import CaptureTiming, Clock
from camctl.interface.colour import BT709
from camctl.interface.controls import Choices, Control, ExposureControls, Layout, ResponseOrigin
from camctl.model.response.camera import named_response
from camctl.profiles.profile import Profile, StillRecord, TimingRecord, change_profile, load_profile
from camctl.stills.decoding import Still

#: Shutter time of a picture that is taken to learn the file format, s: short, with little blur.
TEST_PICTURE_S = 0.01

#: Exposures and files whose median times are kept, and by which share of the whole these may
#: change until the profile is written again.
_MEASURED = 16
_SAME_TIME = 0.02


def save_record(info: CameraInfo, file_format: str, record: StillRecord) -> str | None:
    """Save what is known of a camera's files in its profile; return a note if that fails."""
    try:
        change_profile(info, lambda profile: profile.stills.update({file_format: record}))
    except (DataError, StorageError) as error:
        return f"the format of its files could not be saved in its profile: {error.what}"
    return None


def forget_record(info: CameraInfo, file_format: str) -> None:
    """Remove a format from what is known of a camera's files, if its profile can be changed."""

    def remove(profile: Profile) -> None:
        profile.stills.pop(file_format, None)

    with suppress(DataError, StorageError):
        change_profile(info, remove)


class StillTimes:
    """Measures what a still camera needs beside its exposures, and keeps it in its profile.

    Args:
        info: the camera
        file_format: of its frames
    """

    def __init__(self, info: CameraInfo, file_format: str) -> None:
        self._info, self._format = info, file_format
        self._exposures: deque[tuple[float, float]] = deque(maxlen=_MEASURED)
        self._downloads: deque[float] = deque(maxlen=_MEASURED)
        self._saved: TimingRecord | None = None
        with suppress(DataError):
            self._saved = load_profile(info).timings.get(file_format)

    @property
    def timing(self) -> CaptureTiming | None:
        """The times of the profile; None where none were measured."""
        return None if self._saved is None else self._saved.timing

    def add_exposure(self, settling_s: float, readout_s: float) -> None:
        """Add what one exposure took before it began, and after it ended."""
        self._exposures.append((max(settling_s, 0.0), max(readout_s, 0.0)))

    def add_download(self, download_s: float) -> None:
        """Add how long one file took to be transferred and decoded."""
        self._downloads.append(download_s)

    def save(self, *, overlaps: bool) -> None:
        """Keep the medians of what was added in the profile, where they differ from it."""
        if not (self._exposures and self._downloads):
            return
        settling_s, readout_s = (median(values) for values in zip(*self._exposures, strict=True))
        found = TimingRecord(
            settling_s=settling_s,
            readout_s=readout_s,
            download_s=median(self._downloads),
            overlaps=overlaps,
        )
        if self._saved is not None and _are_near(found, self._saved):
            return
        self._saved = found
        with suppress(DataError, StorageError):  # it is measured again with the next frames
            change_profile(
                self._info, lambda profile: profile.timings.update({self._format: found})
            )


def _are_near(a: TimingRecord, b: TimingRecord) -> bool:
    differences = (
        a.settling_s - b.settling_s,
        a.readout_s - b.readout_s,
        a.download_s - b.download_s,
    )
    whole = b.settling_s + b.readout_s + b.download_s
    return a.overlaps == b.overlaps and max(map(abs, differences)) <= _SAME_TIME * whole


class StillOptions(ResponseOptions):
    """Options of a still camera, besides `ResponseOptions`.

    Attributes:
        format: of the frames' files; "auto": the first of raw, tiff and jpeg that the camera saves
    """

    format: Annotated[Literal["auto", "raw", "tiff", "jpeg"], LowerCase] = "auto"


class StillCamera(CameraBase):
    """A still camera whose frames are files of one format, known from its profile or a picture.

    A driver calls `_forget` when it opens the camera, and implements `_find_format` and
    `_dial_controls`.

    Args:
        name, clock: see `CameraBase`
        options: see `StillOptions`
    """

    _times_taken: StillTimes

    def __init__(self, name: str, clock: Clock, options: StillOptions) -> None:
        super().__init__(name, clock)
        self._format_name = None if options.format == "auto" else options.format
        self._still_options = options
        self._forget()

    @abstractmethod
    def _find_format(self) -> KnownFormat:
        """Return the format of the frames; a picture may be taken for this purpose."""

    @abstractmethod
    def _dial_controls(self) -> tuple[Control, Control | None, Control | None]:
        """Return times, gains and f-numbers; None: the camera does not have them."""

    def _forget(self) -> None:
        """Forget the format and the notes of the camera."""
        self._known: KnownFormat | None = None
        self._controls = None
        self._notes: list[str] = []

    @property
    def controls(self) -> ExposureControls:
        """The settings of the camera, and the format of its frames.

        The format is read from the camera's profile, or from a picture that is on its card or taken
        for this purpose, when this property is first used.

        Raises:
            CameraError: that was not possible, or the camera is not open
        """
        if self._controls is None:
            self._check_open()
            self._controls = self._make_controls()
        return self._controls

    def _make_controls(self) -> ExposureControls:
        known = self._known_format()
        record, response, origin = known.record, None, ResponseOrigin.STATED
        if known.format != "raw":
            options = self._still_options
            response = named_response(options.response, record.bits, record.white - record.black)
            origin = options.response_origin
        times, gains, f_numbers = self._dial_controls()
        return ExposureControls(
            time_s=times,
            gain=gains or Choices((1.0,)),
            f_number=f_numbers,
            shape=(record.rows, record.columns),
            layout=record.layout,
            bits=record.bits,
            black=record.black,
            white=record.white,
            response=response,
            response_origin=origin,
            timing=self._times_taken.timing,
            # DCF: what a camera develops is sRGB. Raw files state their colours one by one.
            colour=BT709 if known.format == "jpeg" and record.layout is Layout.RGB else None,
            findings=tuple(map(note, self._notes)),
        )

    def _known_format(self) -> KnownFormat:
        if self._known is None:
            self._known = self._find_format()
            self._times_taken = StillTimes(self.info, self._known.format)
        return self._known

    def _learnt(self, file_format: str, still: Still) -> KnownFormat:
        """Return the format of a file, which is saved in the profile."""
        problem = save_record(self.info, file_format, still.record)
        self._notes.extend((*still.notes, *((problem,) if problem else ())))
        return KnownFormat(file_format, still.record)

    def _save_times(self, *, overlaps: bool) -> None:
        """Keep what the exposures and the files of a sequence took."""
        self._times_taken.save(overlaps=overlaps)
        self._controls = replace(self.controls, timing=self._times_taken.timing)

    @contextmanager
    def _following_format(self, known: KnownFormat) -> Iterator[None]:
        """Let the next sequence have the format in which the camera saves its files now."""
        try:
            yield
        except FormatChangedError as error:
            save_record(self.info, known.format, error.record)
            self._controls = self._known = None
            raise
        except WrongFormatError:
            if self._format_name is None:
                forget_record(self.info, known.format)
                self._controls = self._known = None
            raise
