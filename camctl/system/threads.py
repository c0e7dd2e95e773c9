"""Threads that are always waited for, and work on the parts of a picture, shared by two."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import islice
from typing import TypeVar

from camctl.system.interrupts import uninterrupted

THREADS = 2
"""Threads: a small device has at least so many cores, and each part in work needs memory."""

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


class Threads(ThreadPoolExecutor):
    """An executor whose ``with`` block ends after all of its work, also where it is interrupted.

    A signal while the first work is submitted would leave a thread that runs, and that the executor
    does not know.
    """

    submit = uninterrupted(ThreadPoolExecutor.submit)


def in_threads(
    function: Callable[[_Item], _Result], items: Iterable[_Item], count: int = THREADS
) -> Iterator[_Result]:
    """Yield `function` of each item, in their order; `count` threads make as many results ahead.

    >>> list(in_threads(abs, [-3, 2, -1]))
    [3, 2, 1]
    """
    rest = iter(items)
    with Threads(count) as threads:
        ahead = deque(threads.submit(function, item) for item in islice(rest, count))
        while ahead:
            result = ahead.popleft().result()
            ahead.extend(threads.submit(function, item) for item in islice(rest, 1))
            yield result
