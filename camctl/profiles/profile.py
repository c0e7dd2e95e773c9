"""Camera profiles: measurements of one camera that are kept between sessions.

`camctl.profiles.calibrated` applies them to an open camera, `camctl.profiles.folder` lists them.

A profile is one JSON file in $CAMCTL_PROFILES, or else in ``profiles`` of the user's data folder.
It belongs to a driver, make, model and serial number, and not to an id: a camera keeps its profile
on another USB port.  Cameras of one model without serial numbers share a profile.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import unicodedata
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar

from platformdirs import user_data_dir
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    StringConstraints,
    ValidationError,
    model_validator,
)

from camctl.errors import DataError, StorageError
from camctl.interface.camera import CameraInfo, MeasuredDelay
from camctl.interface.clock import CaptureTiming
from camctl.interface.controls import Layout
from camctl.profiles.colour import ColourRecord
from camctl.profiles.exposures import ExposureRecord
from camctl.profiles.noise import NoiseRecord
from camctl.profiles.record import Record
from camctl.profiles.response import ResponseRecord
from camctl.system.files import file_lock, make_folder, storage_error, write_bytes
from camctl.system.input_files import first_problem, read_input

FORMAT_VERSION: Literal[1] = 1
"""Version of the file format; readers accept this one only."""

SUFFIX = ".json"
#: Largest file of a profile: the responses of a hundred modes.
_MOST_BYTES = 8 << 20
#: Modes that a camera may have, and frames that a control delay may last.
_MOST_MODES, _MOST_DELAY = 1000, 1000
#: Longest time that a still camera may need beside an exposure, s.
_LONGEST_S = 3600.0
#: Characters of a profile's name before its hash; file names have 255 at most.
_LONGEST_STEM = 80
READ_HINT = "make it readable, or set $CAMCTL_PROFILES to another folder"
_REPAIR = "remove the profile, and calibrate again"
_STORAGE_HINT = "check the disk, or set $CAMCTL_PROFILES to another folder"


_Text = Annotated[str, StringConstraints(max_length=1000)]


class FrameTiming(Record):
    """When the frames of a camera come.

    Attributes:
        frame_interval_s: from one frame of a stream to the next; on a still camera from one picture
            to the next beside the exposure
        jitter_s: standard deviation of that time
        readout_s: from the end of an exposure until its frame is here, or on the camera's card
        download_s: still cameras: transfer and decoding of a file
        lost: frames of the stream that did not come while it was measured
    """

    frame_interval_s: float = Field(ge=0, le=_LONGEST_S, allow_inf_nan=False)
    jitter_s: float = Field(ge=0, le=_LONGEST_S, allow_inf_nan=False)
    readout_s: float = Field(ge=0, le=_LONGEST_S, allow_inf_nan=False)
    download_s: float = Field(ge=0, le=_LONGEST_S, allow_inf_nan=False)
    lost: int = Field(ge=0)


class DelayRecord(Record):
    """The measured control delay of a camera in one mode.

    Attributes:
        frames: the delay in frames, counted as in `camctl.StreamingCamera.step`; None where
            it is not constant
        smallest: the smallest delay of all trials, frames; -1 where a setting acts on the frame
            that is being exposed
        largest: the largest delay of all trials, frames
        time: (smallest, largest) of the trials in which the shutter time changed; None: none
            were made
        gain: the same of the gain
        trials: number of measurements
        measured_at: date and time, ISO 8601
        timing: of the stream; None where it was not measured
    """

    frames: int | None
    smallest: int = Field(ge=-1, le=_MOST_DELAY)
    largest: int = Field(ge=-1, le=_MOST_DELAY)
    time: tuple[int, int] | None = None
    gain: tuple[int, int] | None = None
    trials: int = Field(ge=1, le=1_000_000)
    measured_at: str
    timing: FrameTiming | None = None

    @model_validator(mode="after")
    def _agree(self) -> Self:
        constant = self.smallest if self.smallest == self.largest else None
        if self.smallest > self.largest or self.frames != constant:
            raise ValueError("frames, smallest and largest contradict each other")
        for low, high in filter(None, (self.time, self.gain)):
            if not self.smallest <= low <= high <= self.largest:
                raise ValueError("the delay of a control is beyond smallest and largest")
        return self

    @property
    def bounds(self) -> MeasuredDelay:
        """The bounds of the delay, for a camera's stream."""
        readout_s = self.timing.readout_s if self.timing else 0.0
        return MeasuredDelay(self.smallest, self.largest, self.time, self.gain, readout_s)


