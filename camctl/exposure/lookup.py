"""The exposure table: solved once, looked up ever after."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from importlib import resources
from pathlib import Path

from platformdirs import user_cache_dir

from camctl.errors import StorageError
from camctl.exposure.build import Job, build_table, solve_job
from camctl.exposure.table import ExposureTable, TableEntry, read_entry, write_text
from camctl.response.camera import CameraResponse
from camctl.response.desired import DesiredResponse

__all__ = [
    "ExposureTable",
    "TableEntry",
    "build_table",
    "cache_folder",
    "default_table",
    "look_up",
]


@cache
def default_table() -> ExposureTable:
    """Return the table that ships: 8-bit linear, the three responses and ranges, n = 1..6."""
    file = resources.files("camctl.exposure") / "default_table.json"
    return ExposureTable.parse(
        file.read_text(encoding="utf-8"), "the shipped exposure table", "install camctl again"
    )


def cache_folder() -> Path:
    """Return where solved rows are kept: $CAMCTL_CACHE, else the user's cache folder."""
    if chosen := os.environ.get("CAMCTL_CACHE"):
        return Path(chosen) / "exposure"
    return Path(user_cache_dir("camctl")) / "exposure"


def look_up(
    real: CameraResponse,
    desired: DesiredResponse,
    n: int,
    *,
    levels_wanted: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> TableEntry:
    """Return the exposures for a camera: from the shipped table, the user's cache, or solved now.

    What is solved is kept in `cache_folder()`; where that cannot be written it is solved again the
    next time.  `progress` is called with the share done, 0 to 1, while solving.

    Raises:
        UsageError: for n or G that cannot be
        DataError: for a damaged row in the cache; names the file to delete
    """
    found = default_table().find(real, desired, n, levels_wanted)
    if found is not None:
        return found
    job = Job(real, desired, n, levels_wanted=levels_wanted)
    path = cache_folder() / f"{job.name}.json"
    if path.exists():
        return read_entry(path, job.is_answered_by)
    entry = solve_job(job, progress)
    with suppress(StorageError):
        write_text(path, entry.model_dump_json() + "\n")
    return entry
