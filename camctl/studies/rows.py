"""Results of a study as JSON: rows from which the same runs are made again, or are continued."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Generic, TypeVar

from pydantic import TypeAdapter, ValidationError
from pydantic_core import from_json, to_json

from camctl.errors import DataError
from camctl.system.files import storage_error
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


ItemT = TypeVar("ItemT")
ResultT = TypeVar("ResultT")

_LARGEST = 1 << 30
"""Bytes of the file that are read at most: a million results of 1 kB."""


class KeptResults(Generic[ItemT, ResultT]):
    """A file with one JSON object a line: an item of the work, and its result.

    A line that a killed process has left incomplete is computed again.

    Args:
        path: of the file
        item, result: types of both, which pydantic turns into JSON and back
    """

    def __init__(self, path: Path, item: type[ItemT], result: type[ResultT]) -> None:
        self._path = path
        self._item, self._result = TypeAdapter(item), TypeAdapter(result)

    def read(self, items: Sequence[ItemT]) -> Iterator[tuple[int, ResultT]]:
        """Yield the places of the items whose results are in the file, with these.

        Raises:
            DataError: the file cannot be read, or holds something else
            StorageError: it cannot be written
        """
        if not self._path.exists():
            return
        data = read_input(self._path, "file of results", most_bytes=_LARGEST)
        whole = data[: data.rfind(b"\n") + 1]
        if len(whole) < len(data):
            self._cut(len(whole))
        by_item: dict[bytes, ResultT] = {}
        for number, line in enumerate(whole.splitlines(), 1):
            try:
                item, result = from_json(line)
                by_item[_key(item)] = self._result.validate_python(result)
            except ValidationError as error:
                raise self._damaged(number, first_problem(error)) from error
            except (ValueError, TypeError) as error:
                raise self._damaged(number, "it is no item with its result") from error
        for place, each in enumerate(items):
            key = _key(self._item.dump_python(each, mode="json"))
            if key in by_item:
                yield place, by_item[key]

    def add(self, item: ItemT, result: ResultT) -> None:
        """Add a result; raise `StorageError` where it cannot be written."""
        line = _key(
            [
                self._item.dump_python(item, mode="json"),
                self._result.dump_python(result, mode="python"),
            ]
        )
        try:
            with self._path.open("ab") as file:
                file.write(line + b"\n")
        except OSError as error:
            raise storage_error(self._path, error) from error

    def _cut(self, length: int) -> None:
        try:
            with self._path.open("r+b") as file:
                file.truncate(length)
        except OSError as error:
            raise storage_error(self._path, error) from error

    def _damaged(self, number: int, why: str) -> DataError:
        return DataError(
            f"{self._path}, line {number}: {why}", hint="keep the results in another file"
        )


def _key(value: object) -> bytes:
    """Return JSON with NaN and infinity, the same for the same value."""
    return to_json(value, inf_nan_mode="constants")