class StillRecord(Record):
    """Pixel format of the files that a still camera makes in one format.

    Attributes:
        rows: of a frame
        columns: of a frame
        layout: pixel layout
        bits: per sample
        black: brightness without light, DN
        white: brightness from which samples are saturated, DN
    """

    rows: int = Field(ge=1, le=1 << 20)
    columns: int = Field(ge=1, le=1 << 20)
    layout: Layout
    bits: int = Field(ge=1, le=16)
    black: int = Field(ge=0)
    white: int = Field(ge=1)

    @model_validator(mode="after")
    def _agree(self) -> Self:
        if not self.black < self.white < 2**self.bits:
            raise ValueError("expected black < white < 2^bits")
        return self


class TimingRecord(Record):
    """What a still camera needs beside its exposures; see `camctl.CaptureTiming`.

    Attributes:
        settling_s: before each exposure, to make its settings and to release the shutter
        readout_s: from the end of an exposure until its file is on the card
        download_s: transfer and decoding of a file
        overlaps: a file is downloaded during the next exposure
    """

    settling_s: float = Field(ge=0, le=_LONGEST_S, allow_inf_nan=False)
    readout_s: float = Field(ge=0, le=_LONGEST_S, allow_inf_nan=False)
    download_s: float = Field(ge=0, le=_LONGEST_S, allow_inf_nan=False)
    overlaps: bool

    @property
    def timing(self) -> CaptureTiming:
        """The same for `ExposureControls.timing`."""
        return CaptureTiming(**self.model_dump())


_RecordT = TypeVar("_RecordT")
_ByMode = Annotated[dict[_Text, _RecordT], Field(max_length=_MOST_MODES)]


class Profile(BaseModel):
    """Measurements of one camera.

    Attributes:
        version: of this format
        driver: driver of the camera, as in `camctl.CameraInfo`
        make: maker of the camera
        model: model of the camera
        serial: serial number of the camera
        delays: control delays by mode (see `camctl.StreamingCamera.mode`)
        stills: pixel formats of its files by file format
        exposures: true exposures by mode (see `camctl.profiles.exposures.exposure_mode`)
        timings: what it needs beside its exposures, by file format
        responses: measured responses by mode, as `exposures`
        noises: measured noise by mode, as `exposures`
        colours: measured colours by mode, as `exposures`
    """

    model_config = ConfigDict(extra="forbid")

    version: Literal[1] = FORMAT_VERSION
    driver: _Text
    make: _Text
    model: _Text
    serial: _Text
    delays: _ByMode[DelayRecord] = {}
    stills: _ByMode[StillRecord] = {}
    exposures: _ByMode[ExposureRecord] = {}
    timings: _ByMode[TimingRecord] = {}
    responses: _ByMode[ResponseRecord] = {}
    noises: _ByMode[NoiseRecord] = {}
    colours: _ByMode[ColourRecord] = {}

    @classmethod
    def of(cls, info: CameraInfo) -> Self:
        """Return an empty profile of a camera."""
        # A device may send any text; a lone surrogate in it cannot be written to a file.
        driver, make, model, serial = (
            text.encode("utf-8", "replace").decode()
            for text in (info.driver, info.make, info.model, info.serial)
        )
        return cls(driver=driver, make=make, model=model, serial=serial)

    @property
    def name(self) -> str:
        """The name of its file without suffix: readable, and unique for each camera."""
        identity = (self.driver, self.make, self.model, self.serial)
        text = unicodedata.normalize("NFKD", "-".join(identity)).encode("ascii", "ignore").decode()
        stem = re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")[:_LONGEST_STEM].rstrip("-")
        return f"{stem}-{hashlib.sha256(json.dumps(identity).encode()).hexdigest()[:8]}"

    def add_noise(self, mode: str, record: NoiseRecord) -> None:
        """Keep the noise in a mode, with what an earlier record has and this one lacks."""
        earlier = self.noises.get(mode)
        self.noises[mode] = record if earlier is None else record.joined(earlier)

    def add_exposures(self, mode: str, record: ExposureRecord) -> None:
        """Keep the exposures in a mode, with settings that an earlier record alone has."""
        earlier = self.exposures.get(mode)
        self.exposures[mode] = record if earlier is None else record.joined(earlier)


