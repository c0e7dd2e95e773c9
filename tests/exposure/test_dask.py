"""An exposure table built on a cluster of two worker processes of `dask.distributed`."""

from __future__ import annotations

import warnings

import pytest

from camctl.exposure.build import build_table, table_jobs
from camctl.model.response.camera import linear_response


@pytest.mark.serial  # a cluster that has not started in 10 s of real time fails
def test_a_cluster_of_two_processes_builds_the_same_table() -> None:
    distributed = pytest.importorskip("distributed", reason="dask.distributed is not installed")
    cameras = [linear_response(3), linear_response(4)]
    jobs = table_jobs(cameras, ("linear", "log"), (20.0,), (1, 2, 3))
    expected = build_table(jobs)
    reported: list[tuple[int, int]] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # raised inside the libraries of the cluster
        with (
            distributed.LocalCluster(
                n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
            ) as cluster,
            distributed.Client(cluster) as client,
        ):
            assert len(client.scheduler_info()["workers"]) == 2
            built = build_table(
                jobs,
                executor=client.get_executor(),
                progress=lambda done, total: reported.append((done, total)),
            )
    assert built.entries == expected.entries
    assert reported[-1] == (12, 12)
