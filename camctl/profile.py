"""Camera profiles: measurements of one camera that are kept between sessions.

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
from pathlib import Path
from typing import Self

from platformdirs import user_data_dir
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from camctl.camera import CameraInfo
from camctl.controls import Layout
from camctl.errors import DataError, StorageError, UsageError, unknown_name
from camctl.files import exclusive_lock, storage_error, write_bytes

_SUFFIX = ".json"
#: Characters of a profile's name before its hash; file names have 255 at most.
_LONGEST_STEM = 80
_STORAGE_HINT = "check the disk, or set $CAMCTL_PROFILES to another folder"


class DelayRecord(BaseModel):
    """The measured control delay of a camera in one mode.

    Attributes:
        frames: the delay in frames, counted as in `camctl.camera.StreamingCamera.step`; None where
            it is not constant
        smallest: the smallest delay of all trials, frames
        largest: the largest delay of all trials, frames
        trials: number of measurements
        measured_at: date and time, ISO 8601
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    frames: int | None
    smallest: int = Field(ge=0)
    largest: int = Field(ge=0)
    trials: int = Field(ge=1)
    measured_at: str

    @model_validator(mode="after")
    def _agree(self) -> Self:
        constant = self.smallest if self.smallest == self.largest else None
        if self.smallest > self.largest or self.frames != constant:
            raise ValueError("frames, smallest and largest contradict each other")
        return self


class StillRecord(BaseModel):
    """Pixel format of the files that a still camera makes in one format.

    Attributes:
        rows: of a frame
        columns: of a frame
        layout: pixel layout
        bits: per sample
        black: brightness without light, DN
        white: brightness from which samples are saturated, DN
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    rows: int = Field(ge=1)
    columns: int = Field(ge=1)
    layout: Layout
    bits: int = Field(ge=1, le=16)
    black: int = Field(ge=0)
    white: int = Field(ge=1)

    @model_validator(mode="after")
    def _agree(self) -> Self:
        if not self.black < self.white < 2**self.bits:
            raise ValueError("expected black < white < 2^bits")
        return self


class Profile(BaseModel):
    """Measurements of one camera.

    Attributes:
        driver: driver of the camera, as in `camctl.camera.CameraInfo`
        make: maker of the camera
        model: model of the camera
        serial: serial number of the camera
        delays: control delays by mode (see `camctl.camera.StreamingCamera.mode`)
        stills: pixel formats of its files by file format
    """

    model_config = ConfigDict(extra="forbid")

    driver: str
    make: str
    model: str
    serial: str
    delays: dict[str, DelayRecord] = {}
    stills: dict[str, StillRecord] = {}

    @property
    def name(self) -> str:
        """The name of its file without suffix: readable, and unique for each camera."""
        identity = (self.driver, self.make, self.model, self.serial)
        text = unicodedata.normalize("NFKD", "-".join(identity)).encode("ascii", "ignore").decode()
        stem = re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")[:_LONGEST_STEM].rstrip("-")
        return f"{stem}-{hashlib.sha256(json.dumps(identity).encode()).hexdigest()[:8]}"


def profile_directory() -> Path:
    """Return the folder of the profiles, which need not exist."""
    named = os.environ.get("CAMCTL_PROFILES")
    return Path(named) if named else Path(user_data_dir("camctl")) / "profiles"


def load_profile(info: CameraInfo) -> Profile:
    """Return the profile of a camera; an empty one where there is none.

    Raises:
        DataError: its file is damaged, cannot be read, or belongs to another camera
    """
    empty = _empty(info)
    path = _path(empty.name)
    found = _read(path)
    if found is None:
        return empty
    if found.name != empty.name:
        raise DataError(f"{path} is the profile of another camera", hint=_repair(path))
    return found


def save_profile(profile: Profile) -> Path:
    """Write a profile, atomically, in place of the earlier one; return its file.

    To read, change and save a profile use `change_profile`: without its lock, changes that another
    process makes at the same time would be lost.

    Raises:
        StorageError: it could not be written
    """
    path = _path(profile.name)
    with _storage_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
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
    with _storage_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        with exclusive_lock(folder / ".lock"):
            profile = load_profile(info)
            change(profile)
            return save_profile(profile)


def list_profiles() -> list[Profile]:
    """Return all profiles, by name.

    Raises:
        DataError: one is damaged or cannot be read
    """
    folder = profile_directory()
    try:
        paths = sorted(path for path in folder.iterdir() if path.suffix == _SUFFIX)
    except FileNotFoundError:
        return []
    except OSError as error:
        raise _unreadable(folder, error) from error
    found = (_read(path) for path in paths if not path.name.startswith("."))
    return [profile for profile in found if profile is not None]


def remove_profile(name: str) -> Path:
    """Remove the profile of that name, damaged or not; return the file that was removed.

    Raises:
        UsageError: there is none
        StorageError: it cannot be removed
    """
    known = {path.stem: path for path in profile_directory().glob(f"[!.]*{_SUFFIX}")}
    if name not in known:
        if not known:
            raise UsageError(
                f"unknown profile '{name}': there are no profiles",
                hint="make one with camctl calibrate",
            )
        raise unknown_name("profile", name, known)
    with _storage_errors(known[name]):
        known[name].unlink(missing_ok=True)
    return known[name]


def _empty(info: CameraInfo) -> Profile:
    # A device may send any text; a lone surrogate in it cannot be written to a file.
    driver, make, model, serial = (
        text.encode("utf-8", "replace").decode()
        for text in (info.driver, info.make, info.model, info.serial)
    )
    return Profile(driver=driver, make=make, model=model, serial=serial)


def _path(name: str) -> Path:
    return profile_directory() / f"{name}{_SUFFIX}"


def _repair(path: Path) -> str:
    return f"remove it with camctl profile remove {path.stem}, and calibrate again"


def _read(path: Path) -> Profile | None:
    """Return the profile in a file; None where there is no file."""
    try:
        return Profile.model_validate_json(path.read_bytes())
    except FileNotFoundError:
        return None
    except OSError as error:
        raise _unreadable(path, error) from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or "the file"
        raise DataError(
            f"{path} is damaged at {where}: {first['msg']}", hint=_repair(path)
        ) from error


def _unreadable(path: Path, error: OSError) -> DataError:
    return DataError(
        f"cannot read {path}: {error.strerror or error}",
        hint="make it readable, or set $CAMCTL_PROFILES to another folder",
    )


@contextmanager
def _storage_errors(path: Path) -> Iterator[None]:
    """Raise `StorageError` with a hint about the folder of the profiles, in place of OSError."""
    try:
        yield
    except StorageError as error:
        raise StorageError(error.what, hint=_STORAGE_HINT) from error
    except OSError as error:
        raise StorageError(storage_error(path, error).what, hint=_STORAGE_HINT) from error
