"""Where a capture comes from and where it lands, when nobody says."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any


def source_of(camera_id: str, beside: Mapping[str, str]) -> dict[str, Any]:
    """Return what a report must hold to open its camera again, from any working directory."""
    found_again = {name: _anywhere(value) for name, value in beside.items()}
    return {"camera": camera_id, "options": found_again}


def _anywhere(value: str) -> str:
    """Return a file's name as a full path; a bare word stays, even where a file is called so."""
    path = Path(value)
    return str(path.resolve()) if (path.suffix or "/" in value) and path.exists() else value


def fresh_directory(parent: Path = Path()) -> Path:
    """Return a folder in `parent` that is not there yet, named by the time of day."""
    stem = f"capture-{datetime.now():%Y%m%d-%H%M%S}"
    names = (stem if number == 1 else f"{stem}-{number}" for number in range(1, 1000))
    return next(parent / name for name in names if not (parent / name).exists())
