"""What commands print: text or one JSON value on standard output, progress on standard error.

Names in it come from files, cameras and arguments, and may hold characters that command a terminal
(escape sequences) or turn the text around them (U+202E): see `camctl.errors.visible`.
"""

from __future__ import annotations

import dataclasses
import io
import json
import math
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, Protocol, TextIO, TypeAlias, cast

from camctl.errors import StorageError, visible
from camctl.system.number_text import range_text

if TYPE_CHECKING:
    from camctl.findings import Finding
    from camctl.interface.camera import CameraInfo
    from camctl.profiles.profile import DelayRecord


NOISE_UNKNOWN = "noise unknown: quantisation only"
"""Stands beside effective levels of a camera whose noise is not known."""


class ClosedOutputError(Exception):
    """The reader of standard output has closed it, as `head` does after its last line."""


@contextmanager
def standard_streams() -> Iterator[None]:
    """Let commands run without a standard input, output or error that they can use.

    One that is closed is replaced by the null device: else the next file that is opened would have
    its number, and text that libraries print would be written into it.  Text that cannot be written
    to standard error is dropped; `print_text` reports what standard output does not take.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest free number
    before: TextIO | None = sys.stderr
    stream = before if before is not None else open(os.devnull, "w")  # noqa: PTH123, SIM115 - stays
    sys.stderr = cast(TextIO, _UnfailingStream(stream))
    try:
        yield
    finally:
        sys.stderr = stream


class _UnfailingStream:
    """A text stream that drops what it cannot write."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        with self._dropping():
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with self._dropping():
            self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    @contextmanager
    def _dropping(self) -> Iterator[None]:
        try:
            yield
        except OSError:
            discard(self._stream)


def discard(stream: TextIO) -> None:
    """Point a stream at the null device, so that the interpreter can flush it when it ends."""
    with suppress(io.UnsupportedOperation):  # of a stream in memory nothing is flushed
        descriptor = stream.fileno()
        os.dup2(os.open(os.devnull, os.O_WRONLY), descriptor)


def print_text(text: str) -> None:
    """Write `text`, of one or several lines, and a line end to standard output.

    Raises:
        ClosedOutputError: its reader has closed it
        StorageError: it cannot be written
    """
    _write("\n".join(map(visible, text.split("\n"))))


def _write(text: str) -> None:
    stream: TextIO | None = sys.stdout
    if stream is None:
        raise _output_error("it is closed")
    try:
        encoding = stream.encoding or "utf-8"  # a stream in memory has none
        stream.write(text.encode(encoding, "backslashreplace").decode(encoding))
        stream.write("\n")
        stream.flush()
    except OSError as error:
        discard(stream)
        if isinstance(error, BrokenPipeError):
            raise ClosedOutputError from error
        raise _output_error((error.strerror or str(error)).lower()) from error


def _output_error(reason: str) -> StorageError:
    return StorageError(
        f"cannot write to standard output: {reason}", hint="redirect it to a file or to /dev/null"
    )


def print_error(text: str) -> None:
    """Write one line to standard error."""
    sys.stderr.write(f"camctl: {visible(text)}\n")


def print_warning(text: str) -> None:
    """Write one line of warning to standard error."""
    print_error(f"warning: {text}")


def print_finding(finding: Finding) -> None:
    """Write one line of warning to standard error: what was found, and the options that help."""
    from camctl.messages.command_line import finding_line  # loads pydantic

    print_warning(finding_line(finding))


@contextmanager
def logged_warnings() -> Iterator[None]:
    """Print what the packages of camctl log while the block runs, one line each."""
    import logging  # help pages do not need it

    def emit(record: logging.LogRecord) -> None:
        report = print_error if record.levelno < logging.WARNING else print_warning
        report(record.getMessage())

    handler = logging.Handler(logging.INFO)
    handler.emit = emit  # type: ignore[method-assign]
    logger = logging.getLogger("camctl")
    level = logger.level
    logger.setLevel(logging.INFO)
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)


FORMAT_VERSION = 1
"""Of the JSON objects that have no version of their own; see `camctl.cli.schema.types`."""


