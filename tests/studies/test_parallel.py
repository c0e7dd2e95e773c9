"""Work over several processes: order, the same results everywhere, errors, progress."""

from __future__ import annotations

import multiprocessing
import warnings
from concurrent.futures import ThreadPoolExecutor
from math import sqrt

import pytest

from camctl.studies import parallel


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


def test_an_error_of_an_item_ends_the_work() -> None:
    with pytest.raises(ValueError, match=r"math domain error|nonnegative"):
        parallel.run_all(sqrt, [4.0, -1.0], workers=2)
    assert not multiprocessing.active_children()
