"""What a shot costs beside its exposure: `ptpip:` and `gphoto2:` against the gphoto2 command line.

    python tests/bench/bench_ptp_overhead.py

All take the same bracket from the same virtual camera in the network, a Nikon that saves JPEGs of
1 MB, in a process of its own.  The program gphoto2 gets the whole bracket in one call, and what it
takes to start and connect is subtracted.  The target: no slower than the program, and more than 1
shot a second.
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))

import gphoto2_client
from ptp_bench import settings_at, shoot

import camctl
from camctl.sim.devices.hub import CONTROL, Hub

# Dial labels of the virtual Nikon, which exposes exactly them.
BRACKET = ("1/1000", "1/250", "1/60", "1/15", "1/4")
TIMES_S = (1 / 1000, 1 / 250, 1 / 60, 1 / 15, 1 / 4)
ROUNDS = 5
CAMERA = {
    "name": "net",
    "kind": "ptpip",
    "vendor": "nikon",
    "scene": "ramp",
    "sensor": "ideal-8",
    "size": "640x480",
    "object_bytes": 1 << 20,
    "repeat_noise": True,
}


def main() -> int:
    """Print seconds per shot of both; return 1 if a target is missed."""
    if gphoto2_client.missing():
        print(gphoto2_client.missing())
        return 1
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        config = folder / "config.json"
        config.write_text(json.dumps({"devices": [CAMERA]}))
        command = [sys.executable, "-m", "camctl.sim.devices", "--dir", str(folder), str(config)]
        with subprocess.Popen(command) as devices:
            try:
                while devices.poll() is None and not (folder / CONTROL).exists():
                    time.sleep(0.05)
                port = Hub(folder).do("net", "state")["port"]
                return _compare(f"ptpip:127.0.0.1:{port}", port, folder)
            finally:
                devices.terminate()


def _compare(address: str, port: int, folder: Path) -> int:
    spent = {backend: _bracket_s(f"{backend}{address}") for backend in ("", "gphoto2:")}
    place = ("--port", f"{address}:{port}", "--force-overwrite", "--filename=%n.jpg")
    steps = [
        word
        for label in BRACKET
        for word in ("--set-config", f"shutterspeed={label}", "--capture-image-and-download")
    ]

    def run(*words: str) -> Callable[[], object]:
        return lambda: gphoto2_client.gphoto2(*place, *words, folder=folder)

    start_s = statistics.median(
        _seconds(run("--get-config", "shutterspeed")) for _ in range(ROUNDS)
    )
    spent["program"] = [_seconds(run(*steps)) - start_s for _ in range(ROUNDS)]
    rows = {}
    print("| client | bracket of 5, s | overhead a shot, s | shots a second |")
    print("|---|---|---|---|")
    for name, label in (("", "ptpip:"), ("gphoto2:", "gphoto2:"), ("program", "gphoto2 program")):
        median = statistics.median(spent[name])
        rows[name] = (median - sum(TIMES_S)) / len(TIMES_S), len(TIMES_S) / median
        print(f"| {label} | {median:.2f} | {rows[name][0]:.3f} | {rows[name][1]:.2f} |")
    theirs_s, _ = rows.pop("program")
    return int(any(cost_s > theirs_s or rate <= 1 for cost_s, rate in rows.values()))


def _bracket_s(camera_id: str) -> list[float]:
    """Return the seconds of each bracket, after a first one."""
    with camctl.open_camera(camera_id, response="linear") as camera:
        settings = settings_at(camera, *TIMES_S)
        shoot(camera, settings)
        return [_seconds(lambda: shoot(camera, settings)) for _ in range(ROUNDS)]


def _seconds(act: Callable[[], object]) -> float:
    began = time.perf_counter()
    act()
    return time.perf_counter() - began


if __name__ == "__main__":
    sys.exit(main())
