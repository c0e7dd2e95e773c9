"""What goes to standard output: plain aligned text, or exactly one JSON value."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import Any


class ClosedOutputError(Exception):
    """Whoever read our output has gone, as `head` does once it has its lines."""


def say(text: str) -> None:
    """Write lines to standard output."""
    try:
        sys.stdout.write(text + "\n")
        sys.stdout.flush()
    except BrokenPipeError as error:
        raise ClosedOutputError from error


def warn(text: str) -> None:
    """Write one line of warning to standard error."""
    sys.stderr.write(f"camctl: warning: {text}\n")


def say_json(value: object) -> None:
    """Write one JSON value; what JSON has no word for (NaN, infinity) becomes null."""
    say(json.dumps(plain(value), indent=2, allow_nan=False, ensure_ascii=False))


def plain(value: Any) -> Any:
    """Return `value` as dicts, lists, strings, finite numbers, booleans and None."""
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, Iterable):
        return [plain(item) for item in value]
    if hasattr(value, "item"):  # a numpy scalar
        return plain(value.item())
    return str(value)


def number(value: float, digits: int = 6) -> str:
    """Return `value` with `digits` significant digits, never in powers of ten below 10^9."""
    if not math.isfinite(value):
        return str(value)
    if value == 0:
        return "0"
    places = digits - 1 - math.floor(math.log10(abs(value)))
    if abs(value) >= 1e9 or abs(value) < 1e-4:
        return f"{value:.{digits}g}"
    text = f"{value:.{max(places, 0)}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def duration(seconds: float) -> str:
    """Return a time as a person says it: 1/250 s, 12.5 ms, 3.2 s."""
    if seconds >= 1:
        return f"{number(seconds, 4)} s"
    if seconds >= 1e-3:
        return f"{number(seconds * 1e3, 4)} ms"
    return f"{number(seconds * 1e6, 4)} us"


def range_name(dynamic_range: float) -> str:
    """Return a dynamic range as 1:1,000."""
    whole = float(dynamic_range).is_integer()
    return f"1:{dynamic_range:,.0f}" if whole else f"1:{dynamic_range:,g}"


def fields(rows: Sequence[tuple[str, str]]) -> str:
    """Return `name  value` lines with the values below each other."""
    width = max(len(name) for name, _ in rows)
    return "\n".join(f"{name:<{width}}  {value}".rstrip() for name, value in rows)


def table(heads: Sequence[str], rows: Sequence[Sequence[str]], *, right: Iterable[int] = ()) -> str:
    """Return a table of text; columns in `right` are flush right."""
    flush_right = set(right)
    lines = [list(heads), *[list(row) for row in rows]]
    widths = [max(len(line[column]) for line in lines) for column in range(len(heads))]
    return "\n".join(
        "  ".join(
            f"{cell:>{width}}" if column in flush_right else f"{cell:<{width}}"
            for column, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )
