"""The menu's settings on disk: written whole or not at all, with a version, and never trusted."""

from __future__ import annotations

import json
from dataclasses import asdict, fields
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from camctl.errors import CamctlError, DataError
from camctl.menu.data import Settings
from camctl.menu.entries import KEPT
from camctl.system.files import make_folder, storage_error, write_bytes
from camctl.system.input_files import read_own_file

VERSION = 2
"""Version of the file's format; files of another version are not read."""


class _File(BaseModel):
    """The content of the file; indices are checked against the lists when it is read."""

    model_config = ConfigDict(extra="forbid", strict=True)

    version: int
    settings: dict[str, int | str] = Field(max_length=len(fields(Settings)))


def load_settings(path: Path) -> tuple[Settings, str]:
    """Return the settings in a file, and why they are the defaults, "" where they are not.

    A missing file is the first start, and needs no remark.
    """
    if not path.exists() and not path.is_symlink():
        return Settings(), ""
    try:
        return _parsed(bytes(read_own_file(path, 4096))), ""
    except CamctlError as error:
        return Settings(), f"Settings are the defaults: {error}"


def _parsed(data: bytes) -> Settings:
    try:
        file = _File.model_validate(json.loads(data))
    except (ValueError, RecursionError, ValidationError) as error:
        raise DataError("the file of the settings is damaged") from error
    if file.version != VERSION:
        raise DataError(f"their file has version {file.version}, not {VERSION}")
    for name, value in file.settings.items():
        if name == "camera":
            is_valid = isinstance(value, str) and value.isprintable()
        else:
            entries = KEPT.get(name, ())
            is_valid = isinstance(value, int) and 0 <= value < len(entries)
        if not is_valid:
            raise DataError(f"their file has an invalid value of {name[:20]}")
    return Settings(**file.settings)  # type: ignore[arg-type]  # checked above


def save_settings(path: Path, settings: Settings) -> None:
    """Write the settings; they are on disk when this returns.  Raises `StorageError`."""
    try:
        make_folder(path.parent)
    except OSError as error:
        raise storage_error(path, error) from error
    data = {"version": VERSION, "settings": asdict(settings)}
    write_bytes(path, json.dumps(data, indent=1).encode() + b"\n")