def profile_directory() -> Path:
    """Return the folder of the profiles, which need not exist."""
    named = os.environ.get("CAMCTL_PROFILES")
    return Path(named) if named else Path(user_data_dir("camctl")) / "profiles"


_is_ignored: ContextVar[bool] = ContextVar("profiles are ignored", default=False)


@contextmanager
def ignored_profiles() -> Iterator[None]:
    """Let `load_profile` return empty profiles while the block runs."""
    token = _is_ignored.set(True)
    try:
        yield
    finally:
        _is_ignored.reset(token)


def load_profile(info: CameraInfo) -> Profile:
    """Return the profile of a camera; an empty one where there is none.

    Raises:
        DataError: its file is damaged, cannot be read, or belongs to another camera
    """
    return Profile.of(info) if _is_ignored.get() else _load(info)


def _load(info: CameraInfo) -> Profile:
    empty = Profile.of(info)
    path = profile_path(empty.name)
    found = read_profile(path)
    if found is None:
        return empty
    if found.name != empty.name:
        raise DataError(
            f"{path} is the profile of another camera",
            hint=_REPAIR,
            remedies={"profile_remove": path.stem},
        )
    return found


def save_profile(profile: Profile) -> Path:
    """Write a profile, atomically, in place of the earlier one; return its file.

    To read, change and save a profile use `change_profile`: without its lock, changes that another
    process makes at the same time would be lost.

    Raises:
        StorageError: it could not be written
    """
    path = profile_path(profile.name)
    with profile_storage_errors(path):
        make_folder(path.parent)
        write_bytes(path, profile.model_dump_json(indent=2).encode() + b"\n")
    return path


def change_profile(info: CameraInfo, change: Callable[[Profile], None]) -> Path:
    """Call `change` with the profile of a camera, and save it; return its file.

    A lock keeps other processes and threads from changing profiles meanwhile.

    Raises:
        DataError: the earlier profile cannot be used
        StorageError: the new one could not be written
    """
    folder = profile_directory()
    with profile_storage_errors(folder):
        make_folder(folder)
        with file_lock(folder / ".lock"):
            profile = _load(info)
            change(profile)
            return save_profile(profile)


def profile_path(name: str) -> Path:
    """Return the file of the profile of that name."""
    return profile_directory() / f"{name}{SUFFIX}"


def read_profile(path: Path) -> Profile | None:
    """Return the profile in a file; None where there is no file."""
    try:
        return parse_profile(path, hint=READ_HINT, repair=_REPAIR)
    except DataError as error:
        if isinstance(error.__cause__, FileNotFoundError | NotADirectoryError):
            return None
        error.remedies = {"profile_remove": path.stem}
        raise


def parse_profile(path: Path, *, hint: str, repair: str) -> Profile:
    """Return the profile in a file.

    Args:
        path: of the file
        hint: what to do where the file cannot be read
        repair: what to do where it holds no profile
    """
    data = read_input(path, "", hint=hint, most_bytes=_MOST_BYTES)
    try:
        version = _Header.model_validate_json(data).version
        if version != FORMAT_VERSION:
            raise DataError(
                f"{path} is a profile of version {str(version)[:20]!r}, and this camctl reads "
                f"version {FORMAT_VERSION}",
                hint=f"install the camctl that wrote it, or {repair}",
            )
        return Profile.model_validate_json(data)
    except ValidationError as error:
        raise DataError(f"{path} is damaged: {first_problem(error)}", hint=repair) from error


class _Header(BaseModel):
    """What every version of the format has; files before the first number are of version 1."""

    version: Any = FORMAT_VERSION


@contextmanager
def profile_storage_errors(path: Path) -> Iterator[None]:
    """Raise `StorageError` with a hint about the folder of the profiles, in place of OSError."""
    try:
        yield
    except StorageError as error:
        raise StorageError(error.what, hint=_STORAGE_HINT) from error
    except OSError as error:
        raise StorageError(storage_error(path, error).what, hint=_STORAGE_HINT) from error
