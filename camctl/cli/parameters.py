"""The kinds of value that options take; what is off becomes one line that names the option."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from camctl.errors import DataError, UsageError, unknown_name

if TYPE_CHECKING:
    AnyType = click.ParamType[Any]
else:
    AnyType = click.ParamType  # generic only since click 8.3, and only for type checkers

PATH = click.Path(path_type=Path)


class _Kind(AnyType):
    """A kind of value that says which option was off."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the value of the words; anything that is not text is a value already."""
        if not isinstance(value, str):
            return value
        option = param.opts[-1] if param is not None else "value"
        return self.read(value.strip(), option)

    def read(self, word: str, option: str) -> Any:
        """Return the value of `word`; raise `UsageError`."""
        raise NotImplementedError


def _number(word: str, option: str, what: str) -> float:
    try:
        value = float(word)
    except ValueError:
        raise UsageError(f"{option}: '{word}' is not {what}") from None
    if not math.isfinite(value):
        raise UsageError(f"{option}: {word} is not finite", hint=f"give {what}")
    return value


class Number(_Kind):
    """A finite number within bounds."""

    name = "number"

    def __init__(
        self,
        what: str = "a number",
        *,
        above: float = -math.inf,
        least: float = -math.inf,
        below: float = math.inf,
    ) -> None:
        self.what = what
        self._above, self._least, self._below = above, least, below

    def read(self, word: str, option: str) -> float:
        """Return the number."""
        value = _number(word, option, self.what)
        if not (self._above < value < self._below and value >= self._least):
            raise UsageError(f"{option}: {word} is not {self.what}")
        return value


class Whole(_Kind):
    """A whole number within bounds."""

    name = "integer"

    def __init__(self, what: str, *, least: int, most: int | None = None) -> None:
        self.what = what
        self._least, self._most = least, most

    def read(self, word: str, option: str) -> int:
        """Return the number."""
        try:
            value = int(word)
        except ValueError:
            raise UsageError(f"{option}: '{word}' is not {self.what}") from None
        if value < self._least or (self._most is not None and value > self._most):
            raise UsageError(f"{option}: {word} is not {self.what}")
        return value


class Name(_Kind):
    """One of a few names."""

    name = "name"

    def __init__(self, kind: str, names: Iterable[str]) -> None:
        self.kind = kind
        self.names = tuple(names)

    def read(self, word: str, option: str) -> str:
        """Return the name in the letters it is known by."""
        if word.lower() not in self.names:
            raise unknown_name(self.kind, word, self.names)
        return word.lower()


class NameOrFile(Name):
    """One of a few names, or a file: a word with a dot or a slash in it."""

    def read(self, word: str, option: str) -> str:
        """Return the name, or the file as it was given."""
        if "." in word or "/" in word:
            return word
        return super().read(word, option)


class Names(Name):
    """Several of a few names, parted by commas."""

    def read(self, word: str, option: str) -> Any:
        """Return the names as a tuple, each once."""
        words = [part.strip() for part in word.split(",")]
        return tuple(dict.fromkeys(super(Names, self).read(part, option) for part in words))


class Range(_Kind):
    """A dynamic range: low, medium, high, or a number above 1, also written 1:NUMBER."""

    name = "range"

    def read(self, word: str, option: str) -> float:
        """Return the dynamic range as a number."""
        from camctl.response.desired import RANGES

        if word.lower() in RANGES:
            return RANGES[word.lower()]
        digits = word.removeprefix("1:").replace(",", "")
        try:
            value = float(digits)
        except ValueError:
            raise unknown_name("dynamic range", word, RANGES) from None
        if not (math.isfinite(value) and value > 1):
            raise UsageError(
                f"{option}: {word} is no dynamic range",
                hint="brightest over darkest, a finite number above 1",
            )
        return value


class Ranges(Range):
    """Several dynamic ranges, parted by commas."""

    def read(self, word: str, option: str) -> Any:
        """Return the dynamic ranges as a tuple, each once."""
        words = word.split(",")
        return tuple(dict.fromkeys(super(Ranges, self).read(w.strip(), option) for w in words))


