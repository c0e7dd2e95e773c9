"""Tables of exposures: their rows, their file format, and the table that is part of camctl.

A row belongs to the levels of one camera and contains their fingerprint, so that a camera of 10
bits, with a black level or with a rounding quantiser never gets the row of an 8-bit camera.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from camctl.errors import DataError
from camctl.exposure.evaluation import evaluate
from camctl.exposure.objective import Objective
from camctl.exposure.solver import Solution
from camctl.model.response.camera import CameraResponse
from camctl.model.response.desired import DesiredResponse
from camctl.system.files import make_folder, storage_error, write_bytes
from camctl.system.input_files import first_problem, read_input, read_input_text

_REBUILD = "build the table again"
_BUILD = {"table_build": None}

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class TableEntry(BaseModel):
    """One row: the exposures for one camera, response, range and number of exposures.

    Attributes:
        response: `DesiredResponse.key` of the desired response
        dynamic_range: its DR
        n: number of exposures
        camera: `CameraResponse.fingerprint`
        camera_name: name of that camera, shown to people
        levels_wanted: G, the number of levels of the desired camera
        exposures: relative, ascending from 1
        xi: the objective with p = 1: missing levels
        effective_levels: L, without noise
        total_exposure: sum of the exposures: total exposure time in units of the shortest
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
    def _consistent(self) -> TableEntry:
        if len(self.exposures) != self.n:
            raise ValueError(f"it has {len(self.exposures)} exposures, but n is {self.n}")
        if self.exposures[0] != 1 or list(self.exposures) != sorted(self.exposures):
            raise ValueError("the exposures do not ascend from 1")
        if not math.isclose(sum(self.exposures), self.total_exposure, rel_tol=1e-9):
            raise ValueError("total_exposure is not the sum of the exposures")
        return self

    @classmethod
    def of(cls, response: CameraResponse, desired: DesiredResponse, found: Solution) -> TableEntry:
        """Return the row of exposures that were found."""
        quality = evaluate(
            response, desired, found.exposures, objective=Objective(found.levels_wanted)
        )
        return cls(
            response=desired.key,
            dynamic_range=desired.dynamic_range,
            n=len(found.exposures),
            camera=response.fingerprint,
            camera_name=response.name,
            levels_wanted=found.levels_wanted,
            exposures=found.exposures,
            xi=quality.xi,
            effective_levels=quality.effective_levels_noise_free,
            total_exposure=quality.total_exposure,
        )

    def matches(
        self,
        response: CameraResponse,
        desired: DesiredResponse,
        n: int,
        levels_wanted: float | None = None,
    ) -> bool:
        """Return whether this row is for that camera, desired response, n and G (None: n * M)."""
        G = n * response.M if levels_wanted is None else levels_wanted
        return (
            self.n == n
            and self.camera == response.fingerprint
            and self.response == desired.key
            and math.isclose(self.dynamic_range, desired.dynamic_range, rel_tol=1e-12)
            and self.levels_wanted == G
        )

    def to_json(self) -> str:
        """Return the row as one line of JSON."""
        return self.model_dump_json(exclude_none=True)


class _TableFile(BaseModel):
    model_config = ConfigDict(extra="forbid")

    format: Literal["camctl exposure table"] = "camctl exposure table"
    version: Literal[1] = 1
    entries: tuple[TableEntry, ...]


def write_text(path: Path, text: str) -> None:
    """Write a text file and create its folders; the file appears complete or not at all.

    Raises:
        StorageError: it could not be written
    """
    try:
        make_folder(path.parent)
    except OSError as error:
        raise storage_error(path, error) from error
    write_bytes(path, text.encode())


class ExposureTable:
    """Rows of exposures, found by camera, desired response and number of exposures."""

    def __init__(self, entries: Iterable[TableEntry] = ()) -> None:
        self.entries: tuple[TableEntry, ...] = tuple(entries)

    @classmethod
    def load(cls, path: str | Path, response: CameraResponse | None = None) -> ExposureTable:
        """Return the table in a file, which must hold rows for `response` if that is given.

        Raises:
            DataError: the file is missing, damaged, or holds no row for that camera
        """
        try:
            text = read_input_text(path, "exposure table", hint=_REBUILD)
            table = cls.parse(text, f"exposure table {path}", _REBUILD)
        except DataError as error:
            error.remedies = _BUILD
            raise
        if response is not None and all(e.camera != response.fingerprint for e in table.entries):
            others = sorted({entry.camera_name for entry in table.entries}) or ["no camera"]
            raise DataError(
                f"exposure table {path} is for another camera ({', '.join(others[:3])}), "
                f"not for {response.name}",
                hint=_REBUILD,
                remedies=_BUILD,
            )
        return table

    @classmethod
    def parse(cls, text: str, where: str, hint: str) -> ExposureTable:
        """Return a table from its JSON text.

        Raises:
            DataError: the text is damaged; the message starts with `where` and ends with `hint`
        """
        try:
            return cls(_TableFile.model_validate_json(text).entries)
        except ValidationError as error:
            raise DataError(f"{where} is damaged: {first_problem(error)}", hint=hint) from error

    def save(self, path: str | Path) -> None:
        """Write the table; the file appears complete or not at all.

        Raises:
            StorageError: it could not be written
        """
        rows = ",\n  ".join(entry.to_json() for entry in self.entries)
        head = '"format": "camctl exposure table",\n "version": 1,\n "entries": [\n  '
        write_text(Path(path), "{" + head + rows + "\n]}\n")

    def find(
        self,
        response: CameraResponse,
        desired: DesiredResponse,
        n: int,
        levels_wanted: float | None = None,
    ) -> TableEntry | None:
        """Return the row for that camera, desired response, n and G (None: n * M), or None."""
        for entry in self.entries:
            if entry.matches(response, desired, n, levels_wanted):
                return entry
        return None


@cache
def default_table() -> ExposureTable:
    """Return the table that is part of camctl: 8-bit linear, three responses and ranges, n <= 6."""
    name = "default_table.json"
    text = (resources.files("camctl.exposure") / name).read_text(encoding="utf-8")
    return ExposureTable.parse(text, f"{name} of camctl", "install camctl again")


def read_entry(path: Path, matches: Callable[[TableEntry], bool]) -> TableEntry:
    """Return the row in a file of one row, for which `matches` must be true.

    Raises:
        DataError: the file cannot be read, is damaged, or holds another row; names the file
    """
    try:
        entry = TableEntry.model_validate_json(read_input(path, "cached exposures"))
    except ValidationError as error:
        raise DataError(f"cached exposures {path} are damaged: {first_problem(error)}") from error
    if not matches(entry):
        raise DataError(f"cached exposures {path} are for another camera or desired response")
    return entry
