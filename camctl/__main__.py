"""The command ``camctl``, also ``python -m camctl``.

What is imported here is loaded already when Python starts: nothing takes time before the signals
are handled.
"""

from __future__ import annotations

import _signal  # type: ignore[import-not-found]  # `signal` takes 4 ms to be loaded
import atexit
import gc
import os
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType
    from typing import Any, NoReturn

#: Number of a signal: its name.  Windows has no SIGHUP.
_SIGNALS = {
    getattr(_signal, name): name
    for name in ("SIGINT", "SIGTERM", "SIGHUP")
    if hasattr(_signal, name)
}


def _end(number: int, _frame: FrameType | None) -> NoReturn:
    """End the process where the command line cannot: it is not loaded yet, or does not exit."""
    by = f" by {_SIGNALS[number]}" if number != _signal.SIGINT else ""
    try:
        os.write(2, f"camctl: interrupted{by}\n".encode())
    finally:  # also where standard error is closed
        os._exit(128 + number)


def _ignore_once(number: int, _frame: FrameType | None) -> None:
    """Ignore a signal after the command's last step; a second one ends what does not exit."""
    _signal.signal(number, _end)


def _handle_all(handler: Callable[[int, FrameType | None], Any] | int) -> None:
    """Handle the signals by `handler`; those that the parent ignores stay ignored."""
    for number in _SIGNALS:
        if _signal.getsignal(number) not in (_signal.SIG_IGN, None):
            _signal.signal(number, handler)


def settle() -> None:
    """Settle how libraries work in this process: what the command does itself takes less time."""
    # The products of OpenBLAS are small, and its threads wait for one another in busy loops: where
    # other work has the processors, a merge takes 1.7 times the processor time with them.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Pydantic would look for plugins in the files of all installed packages.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    # Searches for unused objects, each few hundred new ones, take a thirtieth of a capture, and
    # without any a series or a live view takes no more memory.  Loading libraries makes 100,000.
    gc.set_threshold(200_000)


def run() -> int:
    """Run the command line of this process and return its exit status.

    A signal before the first step of the command ends it with one line and the status that signals
    have later, too; one after its last step changes nothing.
    """
    _handle_all(_end)
    settle()
    # What is registered first is called last.  The interpreter then takes a few milliseconds to
    # end, with the default action for signals that were handled by a function.
    atexit.register(_handle_all, _signal.SIG_IGN)
    from camctl.cli import main

    status = main(handler_afterwards=_ignore_once)
    _handle_all(_ignore_once)
    # The memory of the process is returned whole: looking for what is not used any more, module by
    # module, takes 0.09 s of processor time after a capture.
    gc.freeze()
    return status


if __name__ == "__main__":
    sys.exit(run())
