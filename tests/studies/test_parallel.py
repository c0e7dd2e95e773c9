"""Work over several processes: order, the same results everywhere, errors, progress."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import subprocess
import sys
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from math import isnan, nan, sqrt
from pathlib import Path
from time import sleep

import pytest

from camctl.errors import DataError
from camctl.studies import parallel
from camctl.studies.rows import KeptResults


def test_results_are_in_the_order_of_the_items_in_this_process() -> None:
    shares: list[float] = []
    assert parallel.run_all(sqrt, [9.0, 4.0], workers=1, progress=shares.append) == [3.0, 2.0]
    assert shares == [0.5, 1.0]
    assert parallel.run_all(sqrt, []) == []


@pytest.mark.parametrize("may_leave", [True, False])
def test_a_cluster_that_is_named_takes_the_place_of_one_process(
    monkeypatch: pytest.MonkeyPatch, may_leave: bool
) -> None:
    called: list[str] = []

    def cluster(address: str) -> ThreadPoolExecutor:
        called.append(address)
        return ThreadPoolExecutor(1)

    monkeypatch.setenv(parallel.SCHEDULER, "tcp://host:8786")
    monkeypatch.setattr(parallel, "cluster_executor", cluster)
    assert parallel.run_all(sqrt, [9.0], workers=1, may_leave=may_leave) == [3.0]
    assert parallel.run_all(sqrt, []) == []
    assert called == ["tcp://host:8786"] * may_leave


@pytest.mark.slow
@pytest.mark.parametrize(
    "on_cluster",
    [
        pytest.param(True, id="dask", marks=pytest.mark.serial),  # it must start within 10 s
        pytest.param(False, id="processes"),
    ],
)
def test_results_are_the_same_on_dask_and_on_processes(
    on_cluster: bool, request: pytest.FixtureRequest
) -> None:
    if on_cluster:
        request.getfixturevalue("dask_cluster")
    numbers = [float(number) for number in range(8)]
    shares: list[float] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # raised inside the libraries of the cluster
        found = parallel.run_all(sqrt, numbers, workers=2, progress=shares.append)
    assert found == [sqrt(number) for number in numbers]
    assert shares == [(place + 1) / 8 for place in range(8)]


@dataclass(frozen=True)
class Numbered:
    number: float


def test_results_that_are_kept_are_not_computed_again(tmp_path: Path) -> None:
    kept = KeptResults(tmp_path / "kept", Numbered, float)
    items = [Numbered(4.0), Numbered(9.0), Numbered(-1.0)]
    computed: list[float] = []

    def root(item: Numbered) -> float:
        computed.append(item.number)
        return sqrt(item.number) if item.number >= 0 else nan

    assert parallel.run_all(root, items[:2], workers=1, kept=kept) == [2.0, 3.0]
    assert computed == [4.0, 9.0]
    with kept._path.open("ab") as file:
        file.write(b'[{"number": 16.0}, 4')  # a process was killed here
    found = parallel.run_all(root, items, workers=1, kept=kept)
    assert found[:2] == [2.0, 3.0]
    assert isnan(found[2])
    assert computed == [4.0, 9.0, -1.0]
    assert isnan(dict(kept.read(items))[2])
    kept._path.write_text("[1]\n")
    with pytest.raises(DataError, match="kept, line 1: "):
        parallel.run_all(root, items, workers=1, kept=kept)


@pytest.mark.slow
@pytest.mark.serial  # the cluster must start within 10 s
def test_a_study_continues_after_its_cluster_was_killed() -> None:
    pytest.importorskip("distributed", reason="dask.distributed is not installed")
    program = Path(__file__).parents[1] / "helpers" / "cluster_loss.py"
    done = subprocess.run(
        [sys.executable, str(program), "24"], capture_output=True, text=True, check=False
    )
    assert done.stderr == ""
    found = json.loads(done.stdout)
    assert "was lost after" in found["error"]
    assert 8 <= found["kept"] < 24
    assert found["computed"] == 24 - found["kept"]
    assert found["captures"] == 24
    assert min(found["compared"]) >= 5  # of those before the loss, and of those after it
    assert found["same"]


def test_what_is_sent_to_all_processes_is_left_to_this_one() -> None:
    with parallel.processes(1) as pool:
        child = pool.submit(os.getpid).result()
        for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):
            os.kill(child, number)
            assert pool.submit(os.getpid).result() == child


def test_processes_end_with_the_block_that_fails() -> None:
    def work() -> None:
        with parallel.processes(1) as pool:
            pool.submit(sleep, 1000)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        work()
    assert not multiprocessing.active_children()


def test_processes_end_with_the_one_that_started_them() -> None:
    item = "import time; print('begun', flush=True); time.sleep(1000)"
    program = (
        f"from camctl.studies import parallel; parallel.run_all(exec, [{item!r}] * 2, workers=2)"
    )
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE) as work:
        assert work.stdout is not None
        assert [work.stdout.readline() for _ in range(2)] == [b"begun\n"] * 2
        work.kill()
        assert work.stdout.read() == b""  # which ends when no process holds the pipe any more


def test_an_error_of_an_item_ends_the_work() -> None:
    with pytest.raises(ValueError, match=r"math domain error|nonnegative"):
        parallel.run_all(sqrt, [4.0, -1.0], workers=2)
    assert not multiprocessing.active_children()
