"""The captures in a folder: their order, and the name of the next one.

Names begin with a number that counts up, since the clock of a device that was never set starts at
the same time again and again.  The date follows it where the clock has been set.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator
from datetime import datetime
from itertools import islice
from pathlib import Path

from camctl.errors import CamctlError
from camctl.menu.data import Past
from camctl.records import REPORT, SERIES
from camctl.system.input_files import read_own_file

_NUMBERED = re.compile(r"(?:capture|series)-(\d{4,7})(?:-\d{8}-\d{6})?", re.ASCII)
_FIRST_YEAR = 2026
"""A clock that shows an earlier year was never set."""
_MOST_LISTED = 100  # the newest ones
_LONGEST_FILE = 4 << 20
"""Bytes of a report or a journal that are read at most: a set of a series takes less than 1 kB."""


def next_folder(parent: Path, now: datetime, kind: str = "capture", place: int = 0) -> Path:
    """Return the path of the next folder in `parent`, of a "capture" or a "series".

    Of several that begin together, each has its place, from 0 on.
    """
    names = [path.name for path in parent.iterdir()] if parent.is_dir() else []
    number = 1 + place + max((_number(name) for name in names), default=0)
    date = f"-{now:%Y%m%d-%H%M%S}" if now.year >= _FIRST_YEAR else ""
    return parent / f"{kind}-{number:04d}{date}"


def list_captures(parent: Path) -> tuple[Past, ...]:
    """Return the captures in a folder, the newest first, `_MOST_LISTED` of them at most.

    A series has its last complete picture in the list, and itself where pictures are missing.
    """
    if not parent.is_dir():
        return ()
    folders = sorted(parent.iterdir(), key=lambda path: (_number(path.name), path.name))
    shown = islice(_captures(reversed(folders)), _MOST_LISTED)
    return tuple(Past(str(folder.relative_to(parent)), complete) for folder, complete in shown)


def _captures(folders: Iterable[Path]) -> Iterator[tuple[Path, bool]]:
    """Yield each capture of the folders, and whether nothing of it is missing."""
    for folder in folders:
        series, report = folder / SERIES, folder / REPORT
        if series.is_file():
            reports = sorted(folder.glob(f"*/{REPORT}"), reverse=True)
            sets = ((each.parent, _is_complete(each)) for each in reports)
            if not _is_complete(series):
                yield folder, False
                sets = (each for each in sets if each[1])
            yield from islice(sets, 1)
        elif report.is_file():
            yield folder, _is_complete(report)


def _number(name: str) -> int:
    found = _NUMBERED.fullmatch(name)
    return int(found[1]) if found else 0


def _is_complete(file: Path) -> bool:
    """Return whether nothing is missing by a report, or by the journal of a series.

    A series that is taken by keys ends when the user ends it: it cannot be continued in the menu.
    """
    try:
        found = json.loads(bytes(read_own_file(file, _LONGEST_FILE)))
        if file.name == REPORT:
            return bool(found["status"] != "incomplete")
        sets, wanted = found["sets"], found["options"]["repeat"]
        return wanted is None or (len(sets) >= wanted and sets[-1]["state"] != "begun")
    except (CamctlError, ValueError, RecursionError, TypeError, LookupError):
        return True  # looking at it shows what is wrong
