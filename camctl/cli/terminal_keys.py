"""The keys of a terminal that control a series."""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from camctl.errors import UsageError
from camctl.system.interrupts import uninterrupted

if TYPE_CHECKING:
    from camctl.captures.series_tools import Keys


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
