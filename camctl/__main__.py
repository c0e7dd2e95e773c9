"""The command ``camctl``, also ``python -m camctl``."""

from __future__ import annotations

import signal
import sys


def run() -> int:
    """Run the command line of this process and return its exit status.

    Control-C before the first and after the last step of the command shows no traceback, either.
    """
    try:
        from camctl.cli import main

        status = main()
    except KeyboardInterrupt:
        status = 130
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    return status


if __name__ == "__main__":
    sys.exit(run())