def print_json(value: object) -> None:
    """Write one JSON value to standard output; NaN and infinity become null.

    An object gets a version of its format where it has none.
    """
    value = to_json(value)
    if isinstance(value, dict) and not {"format_version", "$schema"} & set(value):
        value = {"format_version": FORMAT_VERSION, **value}
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    is_unicode = encoding.lower() in ("utf-8", "utf8")
    text = json.dumps(value, indent=2, allow_nan=False, ensure_ascii=not is_unicode)
    _write("\n".join(map(_visible_json, text.split("\n"))))


def _visible_json(line: str) -> str:
    """Return a line of JSON with escapes for a lone surrogate, U+202E and others."""
    if line.isprintable():
        return line
    return "".join(each if each.isprintable() else json.dumps(each)[1:-1] for each in line)


def to_json(value: Any) -> Any:
    """Return `value` as dicts, lists, strings, finite numbers, booleans and None.

    A dataclass is the dict of its fields, and so is a pydantic model.
    """
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {each.name: to_json(getattr(value, each.name)) for each in dataclasses.fields(value)}
    if hasattr(value, "model_dump"):
        return to_json(value.model_dump(mode="json"))
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


def camera_text(camera: CameraInfo) -> str:
    """Return what a camera is called, and its id if that is another name."""
    return camera.name if camera.name == camera.id else f"{camera.name} ({camera.id})"


def format_duration(seconds: float) -> str:
    """Return a time in s, ms or us, such as 12.5 ms."""
    if seconds >= 1:
        return f"{format_number(seconds, 4)} s"
    if seconds >= 1e-3:
        return f"{format_number(seconds * 1e3, 4)} ms"
    return f"{format_number(seconds * 1e6, 4)} us"


def format_percent(fraction: float) -> str:
    """Return a fraction as a percentage; a small positive one is never shown as zero."""
    if 0 < fraction < 0.0001:
        return "< 0.01 %"
    return f"{fraction * 100:.2f} %" if fraction < 0.1 else f"{fraction * 100:.1f} %"


def format_request(response: str, dynamic_range: float, count: int) -> str:
    """Return a desired response such as: log, 1:1,000, in 3 exposures."""
    plural = "s" if count != 1 else ""
    return f"{response}, {range_text(dynamic_range)}, in {count} exposure{plural}"


def format_objective(xi: float, levels_wanted: float, *, counts_levels: bool) -> tuple[str, str]:
    """Return name and value of the objective, which is a number of levels only where it counts."""
    if counts_levels:
        return "missing levels (xi)", f"{format_number(xi, 5)} of {format_number(levels_wanted)}"
    return "objective", f"{format_number(xi)} for {format_number(levels_wanted)} desired levels"


class _Rated(Protocol):
    """What has effective levels with noise and without."""

    @property
    def effective_levels(self) -> float: ...
    @property
    def effective_levels_noise_free(self) -> float | None: ...


def format_effective(quality: _Rated, *, noise_known: bool) -> str:
    """Return effective levels with what they count: noise where it is known."""
    levels, noise_free = quality.effective_levels, quality.effective_levels_noise_free
    if not noise_known or noise_free is None:
        return f"{format_number(levels, 4)}, {NOISE_UNKNOWN}"
    return f"{format_number(levels, 4)} with noise, {format_number(noise_free, 4)} without"


def format_delay(record: DelayRecord) -> str:
    """Return a control delay such as: 2 frames; or: 1 to 3 frames, not constant."""
    if record.frames is None:
        return f"{record.smallest} to {record.largest} frames, not constant"
    return f"{record.frames} frame{'' if record.frames == 1 else 's'}"


def format_fields(rows: Sequence[tuple[str, str]]) -> str:
    """Return one `name  value` line per row, with the values in one column."""
    width = max(len(name) for name, _ in rows)
    return "\n".join(f"{name:<{width}}  {visible(value)}".rstrip() for name, value in rows)


def format_table(
    headings: Sequence[str], rows: Sequence[Sequence[str]], *, right_aligned: Iterable[int] = ()
) -> str:
    """Return a table of text; columns are left-aligned except those in `right_aligned`."""
    right = set(right_aligned)
    lines = [list(headings), *[list(map(visible, row)) for row in rows]]
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