class Ratios(_Kind):
    """Exposures relative to one another."""

    name = "ratios"

    def read(self, word: str, option: str) -> tuple[float, ...]:
        """Return the exposures, ascending and relative to the smallest."""
        values = []
        for part in word.replace(",", " ").split():
            value = _number(part, option, "a number")
            if value <= 0:
                raise UsageError(f"{option}: exposure {part} is not positive")
            values.append(value)
        if not values:
            raise UsageError(f"{option}: no exposures", hint="for example --ratios 1,2,4")
        return tuple(value / min(values) for value in sorted(values))


class Seconds(_Kind):
    """A shutter time: seconds, or a fraction as on a dial; optionally `auto` for none."""

    name = "seconds"

    def __init__(self, *, auto: bool = False) -> None:
        self._auto = auto

    def read(self, word: str, option: str) -> float | None:
        """Return the time in s; None for auto."""
        if self._auto and word.lower() == "auto":
            return None
        what = "a time in seconds such as 0.004 or 1/250" + (", or auto" if self._auto else "")
        above, _, under = word.partition("/")
        value = _number(above, option, what)
        if under:
            divisor = _number(under, option, what)
            value = value / divisor if divisor > 0 else -1.0
        if value <= 0:
            raise UsageError(f"{option}: {word} is not {what}")
        return value


class Word(_Kind):
    """A name and a value with = between them."""

    name = "word"

    def read(self, word: str, option: str) -> tuple[str, str]:
        """Return the name and the value, both as they were given."""
        name, equals, value = word.partition("=")
        if not (equals and name.strip()):
            raise UsageError(
                f"{option}: '{word}' is not NAME=VALUE", hint=f"for example {option} format=y16"
            )
        return name.strip(), value.strip()


class Size(_Kind):
    """Width x height."""

    name = "size"

    def read(self, word: str, option: str) -> str:
        """Return the size as WxH."""
        width, _, height = word.lower().partition("x")
        if not (width.isdecimal() and height.isdecimal() and int(width) and int(height)):
            raise UsageError(f"{option}: '{word}' is no size", hint="for example --size 640x480")
        return f"{int(width)}x{int(height)}"


class Settings(_Kind):
    """What a control can be set to: a list, even steps, or a file with one value a line."""

    name = "settings"

    def __init__(self, what: str, *, unit: Seconds | Number, file: bool = False) -> None:
        self.what = what
        self._unit = unit
        self._file = file

    def read(self, word: str, option: str) -> tuple[float, ...]:
        """Return the values in the order given; raise `UsageError`, or `DataError` for a file."""
        if self._file and (Path(word).exists() or not {",", ":"} & set(word)):
            return self._in_file(word)
        parts = word.split(":")
        if len(parts) == 3:
            from camctl.exposure.grid_search import stepped

            return tuple(stepped(*(self._one(part.strip(), option) for part in parts)).tolist())
        if len(parts) != 1:
            raise UsageError(f"{option}: '{word}' is not {self.what}")
        values = tuple(self._one(part, option) for part in word.replace(",", " ").split())
        if not values:
            raise UsageError(f"{option}: '{word}' is not {self.what}")
        return values

    def _one(self, word: str, where: str) -> float:
        value = self._unit.read(word, where)
        assert value is not None
        return value

    def _in_file(self, word: str) -> tuple[float, ...]:
        try:
            lines = Path(word).read_text(encoding="utf-8").splitlines()
        except (OSError, UnicodeDecodeError) as error:
            why = getattr(error, "strerror", None) or "not a text file"
            raise DataError(f"settings {word}: {why}") from error
        texts = [(row, line.partition("#")[0].strip()) for row, line in enumerate(lines, 1)]
        times = tuple(
            self._one(text, f"settings {word}, line {row}") for row, text in texts if text
        )
        if not times:
            raise DataError(f"settings {word}: no times in it", hint="write one a line")
        return times


class Coefficients(_Kind):
    """Weights of the components of a response model."""

    name = "coefficients"

    def read(self, word: str, option: str) -> tuple[float, ...]:
        """Return the weights, as many as are named."""
        parts = word.replace(",", " ").split()
        if not parts:
            raise UsageError(f"{option}: no numbers", hint=f"for example {option} 1.5,-0.3")
        return tuple(_number(part, option, "a number") for part in parts)
