"""A table built on a real cluster of two worker processes of `dask.distributed`."""

from __future__ import annotations

import warnings

import pytest

from camctl.exposure.build import build_table
from camctl.response.camera import linear_response

distributed = pytest.importorskip("distributed", reason="dask.distributed is not installed")


@pytest.mark.slow
def test_the_same_bits_on_a_cluster_of_two_processes() -> None:
    cameras = [linear_response(3), linear_response(4)]
    alone = build_table(cameras, ("linear", "log"), (20.0,), (1, 2, 3))
    told: list[tuple[int, int]] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the cluster's own libraries
        with (
            distributed.LocalCluster(
                n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
            ) as cluster,
            distributed.Client(cluster) as client,
        ):
            assert len(client.scheduler_info()["workers"]) == 2
            spread = build_table(
                cameras,
                ("linear", "log"),
                (20.0,),
                (1, 2, 3),
                executor=client.get_executor(),
                progress=lambda done, total: told.append((done, total)),
            )
    assert spread.entries == alone.entries
    assert told[-1] == (12, 12)
