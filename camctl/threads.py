"""Work on the parts of a picture, shared by two threads."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import islice
from typing import TypeVar

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

THREADS = 2
"""Threads: a small device has at least so many cores, and each part in work needs memory."""


def in_threads(function: Callable[[_Item], _Result], items: Iterable[_Item]) -> Iterator[_Result]:
    """Yield `function` of each item, in their order; `THREADS` results are made ahead.

    >>> list(in_threads(abs, [-3, 2, -1]))
    [3, 2, 1]
    """
    rest = iter(items)
    with ThreadPoolExecutor(THREADS) as threads:
        ahead = deque(threads.submit(function, item) for item in islice(rest, THREADS))
        while ahead:
            result = ahead.popleft().result()
            ahead.extend(threads.submit(function, item) for item in islice(rest, 1))
            yield result
