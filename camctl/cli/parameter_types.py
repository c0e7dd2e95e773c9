"""Types of option values: each parses a text, reports what it expects, and completes it on Tab."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem

from camctl.errors import DataError, UsageError, unknown_name
from camctl.model.response.names import RANGES
from camctl.system.input_files import exists, read_input_text
from camctl.system.number_text import time_of

if TYPE_CHECKING:
    AnyType = click.ParamType[Any]
else:
    AnyType = click.ParamType  # generic only since click 8.3, and only for type checkers

# A file that cannot be read is no usage error: whatever reads it gives the reason.
PATH = click.Path(path_type=Path, readable=False)


def invalid_value(option: str, text: str, reason: str) -> UsageError:
    """Return the error for a text that is no value of an option."""
    return UsageError(f"invalid value for {option}: {text or repr(text)}", hint=reason)


class _ValueType(AnyType):
    """Base of the types; a subclass implements `parse`, and `suggestions` where it has names."""

    completes_files = False

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the parsed text; other defaults, and texts during completion, are unchanged."""
        if not isinstance(value, str) or (ctx is not None and ctx.resilient_parsing):
            return value
        option = param.opts[-1] if param is not None else "value"
        return self.parse(value.strip(), option)

    def parse(self, text: str, option: str) -> Any:
        """Return the value of `text`; raise `UsageError`, which names the option."""
        raise NotImplementedError

    def suggestions(self) -> Iterable[str]:
        """Return the names that the Tab key offers."""
        return ()

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Return the suggestions that start with `incomplete`."""
        files = [CompletionItem(incomplete, type="file")] if self.completes_files else []
        names = [name for name in self.suggestions() if name.startswith(incomplete)]
        return files + [CompletionItem(name) for name in names]


class Text(_ValueType):
    """Any text; the Tab key offers names and, with `files`, file names."""

    name = "text"

    def __init__(
        self, suggestions: Callable[[], Iterable[str]] = tuple, *, files: bool = False
    ) -> None:
        self._suggestions = suggestions
        self.completes_files = files

    def parse(self, text: str, option: str) -> str:
        return text

    def suggestions(self) -> Iterable[str]:
        return self._suggestions()


def _entry_point_names(group: str) -> list[str]:
    from importlib.metadata import entry_points  # completion alone needs it

    return sorted(point.name for point in entry_points(group=group))


def _built_in_names(folder: str) -> list[str]:
    """Return the names of the JSON files in a folder of the package `sim`."""
    from importlib import resources

    files = (resources.files("camctl.sim") / folder).iterdir()
    return sorted(file.name.removesuffix(".json") for file in files if file.name.endswith(".json"))


# The entry-point groups are also in `camctl.interface.backends`, which imports numpy.
CAMERA = Text(lambda: _entry_point_names("camctl.cameras"))
PANEL = Text(lambda: _entry_point_names("camctl.panels"))
SCENE = Text(lambda: _built_in_names("scenes"), files=True)
SENSOR = Text(lambda: _built_in_names("sensors"), files=True)
FILE = Text(files=True)


def _float(text: str) -> float:
    """Return the number that `text` is, NaN if it is none."""
    try:
        return float(text)
    except ValueError:
        return math.nan


class Number(_ValueType):
    """A finite number within bounds; `expected` describes it in error messages."""

    name = "number"

    def __init__(
        self,
        expected: str,
        *,
        above: float = -math.inf,
        least: float = -math.inf,
        most: float = math.inf,
        below: float = math.inf,
    ) -> None:
        self.expected = expected
        self._above, self._least, self._most, self._below = above, least, most, below

    def parse(self, text: str, option: str) -> float:
        value = _float(text)
        within = self._above < value < self._below and self._least <= value <= self._most
        if not (within and math.isfinite(value)):
            raise invalid_value(option, text, f"expected {self.expected}")
        return value


class WholeNumber(_ValueType):
    """A whole number within bounds, both included."""

    name = "integer"

    def __init__(self, *, least: int, most: int | None = None) -> None:
        self._least, self._most = least, most
        limits = f"of at least {least}" if most is None else f"from {least} to {most}"
        self.expected = f"a whole number {limits}"

    def parse(self, text: str, option: str) -> int:
        try:
            value = int(text)
        except ValueError:
            raise invalid_value(option, text, f"expected {self.expected}") from None
        if value < self._least or (self._most is not None and value > self._most):
            raise invalid_value(option, text, f"expected {self.expected}")
        return value


class Name(_ValueType):
    """One of a few names; `kind` is what error messages call it."""

    name = "name"

    def __init__(self, kind: str, names: Iterable[str]) -> None:
        self.kind = kind
        self.names = tuple(names)

    def parse(self, text: str, option: str) -> str:
        """Return the name in lower case."""
        if text.lower() not in self.names:
            raise unknown_name(self.kind, text, self.names)
        return text.lower()

    def suggestions(self) -> Iterable[str]:
        return self.names


class NameOrFile(Name):
    """One of a few names, or a file: it exists, or its path contains a dot or a slash."""

    completes_files = True

    def parse(self, text: str, option: str) -> str:
        if "." in text or "/" in text or (text.lower() not in self.names and exists(text)):
            return text
        return super().parse(text, option)


class DynamicRange(_ValueType):
    """A dynamic range: low, medium, high, a number above 1 or 1:NUMBER; with `auto` also auto."""

    name = "range"

    def __init__(self, *, auto: bool = False) -> None:
        self._auto = auto

    def parse(self, text: str, option: str) -> float | str:
        """Return the dynamic range as a number, or "auto"."""
        if self._auto and text.lower() == "auto":
            return "auto"
        if text.lower() in RANGES:
            return RANGES[text.lower()]
        number = text.removeprefix("1:")
        grouped = re.fullmatch(r"[0-9]{1,3}(,[0-9]{3})+(\.[0-9]*)?", number)
        value = _float(number.replace(",", "") if grouped else number)
        if math.isnan(value) and text.lower() != "nan":
            raise unknown_name("dynamic range", text, self.suggestions())
        if not value > 1:
            raise invalid_value(option, text, "the range must be above 1")
        if math.isinf(value):
            raise invalid_value(option, text, "the range must be finite")
        return value

    def suggestions(self) -> Iterable[str]:
        return (*RANGES, "auto") if self._auto else RANGES


class Seconds(_ValueType):
    """A time in seconds, or a fraction such as 1/250; with `auto` also the word auto.

    With `fractions` a typed fraction is a `Fraction`: it is a label of a dial, and 0.004 is not.
    """

    name = "seconds"

    def __init__(self, *, auto: bool = False, least: float = 0, fractions: bool = False) -> None:
        self._auto, self._least, self._fractions = auto, least, fractions
        self.expected = (
            "a time in seconds such as 0.004 or 1/250"
            + (f", at least {least:g}" if least else "")
            + (", or auto" if auto else "")
        )

    def parse(self, text: str, option: str) -> float | Fraction | None:
        """Return the time in s; None for auto."""
        if self._auto and text.lower() == "auto":
            return None
        found = time_of(text)
        if found is not None and (seconds := float(found)) >= self._least:
            return found if self._fractions else seconds
        raise invalid_value(option, text, f"expected {self.expected}")

    def suggestions(self) -> Iterable[str]:
        return ("auto",) if self._auto else ()


class KeyValue(_ValueType):
    """A name and a value with = between them."""

    name = "setting"

    def parse(self, text: str, option: str) -> tuple[str, str]:
        name, equals, value = text.partition("=")
        if not (equals and name.strip()):
            raise invalid_value(option, text, "expected NAME=VALUE such as format=y16")
        return name.strip(), value.strip()


class SettingOf(KeyValue):
    """One of several settings: a name, = and a value; `table` has a field and a type for each."""

    def __init__(self, table: Mapping[str, tuple[str, AnyType]]) -> None:
        self._table = table

    def parse(self, text: str, option: str) -> tuple[str, Any]:
        name, value = super().parse(text, option)
        if name not in self._table:
            raise unknown_name("setting", name, self._table)
        field, kind = self._table[name]
        if isinstance(kind, _ValueType):
            return field, kind.parse(value, f"{option} {name}")
        return field, kind.convert(value, None, None)

    def suggestions(self) -> Iterable[str]:
        return [f"{name}=" for name in self._table]


class Truth(_ValueType):
    """Yes or no."""

    name = "yes or no"

    def parse(self, text: str, option: str) -> bool:
        if text.lower() not in ("yes", "no"):
            raise invalid_value(option, text, "expected yes or no")
        return text.lower() == "yes"


class FrameSize(_ValueType):
    """Width x height in pixels."""

    name = "size"

    def parse(self, text: str, option: str) -> str:
        width, _, height = text.lower().partition("x")
        if not all(re.fullmatch("0{0,9}[1-9][0-9]{0,8}", side) for side in (width, height)):
            raise invalid_value(option, text, "expected WIDTHxHEIGHT such as 640x480")
        return f"{int(width)}x{int(height)}"


class Settings(_ValueType):
    """Values that a camera can be set to: a list, MIN:MAX:STEP, or a file with one per line."""

    name = "settings"

    def __init__(self, expected: str, *, unit: Seconds | Number, file: bool = False) -> None:
        self.expected = expected
        self._unit = unit
        self.completes_files = file

    def parse(self, text: str, option: str) -> tuple[float, ...]:
        """Return the values in the order given; raise `UsageError`, or `DataError` for a file."""
        if self.completes_files and (exists(text) or not {",", ":"} & set(text)):
            return self._read(text)
        parts = text.split(":")
        if len(parts) == 3:
            from camctl.exposure.exposure_choices import stepped

            return tuple(stepped(*(self._value(part.strip(), option) for part in parts)).tolist())
        if len(parts) != 1 or not text.replace(",", " ").split():
            raise invalid_value(option, text, f"expected {self.expected}")
        return tuple(self._value(value, option) for value in _parts(text, option))

    def _value(self, text: str, option: str) -> float:
        value = self._unit.parse(text, option)
        assert value is not None
        return float(value)

    def _read(self, path: str) -> tuple[float, ...]:
        lines = read_input_text(path, "settings file").splitlines()
        texts = [(row, line.partition("#")[0].strip()) for row, line in enumerate(lines, 1)]
        try:
            values = tuple(
                self._value(text, f"line {row} of settings file {path}")
                for row, text in texts
                if text
            )
        except UsageError as error:
            raise DataError(error.what, hint=error.hint) from error
        if not values:
            raise DataError(f"settings file {path} is empty", hint="write one value per line")
        return values


def _parts(text: str, option: str) -> list[str]:
    """Return the texts between commas or blanks; raise `UsageError` where one is missing."""
    parts = re.split(r"\s*,\s*|\s+", text.strip())
    if any(parts) and not all(parts):
        raise invalid_value(option, text, "a value is missing beside a comma")
    return parts if any(parts) else [text]


class ListOf(_ValueType):
    """Several values of one type, separated by commas or blanks."""

    name = "list"

    def __init__(self, item: _ValueType, *, unique: bool = False) -> None:
        self._item = item
        self._unique = unique

    def parse(self, text: str, option: str) -> Any:
        """Return the values as a tuple in the order given, with `unique` each once."""
        values = [self._item.parse(part, option) for part in _parts(text, option)]
        return tuple(dict.fromkeys(values) if self._unique else values)

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        before, comma, last = incomplete.rpartition(",")
        names = [name for name in self._item.suggestions() if name.startswith(last)]
        return [CompletionItem(before + comma + name) for name in names]


class Ratios(ListOf):
    """Exposures relative to each other."""

    name = "ratios"

    def __init__(self) -> None:
        super().__init__(
            Number("numbers from 1e-100 to 1e100, such as 1,2,4", least=1e-100, most=1e100)
        )

    def parse(self, text: str, option: str) -> tuple[float, ...]:
        """Return the exposures, ascending and relative to the smallest."""
        values = sorted(super().parse(text, option))
        return tuple(value / values[0] for value in values)
