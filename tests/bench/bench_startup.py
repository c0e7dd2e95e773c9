"""Start-up time of `camctl --help` and others, compared with `python -c 'import numpy'`.

    python tests/bench/bench_startup.py

Medians of interleaved runs, after one run of each that fills the disk cache.  Then the time of
`camctl.list_backends` in one process, as the menu calls it.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import time

from camctl.interface.backends import list_backends

RUNS = 15
LIMIT = 5.0
"""Longest time of `--help`, in units of the time of importing numpy."""

COMMANDS = {
    "import numpy": "import numpy",
    "import camctl": "import camctl",
    "camctl --help": "from camctl.cli import main; main(['--help'])",
    "camctl shoot --help": "from camctl.cli import main; main(['shoot', '--help'])",
    "camctl cameras": "from camctl.cli import main; main(['cameras'])",
}


def seconds(code: str) -> float:
    """Return the time that a fresh interpreter takes for `code`."""
    started = time.perf_counter()
    subprocess.run([sys.executable, "-c", code], stdout=subprocess.DEVNULL, check=True)
    return time.perf_counter() - started


def main() -> int:
    """Print the table; return 1 if `camctl --help` is over its limit."""
    times: dict[str, list[float]] = {name: [] for name in COMMANDS}
    for run in range(RUNS + 1):
        for name, code in COMMANDS.items():
            taken = seconds(code)
            if run > 0:
                times[name].append(taken)
    medians = {name: statistics.median(taken) for name, taken in times.items()}
    ratios = {name: median / medians["import numpy"] for name, median in medians.items()}
    for name, median in medians.items():
        print(f"{name:20} {median * 1e3:6.0f} ms  {ratios[name]:5.2f} x")
    print(f"limit for --help: {LIMIT:g} x")
    for call in ("first, with imports", "second"):
        began = time.perf_counter()
        list_backends()
        print(f"list of cameras, {call}: {time.perf_counter() - began:.3f} s")
    return int(ratios["camctl --help"] > LIMIT)


if __name__ == "__main__":
    sys.exit(main())
