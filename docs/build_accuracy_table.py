"""Builds the table of exposures chosen by accuracy for the built-in simulated sensors.

    python docs/build_accuracy_table.py [WORKERS]

Writes ``camctl/exposure/default_accuracy_table.json``: the sensors of `SENSORS`, three responses,
three ranges and 1 to 6 exposures.  Finished rows are kept beside it: after an interruption the
same command continues.
"""

from __future__ import annotations

import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import camctl
from camctl.exposure.accuracy_lookup import accuracy_jobs
from camctl.exposure.build import build_table, discard_rows
from camctl.exposure.search.front import accuracy_problem
from camctl.model.response.desired import desired_response
from camctl.model.response.names import RANGES, RESPONSES

SENSORS = ("standard", "webcam", "consumer", "phone", "machine-vision")
"""Sensors whose dark current does not matter, so that their rows serve for any shutter time."""

OUTPUT = Path(camctl.__file__).parent / "exposure/default_accuracy_table.json"


def main() -> None:
    """Build the table."""
    desired = [desired_response(name, span) for name in RESPONSES for span in RANGES]
    problems = []
    for sensor in SENSORS:
        with camctl.open_camera("sim", sensor=sensor, scene="uniform", size="16x16") as camera:
            problems += [accuracy_problem(camera.controls, each) for each in desired]
    workers = int(sys.argv[1]) if len(sys.argv) > 1 else 2
    jobs, parts = accuracy_jobs(problems), OUTPUT.with_suffix(".parts")
    with ProcessPoolExecutor(workers) as executor:
        table = build_table(
            jobs,
            executor=executor,
            state=parts,
            progress=lambda done, rows: print(f"\r{done} of {rows} rows", end="", file=sys.stderr),
        )
    table.save(OUTPUT)
    discard_rows(jobs, parts)
    print(f"\nwrote {OUTPUT}: {len(table.entries)} rows", file=sys.stderr)


if __name__ == "__main__":
    main()
