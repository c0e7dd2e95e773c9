"""A Python program on a pseudo-terminal: keys in, text of the screen out."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
from collections.abc import Callable, Sequence
from pathlib import Path

HELPERS = Path(__file__).parent
REDRAW = "\x0c"

QUIET_S = 0.1
"""After this time without output, s, the screen is asked for again."""


def program_environment(**more: str) -> dict[str, str]:
    """Return the environment of a program that imports the test helpers."""
    kept = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES")}
    path = os.pathsep.join([str(HELPERS), *filter(None, [os.environ.get("PYTHONPATH")])])
    return {**kept, "PYTHONPATH": path, **more}


class Terminal:
    """A Python program on a pseudo-terminal.

    Waits have no limit of their own: the time-out of the test ends a wait that is in vain.
    """

    def __init__(
        self,
        arguments: Sequence[str],
        columns: int = 80,
        rows: int = 24,
        kind: str = "xterm",
        locale: str = "C.UTF-8",
        *,
        folder: Path = HELPERS,
        ignores_hangup: bool = False,
    ) -> None:
        """Start Python with `arguments`; its standard error is a pipe unless `folder` is left out.

        The terminal is the controlling one, so that closing it sends SIGHUP.
        """
        self.master, self.slave = pty.openpty()
        self.resize(columns, rows)
        self.before = termios.tcgetattr(self.slave)
        self.raw = ""

        def become_foreground() -> None:
            os.setsid()
            fcntl.ioctl(0, termios.TIOCSCTTY, 0)
            if ignores_hangup:
                signal.signal(signal.SIGHUP, signal.SIG_IGN)

        self.process = subprocess.Popen(
            [sys.executable, *arguments],
            stdin=self.slave,
            stdout=self.slave,
            stderr=self.slave if folder is HELPERS else subprocess.PIPE,
            cwd=folder,
            env=program_environment(TERM=kind, LC_ALL=locale),
            preexec_fn=become_foreground,
        )

    def resize(self, columns: int, rows: int) -> None:
        """Set the size; a running program is notified by `notify_resize`."""
        fcntl.ioctl(self.slave, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))

    def notify_resize(self) -> None:
        """Send the signal that a terminal sends when its size has changed."""
        os.kill(self.process.pid, signal.SIGWINCH)

    def type(self, keys: str) -> None:
        """Press keys."""
        os.write(self.master, keys.encode())

    def _read(self, quiet_s: float) -> str:
        """Return the output that comes within `quiet_s`, "" for none."""
        if self.master < 0:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(quiet_s)
            return ""
        if not select.select([self.master], [], [], quiet_s)[0]:
            return ""
        text = os.read(self.master, 65536).decode(errors="replace")
        self.raw += text
        return text

    def wait_until(self, condition: Callable[[str], bool]) -> None:
        """Wait until the text of the screen meets a condition.

        The program is asked to draw the screen, and again whenever it has been quiet.
        """
        while self._read(0):
            pass
        while True:
            self.type(REDRAW)
            drawn = ""
            while text := self._read(QUIET_S):
                drawn += text
                without_codes = re.sub(r"\x1b\[[\d;?]*[A-Za-z]|\x1b[()][A-Z0]", " ", drawn)
                if condition(" ".join(without_codes.split())):
                    return
            assert self.process.poll() is None, f"the program has ended: {self.raw!r}"

    def wait_for(self, *texts: str) -> None:
        """Wait until all `texts` are on the screen."""
        self.wait_until(lambda screen: all(text in screen for text in texts))

    def wait_for_end(self) -> int:
        """Return the exit status once the program has ended and its output is read."""
        while self.process.poll() is None:
            self._read(QUIET_S)
        while self._read(0):
            pass
        return self.process.returncode

    def hang_up(self) -> None:
        """Close the terminal while the program runs."""
        os.close(self.master)
        self.master = -1

    def close(self) -> None:
        """Kill the program and close the terminal."""
        with contextlib.suppress(ProcessLookupError):
            self.process.kill()
        self.process.wait()
        if self.process.stderr is not None:
            self.process.stderr.close()
        if self.master >= 0:
            os.close(self.master)
        os.close(self.slave)
