"""The profiles of all cameras: listed, found by name, imported from a file, removed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from camctl.errors import DataError, StorageError, UsageError, unknown_name
from camctl.profiles.profile import (
    READ_HINT,
    SUFFIX,
    Profile,
    parse_profile,
    profile_directory,
    profile_path,
    profile_storage_errors,
    read_profile,
    save_profile,
)
from camctl.system.files import file_lock, make_folder
from camctl.system.input_files import unreadable


def list_profiles() -> list[Profile]:
    """Return all profiles, by name.

    Raises:
        DataError: one is damaged or cannot be read
    """
    folder = profile_directory()
    try:
        paths = sorted(path for path in folder.iterdir() if path.suffix == SUFFIX)
    except (FileNotFoundError, NotADirectoryError):
        return []
    except OSError as error:
        raise unreadable(folder, "", error, hint=READ_HINT) from error
    found = (read_profile(path) for path in paths if not path.name.startswith("."))
    return [profile for profile in found if profile is not None]


def find_profile(name: str) -> Profile:
    """Return the profile of that name.

    Raises:
        UsageError: there is none
        DataError: it is damaged or cannot be read
    """
    known = _known_profiles()
    found = read_profile(known[name]) if name in known else None
    if found is None:
        raise _unknown(name, known)
    return found


def import_profile(path: Path, *, replace: Callable[[Profile], bool]) -> Path:
    """Save the profile in a file, as `camctl profile export` writes it; return where.

    Args:
        path: of the file, from anybody: every value in it is checked
        replace: called with the camera's present profile, if there is one; True replaces it

    Raises:
        DataError: the file cannot be read, or holds no profile
        StorageError: the camera has a profile that is not to be replaced, or it cannot be saved
    """
    profile = parse_profile(path, hint="", repair="export it again")
    present = profile_path(profile.name)
    with profile_storage_errors(present):
        make_folder(present.parent)
        with file_lock(present.parent / ".lock"):
            try:
                earlier = read_profile(present)
            except DataError:  # a damaged one is worth nothing, but it is still replaced on request
                earlier = profile
            if earlier is None or replace(earlier):
                return save_profile(profile)
    raise StorageError(
        f"the camera has the profile {profile.name} already",
        hint="replace it",
        remedies={"overwrite": None},
    )


def remove_profile(name: str) -> Path:
    """Remove the profile of that name, damaged or not; return the file that was removed.

    Raises:
        UsageError: there is none
        StorageError: it cannot be removed
    """
    known = _known_profiles()
    if name not in known:
        raise _unknown(name, known)
    with profile_storage_errors(known[name]):
        known[name].unlink(missing_ok=True)
    return known[name]


def _known_profiles() -> dict[str, Path]:
    """Return the files of the profiles by name."""
    return {path.stem: path for path in profile_directory().glob(f"[!.]*{SUFFIX}")}


def _unknown(name: str, known: Mapping[str, Path]) -> UsageError:
    if not known:
        return UsageError(
            f"unknown profile '{name}': there are no profiles",
            hint="make one: calibrate a camera",
            remedies={"calibrate_all": None},
        )
    return unknown_name("profile", name, known)
