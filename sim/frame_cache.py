"""What is the same in every frame of a camera: kept, up to a number of bytes."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable
from typing import Any, TypeVar

from numpy.typing import NDArray

CACHE_BYTES = 1 << 28
"""Bytes that one camera keeps at most: light, PRNU and DSNU of a grey frame of 22 megapixels."""

_Arrays = TypeVar("_Arrays", bound=tuple[NDArray[Any], ...])


class FrameCache:
    """Keeps arrays by a key until `most_bytes` are used, and none after that.

    What is not kept is computed again, with the same result.  Several threads may use it at the
    same time.
    """

    def __init__(self, most_bytes: int) -> None:
        self._most_bytes = most_bytes
        self._kept: dict[Hashable, Any] = {}
        self._lock = threading.Lock()
        self.used_bytes = 0

    def get(self, key: Hashable, make: Callable[[], _Arrays]) -> _Arrays:
        """Return the arrays of `key`, which `make` computes if they are not kept; do not write."""
        kept: _Arrays | None = self._kept.get(key)
        if kept is not None:
            return kept
        made = make()
        size = sum(array.nbytes for array in made)
        with self._lock:
            if key not in self._kept and self.used_bytes + size <= self._most_bytes:
                self._kept[key] = made
                self.used_bytes += size
        return made
