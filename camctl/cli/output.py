"""What goes to standard output: plain aligned text, or exactly one JSON value."""

from __future__ import annotations

import json
import math
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeAlias


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


if TYPE_CHECKING:
    from camctl.captures.sequencer import Progress as CaptureProgress

Tick: TypeAlias = Callable[[float, str], None]
"""Takes the share that is done, 0 to 1, and what is being done now."""


@contextmanager
def progress_bar(what: str) -> Iterator[Tick | None]:
    """Show a bar with the time left while the block runs; yield None where nobody looks."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn
    from rich.progress import TimeRemainingColumn as TimeLeftColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn())
    with Progress(
        *columns,
        TimeLeftColumn(elapsed_when_finished=True),
        console=Console(stderr=True),
        transient=True,
    ) as bar:
        task = bar.add_task(what, total=1.0)
        yield lambda share, now: bar.update(task, completed=share, description=now or what)


def share_only(tick: Tick | None) -> Callable[[float], None] | None:
    """Return `tick` for work that knows only the share that is done."""
    return None if tick is None else lambda share: tick(share, "")


@contextmanager
def capture_progress() -> Iterator[Callable[[CaptureProgress], None] | None]:
    """Show how far a capture is while the block runs; yield None where nobody looks."""
    with progress_bar("opening") as tick:
        if tick is None:
            yield None
            return
        show = tick
        yield lambda now: show(now.share, now.stage)


def share_of_time(done: int, each: int, count: int) -> float:
    """Return the share of the work in the first `done` rows: `each` rows a number, most first."""
    from camctl.exposure.solver import EVALUATIONS, MAX_EVALUATIONS

    work = [0.0] + [n * EVALUATIONS.get(n, MAX_EVALUATIONS) for n in range(2, count + 1)]
    spent = sum(
        weight * min(max(done - each * place, 0), each)
        for place, weight in enumerate(reversed(work))
    )
    return spent / (sum(work) * each) if count > 1 else done / each


@contextmanager
def executor_of(workers: int) -> Iterator[Executor | None]:
    """Yield processes to work with; None for one worker, which is this one."""
    if workers == 1:
        yield None
        return
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor

    pool = ProcessPoolExecutor(
        workers,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=signal.signal,
        initargs=(signal.SIGINT, signal.SIG_IGN),  # Control-C is for us to answer
    )
    try:
        yield pool
    except BaseException:
        for child in multiprocessing.active_children():
            child.terminate()  # a row can take a long while, and nobody waits for it
        pool.shutdown(cancel_futures=True)
        raise
    pool.shutdown()
