"""Taking a series: its hook, its keys, its progress and its summary."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

import click

from camctl.cli.capture_output import UNTRUSTWORTHY
from camctl.cli.options import declare, option_group
from camctl.cli.output import (
    ProgressBar,
    format_duration,
    format_fields,
    format_number,
    print_error,
    print_json,
    print_text,
    print_warning,
    progress_bar,
)
from camctl.cli.parameter_types import Seconds, Text
from camctl.errors import CaptureError, UsageError
from camctl.system.interrupts import uninterrupted

if TYPE_CHECKING:
    from camctl.captures.series_sets import Keys, SeriesProgress
    from camctl.interface.camera import Camera
    from camctl.records.journal import SeriesJournal, SetRecord

#: Characters of what a failed hook has printed that are shown, at its end.
_SHOWN = 200


@dataclass(frozen=True)
class HookOptions:
    """The command that is run after each set, and how long it may take."""

    hook: str | None = declare(
        "--hook COMMAND",
        "Shell command to run after each set; $CAMCTL_FOLDER is its folder, $CAMCTL_NUMBER "
        "its number.",
        Text(),
    )
    hook_limit_s: float = declare(
        "--hook-limit SECONDS", "Longest time that the command may take.", Seconds(), default="60"
    )

    def check(self) -> None:
        """Raise `UsageError` where the command is empty."""
        if self.hook is not None and not self.hook.strip():
            raise UsageError("--hook is empty", hint="give a command")


hook_options = option_group(HookOptions, "hook")


def run_series(
    camera: Camera,
    journal: SeriesJournal,
    hook: HookOptions,
    directory: Path,
    *,
    as_json: bool,
) -> None:
    """Take the missing sets of a series, and print how it ended."""
    from camctl.captures.series import Series
    from camctl.captures.series_sets import CameraSets, SeriesTools, date_by

    run = None if hook.hook is None else Hook(hook.hook, hook.hook_limit_s, directory)
    with terminal_keys() as keys, _progress(camera) as progress:
        tools = SeriesTools(
            camera.clock,
            keys=keys,
            hook=run,
            warn=print_warning,
            progress=progress,
            date=date_by(camera.clock),
        )
        Series(directory, journal, CameraSets(camera, journal, date=tools.date), tools).run()
    if as_json:
        counts = {"completed": journal.completed, "failed": len(journal.failed)}
        print_json(journal.model_dump(mode="json") | counts)
    else:
        print_text(_text(journal, directory))
    _exit_status(journal, directory)


class Hook:
    """A shell command that is run after each set.

    Args:
        command: for the shell
        limit_s: longest time that it may take, s
        directory: folder of the series
    """

    def __init__(self, command: str, limit_s: float, directory: Path) -> None:
        self._command, self._limit_s, self._directory = command, limit_s, directory

    def __call__(self, folder: Path, record: SetRecord) -> None:
        """Run the command; raise `CaptureError` where it fails or takes too long."""
        named = {
            "CAMCTL_FOLDER": str(folder.resolve()),
            "CAMCTL_SERIES": str(self._directory.resolve()),
            "CAMCTL_NUMBER": str(record.number),
        }
        with tempfile.TemporaryFile() as output:
            with _process(self._command, {**os.environ, **named}, output.fileno()) as process:
                try:
                    status = process.wait(self._limit_s)
                except subprocess.TimeoutExpired:
                    raise CaptureError(
                        f"the hook was ended after {format_duration(self._limit_s)}",
                        hint="allow more with --hook-limit",
                    ) from None
            if status:
                size = output.seek(0, os.SEEK_END)
                output.seek(max(0, size - _SHOWN))
                said = " ".join(output.read().decode(errors="replace").split())
                raise CaptureError(
                    f"the hook failed with status {status}" + (f": {said}" if said else "")
                )


@contextmanager
def _process(
    command: str, environment: dict[str, str], output: int
) -> Iterator[subprocess.Popen[bytes]]:
    """Run a shell command; at the end of the block it and its children are ended."""
    process = subprocess.Popen(
        command,
        shell=True,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=output,
        stderr=output,
        start_new_session=True,  # Control-C ends it through the finally below, and only once
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            with suppress(ProcessLookupError):
                if hasattr(os, "killpg"):
                    os.killpg(process.pid, signal.SIGKILL)
                else:
                    process.kill()
        process.wait()


@contextmanager
def _progress(camera: Camera) -> Iterator[Callable[[SeriesProgress], None]]:
    """Yield a function that shows the progress of a series in a terminal."""
    with progress_bar("opening") as bar:
        yield _Shown(bar, camera) if bar is not None else lambda _: None


class _Shown:
    """Shows which set a series is at, and when it will end."""

    def __init__(self, bar: ProgressBar, camera: Camera) -> None:
        from camctl.interface.clock import VirtualClock

        self._bar = bar
        self._is_virtual = isinstance(camera.clock, VirtualClock)
        self._began, self._done_before = time.monotonic(), -1

    def __call__(self, progress: SeriesProgress) -> None:
        if self._done_before < 0:
            self._done_before = progress.done
        number = min(progress.done + 1, progress.total or sys.maxsize)
        of = "" if progress.total is None else f" of {progress.total}"
        stage = f"set {number}{of}, {progress.state}"
        if progress.state == "paused":
            stage += ": p goes on, q ends"
        elif (left_s := self._left_s(progress)) is not None:
            end = datetime.now() + timedelta(seconds=left_s)
            stage += f", ends about {end:%H:%M:%S}" + ("" if left_s < 72000 else f" on {end:%d %b}")
        self._bar(progress.done / progress.total if progress.total else 0.0, stage)

    def _left_s(self, progress: SeriesProgress) -> float | None:
        """Return how long the series will last; a virtual clock does not know it."""
        taken = progress.done - self._done_before
        if not self._is_virtual or progress.ends_in_s is None or not taken:
            return progress.ends_in_s if not self._is_virtual else None
        assert progress.total is not None  # its end is known
        return (time.monotonic() - self._began) / taken * (progress.total - progress.done)


def _text(journal: SeriesJournal, directory: Path) -> str:
    """Return the summary of a series."""
    levels = [each.effective_levels for each in journal.sets if each.effective_levels is not None]
    of = "" if journal.options.repeat is None else f" of {journal.options.repeat}"
    rows = [("sets", f"{journal.completed}{of} complete")]
    again = journal.count(lambda each: each.attempts > 1 and each.state == "complete")
    for name, count in (
        ("tried again", again),
        ("failed", len(journal.failed)),
        ("starts left out", journal.skipped),
        ("hooks failed", journal.count(lambda each: each.hook == "failed")),
        ("not trustworthy", journal.count(lambda each: not each.trustworthy)),
    ):
        if count:
            rows.append((name, str(count)))
    if levels:
        rows.append(
            (
                "effective levels",
                f"{format_number(min(levels), 4)} to {format_number(max(levels), 4)}",
            )
        )
    rows += [
        (
            "metered",
            "once, before the first set" if journal.options.meter == "once" else "each set",
        ),
        ("result", str(directory)),
        ("", "index.html"),
        ("", f"{journal.sets[0].folder}/ ..." if journal.sets else "no set was taken"),
    ]
    return format_fields(rows)


def _exit_status(journal: SeriesJournal, directory: Path) -> None:
    """End with status 1 where sets or hooks have failed, else 3 where a set is not trustworthy."""
    problems = []
    if journal.failed:
        names = ", ".join(each.folder for each in journal.failed[:3])
        more = "" if len(journal.failed) <= 3 else " and others"
        problems.append(f"{len(journal.failed)} of {len(journal.sets)} sets failed ({names}{more})")
    if hooks := journal.count(lambda each: each.hook == "failed"):
        problems.append(f"the hook failed after {hooks} of {len(journal.sets)} sets")
    if problems:
        print_error(f"{'; '.join(problems)}; see {directory}/index.html")
        click.get_current_context().exit(CaptureError.exit_status)
    if journal.count(lambda each: not each.trustworthy):
        click.get_current_context().exit(UNTRUSTWORTHY)


class TerminalKeys:
    """Single keys of the terminal on standard input."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def read(self, timeout_s: float) -> str | None:
        """Return the next key; None where none was pressed within `timeout_s`.

        Where the terminal was closed the key is q.
        """
        ready, _, _ = select.select([self._descriptor], [], [], timeout_s)
        if not ready:
            return None
        try:
            data = os.read(self._descriptor, 1)
        except OSError:  # the terminal is gone
            data = b""
        return data.decode("latin-1") if data else "q"


def check_keys(*, needed: bool) -> None:
    """Raise `UsageError` where the keys of a terminal are needed, and there is none."""
    problem = _no_keys() if needed else None
    if problem is not None:
        raise UsageError(f"--on-key needs {problem}", hint="take a series with --repeat N")


@contextmanager
def terminal_keys() -> Iterator[Keys | None]:
    """Yield the keys of the terminal, which gives each of them at once; None without a terminal."""
    if _no_keys() is not None:
        yield None
        return
    import termios
    import tty

    descriptor = sys.stdin.fileno()
    before = termios.tcgetattr(descriptor)

    @uninterrupted
    def restore() -> None:
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)

    try:
        tty.setcbreak(descriptor, termios.TCSANOW)  # Control-C stays a signal
        yield TerminalKeys(descriptor)
    finally:
        restore()


def _no_keys() -> str | None:
    """Return what is missing to read single keys; None where nothing is."""
    if os.name != "posix":
        return "a POSIX system, whose terminal gives single keys"
    if sys.stdin is None or not sys.stdin.isatty():
        return "a terminal on standard input"
    if os.tcgetpgrp(sys.stdin.fileno()) != os.getpgrp():
        return "to run in the foreground of its terminal"
    return None
