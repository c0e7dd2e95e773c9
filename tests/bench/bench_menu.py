"""The menu: first screen, key to screen, and what it takes while idle with the simulated camera.

    python tests/bench/bench_menu.py

The first screen of `camctl menu` on a pseudo-terminal is compared with `python -c 'import numpy'`,
interleaved.  Key to screen is the step, the screen and the drawing, in every state with every key.
Memory is that of the idle menu on 20 x 4 characters: the median of readings, between two of the
exposure meter, and the most that the process ever had, while it started included.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parents[2]), str(Path(__file__).parents[1] / "helpers")]

from pseudo_terminal import Terminal  # noqa: E402

from camctl.menu.drawing import draw  # noqa: E402  found by the path above
from camctl.menu.layout import grid  # noqa: E402
from camctl.menu.machine import step  # noqa: E402
from camctl.menu.model import State  # noqa: E402
from camctl.menu.ports import Key, Screen  # noqa: E402
from camctl.menu.screens import screen  # noqa: E402
from camctl.system.picture_operations import png  # noqa: E402
from tests.menu.test_machine import FULL  # noqa: E402

RUNS = 7
FIRST_SCREEN_LIMIT = 3.0
"""In units of the time of importing numpy."""
LIMITS_S = {"text 20 x 4": 0.030, "picture 480 x 320": 0.060, "web 640 x 480": 0.100}
CPU_LIMIT, MEMORY_LIMIT_MB, PEAK_LIMIT_MB = 0.02, 60, 80
SETTLED_S, WATCHED_S = 20.0, 30.0


def first_screen_s() -> float:
    """Return the time from the start of `camctl menu` to its first screen."""
    began = time.perf_counter()
    terminal = Terminal(["-m", "camctl", "menu"])
    while not any(text in terminal.raw for text in ("Starting", "Opening", "Ready")):
        terminal._read(1.0)
    taken = time.perf_counter() - began
    terminal.close()
    return taken


def import_numpy_s() -> float:
    """Return the time of importing numpy in a fresh interpreter."""
    began = time.perf_counter()
    subprocess.run([sys.executable, "-c", "import numpy"], check=True)
    return time.perf_counter() - began


def key_to_screen_s(show: Callable[[Screen], object]) -> list[float]:
    """Return the times of every key in every state."""
    times = []
    for state in State:
        for key in Key:
            model = replace(FULL, state=state)
            began = time.perf_counter()
            show(screen(step(model, key)[0]))
            times.append(time.perf_counter() - began)
    return sorted(times)


def idle() -> tuple[float, float, float]:
    """Return (share of one core, usual and largest resident memory in MB) of the idle menu."""
    with tempfile.TemporaryDirectory() as folder:
        os.environ["XDG_STATE_HOME"] = folder
        terminal = Terminal(["-m", "camctl", "menu", "-o", folder], 20, 4)
        pid = terminal.process.pid
        used, resident = 0.0, [0.0]
        for watched_s in (SETTLED_S, WATCHED_S):
            resident, before = [], _cpu_s(pid)
            deadline = time.monotonic() + watched_s
            while time.monotonic() < deadline:
                time.sleep(0.2)
                while terminal._read(0):
                    pass
                resident.append(_memory_mb(pid, "VmRSS"))
            used = (_cpu_s(pid) - before) / watched_s
        most = _memory_mb(pid, "VmHWM")
        terminal.close()
    return used, statistics.median(resident), most


def _memory_mb(pid: int, field: str) -> float:
    """Return a field of the status of a process, MB (of 1024 kB)."""
    status = Path(f"/proc/{pid}/status").read_text()
    return next(int(line.split()[1]) for line in status.splitlines() if field in line) / 1024


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> int:
    """Print the figures; return how many are over their limit."""
    over = 0
    first, numpy = [], []
    for _ in range(RUNS):
        first.append(first_screen_s())
        numpy.append(import_numpy_s())
    ratio = statistics.median(first) / statistics.median(numpy)
    over += ratio > FIRST_SCREEN_LIMIT
    print(f"first screen: {ratio:.2f} x import numpy (limit {FIRST_SCREEN_LIMIT:g})")
    shows: dict[str, Callable[[Screen], object]] = {
        "text 20 x 4": lambda shown: grid(shown, 20, 4),
        "picture 480 x 320": lambda shown: draw(shown, 480, 320),
        "web 640 x 480": lambda shown: png(draw(shown, 640, 480).pixels),
    }
    for name, show in shows.items():
        key_to_screen_s(show)  # loads the characters
        times = key_to_screen_s(show)
        median, most = statistics.median(times), times[int(0.99 * len(times))]
        over += most > LIMITS_S[name]
        print(
            f"key to screen, {name}: median {1e3 * median:.2f} ms, 99 % within "
            f"{1e3 * most:.1f} ms (limit {1e3 * LIMITS_S[name]:g} ms)"
        )
    share, memory, peak = idle()
    over += (share > CPU_LIMIT) + (memory > MEMORY_LIMIT_MB) + (peak > PEAK_LIMIT_MB)
    print(f"idle: {share:.2%} of one core (limit {CPU_LIMIT:.0%})")
    print(f"idle: {memory:.1f} MB resident (limit {MEMORY_LIMIT_MB} MB)")
    print(f"idle: at most {peak:.1f} MB resident (limit {PEAK_LIMIT_MB} MB)")
    return over


if __name__ == "__main__":
    sys.exit(main())
