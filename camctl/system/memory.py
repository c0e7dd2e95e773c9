"""Memory that is free within the process: shared by its threads, and returned to the system.

Both are for the GNU C library; others have no such functions, and nothing is done.
"""

from __future__ import annotations

import ctypes
from contextlib import suppress

#: `M_ARENA_MAX`, `M_MMAP_MAX` and `M_TRIM_THRESHOLD` of malloc.h.
_MOST_POOLS, _MOST_MAPPED, _LEAST_RETURNED = -8, -4, -1


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
