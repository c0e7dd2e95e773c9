"""Work shared by several processes, and how far it is."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager


def share_of_time(done: int, each: int, count: int) -> float:
    """Return the share of the work in the first `done` rows: `each` rows a number, most first."""
    from camctl.exposure.solver import EFFORT, MOST_EFFORT

    work = [0.0] + [n * EFFORT.get(n, MOST_EFFORT) for n in range(2, count + 1)]
    spent = sum(
        weight * min(max(done - each * place, 0), each)
        for place, weight in enumerate(reversed(work))
    )
    return spent / (sum(work) * each) if count > 1 else done / each


@contextmanager
def executor_of(workers: int) -> Iterator[Executor | None]:
    """Yield processes to work with; None for one worker, which is this one."""
    if workers == 1:
        yield None
        return
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor

    pool = ProcessPoolExecutor(
        workers,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=signal.signal,
        initargs=(signal.SIGINT, signal.SIG_IGN),  # Control-C is for us to answer
    )
    try:
        yield pool
    except BaseException:
        for child in multiprocessing.active_children():
            child.terminate()  # a row can take a long while, and nobody waits for it
        pool.shutdown(cancel_futures=True)
        raise
    pool.shutdown()
