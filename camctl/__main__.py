"""The command ``camctl``, also ``python -m camctl``."""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType
from typing import NoReturn

_SIGNALS = [name for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


def _end(number: int, _frame: FrameType | None) -> NoReturn:
    """End the process before the command line is there to do it: nothing has been begun yet."""
    by = "" if number == signal.SIGINT else f" by {signal.Signals(number).name}"
    os.write(2, f"camctl: interrupted{by}\n".encode())
    os._exit(128 + number)


def _handle_all(handler: signal.Handlers | None = None) -> None:
    """Handle the signals by `handler`, None: by `_end`; those that the parent ignores stay so."""
    for name in _SIGNALS:
        number = getattr(signal, name)
        if signal.getsignal(number) not in (signal.SIG_IGN, None):
            signal.signal(number, _end if handler is None else handler)


def run() -> int:
    """Run the command line of this process and return its exit status.

    A signal before the first step of the command ends it with one line and the status that signals
    have later, too; one after its last step shows no traceback.
    """
    _handle_all()
    try:
        from camctl.cli import main

        status = main()
    except KeyboardInterrupt:
        status = 130
    _handle_all(signal.SIG_DFL)
    return status


if __name__ == "__main__":
    sys.exit(run())
