"""The options of `camctl shoot` for a series, and the keys that control one."""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import click

from camctl.cli.options import option_group
from camctl.cli.parameter_types import Seconds, Text, WholeNumber
from camctl.errors import UsageError
from camctl.system.interrupts import uninterrupted

if TYPE_CHECKING:
    from camctl.captures.series_tools import Keys
    from camctl.records.journal import SeriesOptions

_MOST_SETS = 100_000  # `series_journal.MOST_SETS`, which imports numpy
_HOOK_LIMIT_S = 60.0


@dataclass(frozen=True)
class SeriesRequest:
    """The options for a series; none of them is given for a single capture."""

    repeat: int | None
    interval_s: float | None
    on_key: bool
    name: str | None
    hook: str | None
    hook_limit_s: float

    @property
    def is_series(self) -> bool:
        """Whether the options ask for a series."""
        return self.repeat is not None or self.on_key

    def options(self, metering: str | None) -> SeriesOptions:
        """Return the options as the journal of a series keeps them.

        Raises:
            UsageError: the name pattern is invalid, or two options contradict each other
        """
        from camctl.records.journal import PATTERN, SeriesOptions, check_pattern

        if self.on_key and self.interval_s is not None:
            raise UsageError(
                "--on-key cannot be combined with --interval", hint="leave one of them out"
            )
        return SeriesOptions(
            repeat=self.repeat,
            interval_s=self.interval_s,
            on_key=self.on_key,
            name=check_pattern(PATTERN if self.name is None else self.name),
            meter="each" if metering == "each" else "once",
        )

    def check(self, metering: str | None, *, is_resumed: bool) -> None:
        """Raise `UsageError` where an option for a series is given without one.

        One that `is_resumed` has its options, but for the hook.
        """
        for option, value in (
            ("--interval", self.interval_s),
            ("--name", self.name),
            ("--hook", None if is_resumed else self.hook),
            ("--meter each", metering == "each" or None),
        ):
            if value is not None and not self.is_series:
                raise UsageError(
                    f"{option} belongs to a series", hint="say how many sets with --repeat N"
                )
        if self.hook is not None and not self.hook.strip():
            raise UsageError("--hook is empty", hint="give a command")


series_options = option_group(
    SeriesRequest,
    "series",
    click.option(
        "--repeat",
        type=WholeNumber(least=1, most=_MOST_SETS),
        metavar="N",
        help="Take a series of N such pictures, each in a folder of its own, with a page of all "
        "of them (index.html).  In a terminal p pauses it and q ends it.",
    ),
    click.option(
        "--interval",
        "interval_s",
        type=Seconds(),
        metavar="SECONDS",
        help="Time from the start of one set to the start of the next; a start that has passed "
        "because the set before took longer is left out.  [default: one set after another]",
    ),
    click.option(
        "--on-key",
        is_flag=True,
        help="Take a set whenever enter or space is pressed, until q is (or N are taken).",
    ),
    click.option(
        "--name",
        type=Text(),
        metavar="PATTERN",
        help="Names of the sets' folders, with {number}, {date} and {time}; a name that is taken "
        "gets -{number} at its end.  "
        "[default: set-{number}]",
    ),
    click.option(
        "--hook",
        type=Text(),
        metavar="COMMAND",
        help="Shell command to run after each set; $CAMCTL_FOLDER is its folder, $CAMCTL_NUMBER "
        "its number.",
    ),
    click.option(
        "--hook-limit",
        "hook_limit_s",
        type=Seconds(),
        metavar="SECONDS",
        default=f"{_HOOK_LIMIT_S:g}",
        help="Longest time that the command may take.",
    ),
)


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
