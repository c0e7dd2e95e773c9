"""What is known of one camera, kept from day to day and found again by its serial number.

A profile is one JSON file in $CAMCTL_PROFILES, or else in ``profiles`` of the user's data folder.
It belongs to a driver, make, model and serial number, and not to an id: a camera keeps its profile
at another socket.  Cameras of one model without serial numbers share one.
"""

from __future__ import annotations

import fcntl
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
from camctl.files import storage_error, write_bytes

_SUFFIX = ".json"
_LONGEST_STEM = 80
_ELSEWHERE = "see to the disk, or name another folder in $CAMCTL_PROFILES"


class DelayRecord(BaseModel):
    """How late a camera's exposure controls are, measured in one mode.

    Attributes:
        frames: the delay in frames, as `camctl.camera.StreamingCamera.step` counts; None where it
            is not constant
        smallest, largest: of all trials, frames
        trials: how often it was measured
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
    """What the files of a still camera are in one format; brightnesses in DN."""

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
            raise ValueError("black, white and bits contradict each other")
        return self


class Profile(BaseModel):
    """What is known of one camera: control delays by mode, the make-up of its files by format."""

    model_config = ConfigDict(extra="forbid")

    driver: str
    make: str
    model: str
    serial: str
    delays: dict[str, DelayRecord] = {}
    stills: dict[str, StillRecord] = {}

    @property
    def name(self) -> str:
        """The name of its file without suffix: readable, and another for every other camera."""
        who = (self.driver, self.make, self.model, self.serial)
        spelt = unicodedata.normalize("NFKD", "-".join(who)).encode("ascii", "ignore").decode()
        stem = re.sub(r"[^a-z0-9]+", "-", spelt.lower()).strip("-")[:_LONGEST_STEM].rstrip("-")
        return f"{stem}-{hashlib.sha256(json.dumps(who).encode()).hexdigest()[:8]}"


def profile_directory() -> Path:
    """Return the folder of the profiles, which need not exist."""
    named = os.environ.get("CAMCTL_PROFILES")
    return Path(named) if named else Path(user_data_dir("camctl")) / "profiles"


def load_profile(info: CameraInfo) -> Profile:
    """Return what is known of a camera; an empty profile where nothing is.

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
    """Write a profile, whole or not at all, in place of the earlier one; return its file.

    What reads, changes and saves a profile does so in `change_profile`, or loses what another
    process has learnt meanwhile.

    Raises:
        StorageError: it could not be written

    """
    path = _path(profile.name)
    with _told_where(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(path, profile.model_dump_json(indent=2).encode() + b"\n")
    return path


def change_profile(info: CameraInfo, change: Callable[[Profile], None]) -> Path:
    """Let `change` alter the profile of a camera while no other process does; return its file.

    Raises:
        DataError: the profile that is there cannot be used
        StorageError: the new one could not be written

    """
    folder = profile_directory()
    with _told_where(folder):
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / ".lock").open("wb")
    with lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
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
                f"no profile '{name}', and no other", hint="camctl calibrate makes them"
            )
        raise unknown_name("profile", name, known)
    with _told_where(known[name]):
        known[name].unlink(missing_ok=True)
    return known[name]


def _empty(info: CameraInfo) -> Profile:
    # A device may answer anything; a lone surrogate is no text that could be written.
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
    """Return the profile in a file, None where there is no file."""
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
        hint="make it readable, or name another folder in $CAMCTL_PROFILES",
    )


@contextmanager
def _told_where(path: Path) -> Iterator[None]:
    """Turn what cannot be written into one line that names the way out."""
    try:
        yield
    except StorageError as error:
        raise StorageError(error.what, hint=_ELSEWHERE) from error
    except OSError as error:
        raise StorageError(storage_error(path, error).what, hint=_ELSEWHERE) from error
