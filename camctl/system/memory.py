"""Memory that is free within the process: shared by its threads, and returned to the system.

All is for the GNU C library; others have no such functions, and nothing is done.
"""

from __future__ import annotations

import ctypes
from contextlib import suppress

#: `M_ARENA_MAX`, `M_MMAP_MAX`, `M_MMAP_THRESHOLD` and `M_TRIM_THRESHOLD` of malloc.h.
_MOST_POOLS, _MOST_MAPPED, _LEAST_MAPPED, _LEAST_RETURNED = -8, -4, -3, -1


def use_little_memory() -> None:
    """Keep little memory that is free, for a process that mostly waits.

    One heap for all threads; an array from 128 kB up goes back to the system as soon as it is free,
    which is the C library's own threshold that it would raise.  Takes effect where it is called
    before threads are started.
    """
    with suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).mallopt(_LEAST_MAPPED, 1 << 17)
    share_free_memory()


def share_free_memory() -> None:
    """Let threads that begin from now on use what others have freed.

    Otherwise each has a pool of its own, which keeps what it has freed.  Large blocks stay in the
    pool, too, until `return_free_memory`: the system takes longer to give a new one than a picture
    takes to be computed in it.
    """
    with suppress(AttributeError, OSError, TypeError):
        library = ctypes.CDLL(None)
        library.mallopt(_MOST_POOLS, 1)
        library.mallopt(_MOST_MAPPED, 0)
        library.mallopt(_LEAST_RETURNED, 1 << 30)


def return_free_memory() -> None:
    """Return what the process has freed to the system.

    Several large steps of work would take the sum of their memory, and not the largest.
    """
    with suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)
