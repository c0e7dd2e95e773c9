"""A study of many simulated captures on a Dask LocalCluster whose scheduler is killed on the way.

    python tests/helpers/cluster_loss.py N

Rates N captures, each with noise of its own.  When a third of the results is there the process with
the scheduler gets SIGKILL, and the study must end with one `ResourceError`; then it is repeated on
a new cluster, with the results that were kept.  Prints a JSON object: how many results the first
attempt has kept, how many items the second one has computed, and whether results are those of one
process: of captures spread evenly over those kept, and over those computed after the loss.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from pydantic_core import to_json

from camctl.errors import ResourceError
from camctl.studies import parallel
from camctl.studies.capture_study import CapturePoint, CaptureRun, rate
from camctl.studies.rows import KeptResults

CLUSTER = """
import sys
from distributed import LocalCluster
if __name__ == "__main__":
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as cluster:
        print(cluster.scheduler_address, flush=True)
        sys.stdin.read()
"""


@contextmanager
def cluster() -> Iterator[subprocess.Popen[str]]:
    """Yield the process of a cluster, which is named in the environment."""
    with tempfile.TemporaryDirectory() as folder:
        script = Path(folder) / "cluster.py"
        script.write_text(CLUSTER)
        process = subprocess.Popen(
            [sys.executable, str(script)],
            cwd=folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        assert process.stdout is not None
        os.environ[parallel.SCHEDULER] = process.stdout.readline().strip()
        try:
            yield process
        finally:
            del os.environ[parallel.SCHEDULER]
            process.communicate()


def spread(places: list[int]) -> list[int]:
    """Return five or more of these, evenly spread, or all that there are."""
    return places[:: max(1, len(places) // 5)]


def main(count: int) -> None:
    os.environ["DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT"] = "5s"
    run = CaptureRun(
        method="doubling", n=2, response="log", dynamic_range=1000.0, base_s=0.01, size="16x12"
    )
    run = replace(run, scene="uniform", sensor="ideal-6", profile="none")
    runs = [replace(run, seeds=(seed,)) for seed in range(count)]
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        kept = KeptResults(Path(folder) / "kept", CaptureRun, CapturePoint)
        error = ""
        with cluster() as process:

            def kill(share: float) -> None:
                if share > 1 / 3 and process.poll() is None:
                    process.send_signal(signal.SIGKILL)

            try:
                parallel.run_all(rate, runs, kept=kept, progress=kill)
            except ResourceError as lost:
                error = str(lost)
        before = sorted(dict(kept.read(runs)))
        computed: list[float] = []
        with cluster():
            found = parallel.run_all(rate, runs, kept=kept, progress=computed.append)
    after = sorted({*range(count)} - {*before})
    compared = [spread(places) for places in (before, after)]
    # As JSON, in which NaN equals NaN.
    same = all(to_json(found[k]) == to_json(rate(runs[k])) for places in compared for k in places)
    seconds = round(time.monotonic() - began, 1)
    described = {"error": error, "kept": len(before), "computed": len(computed)}
    described |= {"compared": [len(places) for places in compared], "same": same}
    print(json.dumps({"captures": len(found), **described, "seconds": seconds}))


if __name__ == "__main__":
    main(int(sys.argv[1]))
