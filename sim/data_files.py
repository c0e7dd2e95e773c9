"""Scenes and sensors as JSON files: those that come with the program, and a user's own."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import from_json

from camctl.errors import CamctlError, DataError
from camctl.system.input_files import read_input_text

LEAST, MOST = 1e-12, 1e12
"""Limits of numbers in the files: far beyond any scene and sensor, and powers of them are finite in
single precision."""


def _check_least(value: float) -> float:
    if 0 < value < LEAST:
        raise ValueError(f"input should be at least {LEAST:g}")
    return value


NotTiny = AfterValidator(_check_least)
"""For numbers that something is divided by."""

Positive = Annotated[float, Field(gt=0, le=MOST, allow_inf_nan=False), NotTiny]
NotNegative = Annotated[float, Field(ge=0, le=MOST, allow_inf_nan=False)]
Seconds = Annotated[float, Field(gt=0, le=1e5, allow_inf_nan=False), NotTiny]
"""A time of a sensor: a day at most."""

Share = Annotated[float, Field(ge=0, le=1)]
MOST_SIDE = 999_999_999
"""Rows or columns of a picture, at most: a billion would need 100 GB a column."""

_Side = Annotated[int, Field(ge=1, le=MOST_SIDE)]
PictureShape = tuple[_Side, _Side]
"""(rows, columns)."""


class FileModel(BaseModel):
    """Base of the models of JSON files: unknown fields are errors, instances are immutable."""

    model_config = ConfigDict(frozen=True, extra="forbid")


_Model = TypeVar("_Model", bound=FileModel)


def built_in_files(folder: str) -> dict[str, str]:
    """Return the text of the JSON files in a folder of the package `sim`, by their names."""
    return {
        item.name.removesuffix(".json"): item.read_text(encoding="utf-8")
        for item in (resources.files("camctl.sim") / folder).iterdir()
        if item.name.endswith(".json")
    }


def read_file(model: type[_Model], path: Path) -> _Model:
    """Return what the JSON file at `path` describes; raises `DataError` if it cannot be used."""
    text = read_input_text(path, "", hint="give a name or a JSON file")
    return read_text(model, text, source=str(path))


def read_text(model: type[_Model], text: str, *, source: str) -> _Model:
    """Return what the JSON `text` describes.

    Raises:
        DataError: the text is not JSON or does not fit the model; the message starts with `source`
    """
    try:
        # Unlike `json.loads` it limits how long a number and how deep a list may be.
        data = from_json(text)
    except ValueError as error:
        raise DataError(f"{source}: not JSON: {error}") from error
    try:
        return model.model_validate(data)
    except CamctlError as error:
        raise DataError(f"{source}: {error}") from error
    except ValidationError as error:
        first = error.errors()[0]
        place = _place(first["loc"], data)
        reason = first["msg"].removeprefix("Value error, ")
        is_unknown = first["type"] == "extra_forbidden"
        reason = "unknown field" if is_unknown else reason[:1].lower() + reason[1:]
        raise DataError(f"{source}: {place + ': ' if place else ''}{reason}") from error


def _place(location: tuple[int | str, ...], data: Any) -> str:
    """Return where in `data` an error is, such as lens.f_number.

    The rest of the location, which names the member of a union that was tried, is left out.
    """
    parts = []
    for part in location:
        if isinstance(part, str) and isinstance(data, dict):
            data = data.get(part)
        elif isinstance(part, int) and isinstance(data, list):
            data = data[part] if part < len(data) else None
        else:
            break
        parts.append(str(part))
    return ".".join(parts)
