"""Long sweeps over several processes: on the Dask cluster that is named, else local ones.

The work is a function of one picklable item, and all randomness follows from the item, so that the
results are the same on one process, on many, and on a cluster.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence, Sized
from concurrent.futures import (
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    as_completed,
)
from contextlib import contextmanager, suppress
from importlib import import_module
from multiprocessing import resource_tracker
from multiprocessing.context import SpawnContext, SpawnProcess
from typing import Any, TypeVar

from camctl.errors import ResourceError, UsageError
from camctl.studies.rows import KeptResults

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
    kept: KeptResults[ItemT, ResultT] | None = None,
    progress: Callable[[float], None] | None = None,
) -> list[ResultT]:
    """Return `function` of each item, in the order of the items.

    Args:
        function: a function at the top level of a module
        items: what it is called with; they and its results can be pickled
        workers: number of processes, in whose place is a cluster that is named; 1: this process;
            None: one for each processor
        may_leave: False where the work needs a device of this computer: no cluster does it
        kept: results of an earlier call, which are not computed again; new ones are added
        progress: called with the completed share, 0 to 1

    Raises:
        ResourceError: the cluster was lost; what was finished is kept where there is `kept`
        UsageError, DataError, StorageError: as `cluster_executor` and `KeptResults`

    Raises what `function` raises, too; the items that have not begun are then left out.
    """
    found = dict(kept.read(items)) if kept is not None else {}
    places = [place for place in range(len(items)) if place not in found]
    count = min(workers or os.cpu_count() or 1, len(places))
    address = os.environ.get(SCHEDULER) if places and may_leave else None

    def finish(place: int, result: ResultT) -> None:
        found[place] = result
        if kept is not None:
            kept.add(items[place], result)
        if progress is not None:
            progress(len(found) / len(items))

    if count <= 1 and not address:
        for place in places:
            finish(place, function(items[place]))
    else:
        chosen = cluster_executor(address) if address else processes(count)
        with _losses(address, found, len(items)), chosen as executor:
            futures = {executor.submit(function, items[place]): place for place in places}
            for future in as_completed(futures):
                finish(futures[future], future.result())
    return [found[place] for place in range(len(items))]


@contextmanager
def _losses(address: str | None, found: Sized, count: int) -> Iterator[None]:
    """Raise `ResourceError` in place of what a lost cluster raises: its futures are cancelled."""
    try:
        yield
    except (CancelledError, OSError) as error:
        if not address:
            raise
        raise ResourceError(
            f"the Dask cluster {address} was lost after {len(found)} of {count} runs",
            hint="start it again, and repeat the command",
        ) from error


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


class _Process(SpawnProcess):
    """A local process in which SIGTERM is blocked, see `_Pool`: `terminate` kills it."""

    def terminate(self) -> None:
        self.kill()


class _Context(SpawnContext):
    Process = _Process


class _Pool(ProcessPoolExecutor):
    """Local processes that do not receive what is sent to all: this process handles it.

    Control-C, the closing of the terminal and the end of a service are blocked while processes
    start, which inherit that; an initializer of theirs would run too late, after seconds of
    imports.  Processes that end at once with this one's handling of the signal would be reported
    as lost, while their items are cancelled.
    """

    def __init__(self, count: int) -> None:
        with _signals_to_all_blocked():
            resource_tracker.ensure_running()  # a process, too; afterwards Control-C is not blocked
        super().__init__(count, mp_context=_Context(), initializer=_end_with_parent)

    def submit(
        self, function: Callable[..., ResultT], /, *arguments: Any, **named: Any
    ) -> Future[ResultT]:
        """Submit a call; a process may be started for it."""
        with _signals_to_all_blocked():
            return super().submit(function, *arguments, **named)


def _end_with_parent() -> None:
    """End this process when the one that started it has ended, even by SIGKILL.

    Processes of a pool wait for work on a pipe that they themselves hold open.
    """
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _signals_to_all_blocked() -> Iterator[None]:
    if sys.platform == "win32":
        yield
        return
    before = signal.pthread_sigmask(
        signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP, signal.SIGTERM}
    )
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
    for name in ("asyncio", *logging.root.manager.loggerDict):
        if name.partition(".")[0] in ("asyncio", "distributed", "tornado"):
            # They print the tracebacks of lost connections, and have levels of their own.
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        client = distributed.Client(address)
    except (OSError, ValueError) as error:
        raise UsageError(
            f"the Dask cluster {address} ({SCHEDULER}) cannot be reached: {error}",
            hint="start it, or unset the variable",
        ) from error
    try:
        yield client.get_executor(pure=False)
    except BaseException:
        with suppress(Exception):  # without its scheduler it fails in ways of its own
            client.close()
        raise
    client.close()
