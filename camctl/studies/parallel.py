"""Long sweeps over several processes: on the Dask cluster that is named, else local ones.

The work is a function of one picklable item, and all randomness follows from the item, so that the
results are the same on one process, on many, and on a cluster.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from importlib import import_module
from multiprocessing import resource_tracker
from typing import Any, TypeVar

from camctl.errors import UsageError

ItemT = TypeVar("ItemT")
ResultT = TypeVar("ResultT")

SCHEDULER = "DASK_SCHEDULER_ADDRESS"
"""Environment variable of Dask: the address of a running cluster, such as tcp://host:8786."""


def run_all(
    function: Callable[[ItemT], ResultT],
    items: Sequence[ItemT],
    *,
    workers: int | None = None,
    may_leave: bool = True,
    progress: Callable[[float], None] | None = None,
) -> list[ResultT]:
    """Return `function` of each item, in the order of the items.

    Args:
        function: a function at the top level of a module
        items: what it is called with; they and its results can be pickled
        workers: number of processes, in whose place is a cluster that is named; 1: this process;
            None: one for each processor
        may_leave: False where the work needs a device of this computer: no cluster does it
        progress: called with the completed share, 0 to 1

    Raises what `function` raises; the items that have not begun are then left out.
    """
    count = min(workers or os.cpu_count() or 1, len(items))
    address = os.environ.get(SCHEDULER) if items and may_leave else None
    if count <= 1 and not address:
        results = []
        for place, item in enumerate(items, 1):
            results.append(function(item))
            if progress is not None:
                progress(place / len(items))
        return results
    with cluster_executor(address) if address else processes(count) as executor:
        futures = [executor.submit(function, item) for item in items]
        for done, future in enumerate(as_completed(futures), 1):
            future.result()
            if progress is not None:
                progress(done / len(items))
        return [future.result() for future in futures]


@contextmanager
def processes(count: int) -> Iterator[Executor]:
    """Yield an executor of `count` local processes; where the block fails they end at once."""
    pool = _Pool(count)
    try:
        yield pool
    except BaseException:
        # First the pool drops the waiting items: its thread would otherwise report each of
        # them as lost with the processes, and fail on those that the caller has cancelled.
        manager = getattr(pool, "_executor_manager_thread", None)
        pool.shutdown(wait=False, cancel_futures=True)
        children = multiprocessing.active_children()
        for child in children:
            child.terminate()  # an item may take long, and its result is not needed any more
        for child in children:
            child.join()
        if manager is not None:
            manager.join()  # the end of the interpreter would write into what it closes
        raise
    pool.shutdown()


class _Pool(ProcessPoolExecutor):
    """Local processes that do not receive what a terminal sends to all: this process handles it.

    Control-C and the closing of the terminal are blocked while processes start, which inherit
    that; an initializer of theirs would run too late, after seconds of imports.
    """

    def __init__(self, count: int) -> None:
        with _terminal_signals_blocked():
            resource_tracker.ensure_running()  # a process, too; afterwards Control-C is not blocked
        super().__init__(count, mp_context=multiprocessing.get_context("spawn"))

    def submit(
        self, function: Callable[..., ResultT], /, *arguments: Any, **named: Any
    ) -> Future[ResultT]:
        """Submit a call; a process may be started for it."""
        with _terminal_signals_blocked():
            return super().submit(function, *arguments, **named)


@contextmanager
def _terminal_signals_blocked() -> Iterator[None]:
    if sys.platform == "win32":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def cluster_executor(address: str) -> Iterator[Executor]:
    """Yield an executor on the Dask cluster at an address.

    Raises:
        UsageError: dask.distributed is not installed, or the cluster cannot be reached
    """
    try:
        distributed: Any = import_module("distributed")  # has no types
    except ImportError as error:
        raise UsageError(
            f"{SCHEDULER} names a cluster, but dask.distributed is not installed",
            hint="pip install distributed, or unset the variable",
        ) from error
    try:
        client = distributed.Client(address)
    except (OSError, ValueError) as error:
        raise UsageError(
            f"the Dask cluster {address} ({SCHEDULER}) cannot be reached: {error}",
            hint="start it, or unset the variable",
        ) from error
    with client:
        yield client.get_executor(pure=False)
