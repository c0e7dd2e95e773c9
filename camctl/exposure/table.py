"""Rows of exposures, and tables of them on disk.

A row belongs to one camera's levels: its key holds their fingerprint, so that a camera of 10 bits,
with a black level or with a rounding converter is never served the row of an 8-bit one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from camctl.errors import DataError
from camctl.files import storage_error, write_bytes
from camctl.response.camera import CameraResponse
from camctl.response.desired import DesiredResponse

_REBUILD = "build it again with 'camctl table build'"

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class TableEntry(BaseModel):
    """One row: the exposures for one camera, response, range and number of exposures.

    Attributes:
        response: `DesiredResponse.key` of the desired response
        dynamic_range: its DR
        n: number of exposures
        camera: `CameraResponse.fingerprint`
        camera_name: what a person calls that camera
        levels_wanted: G
        exposures: relative, ascending from 1
        xi: the objective, p = 1
        effective_levels: L
        total_exposure: sum of the exposures: shutter time in units of the shortest
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    response: str
    dynamic_range: Annotated[float, Field(gt=1, allow_inf_nan=False)]
    n: Annotated[int, Field(ge=1, le=16)]
    camera: Annotated[str, Field(pattern="^[0-9a-f]{16}$")]
    camera_name: str
    levels_wanted: Positive
    exposures: tuple[Positive, ...]
    xi: Annotated[float, Field(ge=0, allow_inf_nan=False)]
    effective_levels: Positive
    total_exposure: Positive

    @model_validator(mode="after")
    def _whole(self) -> TableEntry:
        if len(self.exposures) != self.n:
            raise ValueError(f"{len(self.exposures)} exposures where n is {self.n}")
        if self.exposures[0] != 1 or list(self.exposures) != sorted(self.exposures):
            raise ValueError("exposures must ascend from 1")
        if not math.isclose(sum(self.exposures), self.total_exposure, rel_tol=1e-9):
            raise ValueError("total_exposure is not the sum of the exposures")
        return self

    def is_for(
        self,
        real: CameraResponse,
        desired: DesiredResponse,
        n: int,
        levels_wanted: float | None = None,
    ) -> bool:
        """Return whether this row answers that question; without `levels_wanted` G is n * M."""
        wanted = n * real.M if levels_wanted is None else levels_wanted
        return (
            self.n == n
            and self.camera == real.fingerprint
            and self.response == desired.key
            and math.isclose(self.dynamic_range, desired.dynamic_range, rel_tol=1e-12)
            and self.levels_wanted == wanted
        )


class _TableFile(BaseModel):
    model_config = ConfigDict(extra="forbid")

    format: Literal["camctl exposure table"] = "camctl exposure table"
    version: Literal[1] = 1
    entries: tuple[TableEntry, ...]


def write_text(path: Path, text: str) -> None:
    """Write a text file, and the folders above it; it appears whole or not at all.

    Raises:
        StorageError: it could not be written
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise storage_error(path, error) from error
    write_bytes(path, text.encode())


def _problem(error: ValidationError) -> str:
    first = error.errors(include_url=False)[0]
    where = ".".join(str(part) for part in first["loc"])
    return f"{where}: {first['msg']}" if where else str(first["msg"])


class ExposureTable:
    """Rows of exposures, found by camera, response, range and number."""

    def __init__(self, entries: Iterable[TableEntry] = ()) -> None:
        self.entries: tuple[TableEntry, ...] = tuple(entries)

    @classmethod
    def load(cls, path: str | Path, real: CameraResponse | None = None) -> ExposureTable:
        """Read a table; with `real`, one that must hold rows for that camera.

        Raises:
            DataError: for a file that is missing, damaged, or of another camera
        """
        path = Path(path)
        try:
            text = path.read_text(encoding="utf-8")
        except OSError as error:
            raise DataError(f"exposure table {path}: {error.strerror or error}") from error
        except UnicodeDecodeError as error:
            raise DataError(
                f"exposure table {path} is damaged: not a text file", hint=_REBUILD
            ) from error
        table = cls.parse(text, f"exposure table {path}", _REBUILD)
        if real is not None and all(e.camera != real.fingerprint for e in table.entries):
            others = sorted({entry.camera_name for entry in table.entries}) or ["no camera"]
            raise DataError(
                f"exposure table {path} is of another camera ({', '.join(others[:3])}), "
                f"not of {real.name}",
                hint=_REBUILD,
            )
        return table

    @classmethod
    def parse(cls, text: str, where: str, hint: str) -> ExposureTable:
        """Return a table from its JSON; `DataError` names `where` and ends with `hint`."""
        try:
            return cls(_TableFile.model_validate_json(text).entries)
        except ValidationError as error:
            raise DataError(f"{where} is damaged: {_problem(error)}", hint=hint) from error

    def save(self, path: str | Path) -> None:
        """Write the table; it appears whole or not at all.  Raises `StorageError`."""
        rows = ",\n  ".join(entry.model_dump_json() for entry in self.entries)
        head = '"format": "camctl exposure table",\n "version": 1,\n "entries": [\n  '
        write_text(Path(path), "{" + head + rows + "\n]}\n")

    def find(
        self,
        real: CameraResponse,
        desired: DesiredResponse,
        n: int,
        levels_wanted: float | None = None,
    ) -> TableEntry | None:
        """Return the row for a camera, or None."""
        for entry in self.entries:
            if entry.is_for(real, desired, n, levels_wanted):
                return entry
        return None


def read_entry(path: Path, fits: Callable[[TableEntry], bool]) -> TableEntry:
    """Read a file of one row that must fit; raises `DataError` that says to delete it."""
    try:
        entry = TableEntry.model_validate_json(path.read_bytes())
    except OSError as error:
        raise DataError(f"cached exposures {path}: {error.strerror or error}") from error
    except ValidationError as error:
        raise DataError(
            f"cached exposures {path} are damaged: {_problem(error)}", hint="delete that file"
        ) from error
    if not fits(entry):
        raise DataError(
            f"cached exposures {path} are of another camera or wish", hint="delete that file"
        )
    return entry
