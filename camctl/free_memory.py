"""Memory that is free within the process, returned to the system."""

from __future__ import annotations

import ctypes
from contextlib import suppress


def return_free_memory() -> None:
    """Return what the process has freed to the system, where its C library keeps that.

    The GNU library does, for each thread: several large steps of work would take the sum of their
    memory, and not the largest.
    """
    with suppress(AttributeError, OSError, TypeError):  # other libraries have no such function
        ctypes.CDLL(None).malloc_trim(0)
