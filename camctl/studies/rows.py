"""Rows of a study as JSON, from which the same runs can be made again."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

from pydantic import TypeAdapter, ValidationError
from pydantic_core import from_json

from camctl.errors import DataError
from camctl.system.input_files import first_problem, read_input

RunT = TypeVar("RunT")


_WRITTEN = "give a file of the JSON that the same study has written"


def read_runs(path: Path, kind: type[RunT]) -> tuple[RunT, ...]:
    """Return the runs in the ``rows`` of a JSON file that a study has written, each once.

    Args:
        path: the file; a row is an object with the fields of `kind` and with results, which are
            not used
        kind: a frozen dataclass: all that is needed for one run

    Raises:
        DataError: the file cannot be read or has no rows; names the row that is invalid
        UsageError: a value that `kind` refuses
    """
    try:
        content = from_json(read_input(path, "", hint=_WRITTEN))
    except ValueError as error:
        raise DataError(f"{path} is not JSON", hint=_WRITTEN) from error
    # Versions before 0.2.0 have written the list alone.
    rows = content.get("rows") if isinstance(content, dict) else content
    if not isinstance(rows, list) or not rows:
        raise DataError(f"{path} has no rows", hint=_WRITTEN)
    adapter = TypeAdapter(kind)
    runs = []
    for place, row in enumerate(rows, 1):
        try:
            runs.append(adapter.validate_python(row))
        except ValidationError as error:
            raise DataError(f"{path}, row {place}: {first_problem(error)}") from error
    return tuple(dict.fromkeys(runs))
