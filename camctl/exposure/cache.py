"""Results of searches, kept in the user's cache folder: each is a file of its own.

A file appears complete or not at all.  One that cannot be used is set aside and does not count.
Where the folder cannot be written, nothing is kept.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

from platformdirs import user_cache_dir

from camctl.errors import DataError, StorageError
from camctl.exposure.table import write_text

_log = logging.getLogger(__name__)

MOST_FILES = 1000
"""Files that are kept; the oldest are deleted.  They have 0.3 to 8 kB each: 8 MB at most."""

T = TypeVar("T")


def cache_folder() -> Path:
    """Return the folder of solved rows: $CAMCTL_CACHE/exposure, else in the user's cache folder."""
    if chosen := os.environ.get("CAMCTL_CACHE"):
        return Path(chosen) / "exposure"
    return Path(user_cache_dir("camctl")) / "exposure"


def kept(
    name: str, read: Callable[[Path], T], compute: Callable[[], T], text: Callable[[T], str]
) -> T:
    """Return what the cache has under a name, or compute and keep it.

    Args:
        name: of the file, without its ending
        read: returns what a file holds; raises `DataError` where it cannot be used
        compute: returns what is not there
        text: returns what a file of it holds
    """
    path = cache_folder() / f"{name}.json"
    found = read_kept(path, read)
    if found is None:
        found = compute()
        with suppress(StorageError):
            write_text(path, text(found) + "\n")
        _delete_oldest(path.parent)
    return found


def read_kept(path: Path, read: Callable[[Path], T]) -> T | None:
    """Return what a file holds; None where there is none.

    A file that cannot be used is renamed, with a warning in the log, and does not count.
    """
    try:
        return read(path) if path.exists() else None
    except OSError:  # the folder cannot be searched
        return None
    except DataError as error:
        aside = path.with_name(f"{path.name}.damaged")
        try:
            path.replace(aside)
            _log.warning("%s; set aside as %s, and computed again", error.what, aside.name)
        except OSError:
            _log.warning("%s; computed again", error.what)
        return None


def _delete_oldest(folder: Path) -> None:
    """Delete the oldest files of a folder that has more than `MOST_FILES`."""
    with suppress(OSError):  # another process may have deleted one
        with os.scandir(folder) as entries:
            files = [(entry.stat().st_mtime, entry.path) for entry in entries if entry.is_file()]
        for _, path in sorted(files)[: max(0, len(files) - MOST_FILES)]:
            Path(path).unlink(missing_ok=True)
