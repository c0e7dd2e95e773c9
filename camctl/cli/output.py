"""What commands print: text or one JSON value on standard output, progress on standard error."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
    from camctl.profile import DelayRecord


class ClosedOutputError(Exception):
    """The reader of standard output has closed it, as `head` does after its last line."""


def print_text(text: str) -> None:
    """Write `text` and a line end to standard output."""
    try:
        sys.stdout.write(text + "\n")
        sys.stdout.flush()
    except BrokenPipeError as error:
        raise ClosedOutputError from error


def print_warning(text: str) -> None:
    """Write one line of warning to standard error."""
    sys.stderr.write(f"camctl: warning: {text}\n")


def print_json(value: object) -> None:
    """Write one JSON value to standard output; NaN and infinity become null."""
    print_text(json.dumps(to_json(value), indent=2, allow_nan=False, ensure_ascii=False))


def to_json(value: Any) -> Any:
    """Return `value` as dicts, lists, strings, finite numbers, booleans and None."""
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): to_json(item) for key, item in value.items()}
    if isinstance(value, Iterable):
        return [to_json(item) for item in value]
    if hasattr(value, "item"):  # a numpy scalar
        return to_json(value.item())
    return str(value)


def format_number(value: float, digits: int = 6) -> str:
    """Return `value` with `digits` significant digits, in powers of ten only from 10^9 on."""
    if not math.isfinite(value):
        return str(value)
    if value == 0:
        return "0"
    places = digits - 1 - math.floor(math.log10(abs(value)))
    if abs(value) >= 1e9 or abs(value) < 1e-4:
        return f"{value:.{digits}g}"
    text = f"{value:.{max(places, 0)}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def format_duration(seconds: float) -> str:
    """Return a time in s, ms or us, such as 12.5 ms."""
    if seconds >= 1:
        return f"{format_number(seconds, 4)} s"
    if seconds >= 1e-3:
        return f"{format_number(seconds * 1e3, 4)} ms"
    return f"{format_number(seconds * 1e6, 4)} us"


def format_range(dynamic_range: float) -> str:
    """Return a dynamic range such as 1:1,000."""
    is_whole = float(dynamic_range).is_integer()
    return f"1:{dynamic_range:,.0f}" if is_whole else f"1:{dynamic_range:,g}"


def format_percent(fraction: float) -> str:
    """Return a fraction as a percentage; a small positive one is never shown as zero."""
    if 0 < fraction < 0.0001:
        return "< 0.01 %"
    return f"{fraction * 100:.2f} %" if fraction < 0.1 else f"{fraction * 100:.1f} %"


def format_request(response: str, dynamic_range: float, count: int) -> str:
    """Return a desired response such as: log, 1:1,000, in 3 exposures."""
    plural = "s" if count != 1 else ""
    return f"{response}, {format_range(dynamic_range)}, in {count} exposure{plural}"


def format_objective(xi: float, levels_wanted: float, *, counts_levels: bool) -> tuple[str, str]:
    """Return name and value of the objective, which is a number of levels only where it counts."""
    if counts_levels:
        return "missing levels (xi)", f"{format_number(xi, 5)} of {format_number(levels_wanted)}"
    return "objective", f"{format_number(xi)} for {format_number(levels_wanted)} desired levels"


def format_delay(record: DelayRecord) -> str:
    """Return a control delay such as: 2 frames; or: 1 to 3 frames, not constant."""
    if record.frames is None:
        return f"{record.smallest} to {record.largest} frames, not constant"
    return f"{record.frames} frame{'' if record.frames == 1 else 's'}"


def format_fields(rows: Sequence[tuple[str, str]]) -> str:
    """Return one `name  value` line per row, with the values in one column."""
    width = max(len(name) for name, _ in rows)
    return "\n".join(f"{name:<{width}}  {value}".rstrip() for name, value in rows)


def format_table(
    headings: Sequence[str], rows: Sequence[Sequence[str]], *, right_aligned: Iterable[int] = ()
) -> str:
    """Return a table of text; columns are left-aligned except those in `right_aligned`."""
    right = set(right_aligned)
    lines = [list(headings), *[list(row) for row in rows]]
    widths = [max(len(line[column]) for line in lines) for column in range(len(headings))]
    return "\n".join(
        "  ".join(
            f"{cell:>{width}}" if column in right else f"{cell:<{width}}"
            for column, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )


ProgressBar: TypeAlias = Callable[[float, str], None]
"""Shows a completed fraction, 0 to 1, and the current stage of the work."""


@contextmanager
def progress_bar(label: str) -> Iterator[ProgressBar | None]:
    """Show a progress bar while the block runs; yield None if standard error is no terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeRemainingColumn,
    )

    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeRemainingColumn(elapsed_when_finished=True),
        console=Console(stderr=True),
        transient=True,
    ) as bar:
        task = bar.add_task(label, total=1.0)
        yield lambda fraction, stage: bar.update(
            task, completed=fraction, description=stage or label
        )


def without_stage(bar: ProgressBar | None) -> Callable[[float], None] | None:
    """Return a callback for work that reports its completed fraction alone."""
    return None if bar is None else lambda fraction: bar(fraction, "")
