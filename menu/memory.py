"""Little memory for a process that mostly waits, where the C library can do it."""

from __future__ import annotations

import ctypes
import os
from contextlib import suppress

from camctl.system.memory import share_free_memory

_M_MMAP_THRESHOLD = -3
"""Parameter of mallopt(3) of the C library of GNU."""

_LARGE_BYTES = 1 << 17
"""From how many bytes an array goes back to the system as soon as it is free: the library's own
threshold, which it would raise."""


def use_little_memory() -> None:
    """Keep little memory that is free: one heap for all threads, and none for OpenBLAS's threads.

    Takes effect where it is called before numpy is imported and before threads are started.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).mallopt(_M_MMAP_THRESHOLD, _LARGE_BYTES)
    share_free_memory()
