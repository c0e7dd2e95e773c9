"""The laboratory: all roads against the kernel's own drivers, in a guest that is booted once.

    .venv/bin/python tests/virtual_hardware/run.py [-k EXPRESSION] [--road NAME] [--bench] [--must-run]

Prints a line for each test as it goes and at the end "laboratory: N passed, M failed, S s".  Where
it cannot run it says "laboratory skipped: WHY; what to install" and ends with status 0, or with 77
if it was told that it must.
"""

from __future__ import annotations

import argparse
import os
import shlex
import shutil
import sys
import tempfile
import time
from pathlib import Path

from machine import CannotRunError, GuestError, boot, prepare

HERE = Path(__file__).resolve().parent
REPOSITORY = HERE.parents[1]
LIMIT_S = 360.0
SKIPPED = 77
BENCH = REPOSITORY / "tests" / "bench"
BENCHES = ("bench_discovery.py", "bench_v4l2.py", "bench_ptp.py")
# In the guest every module of the tests finds its neighbours.
MODULES = (REPOSITORY / "tests" / "helpers",)


def main() -> int:
    """Return the exit status."""
    words = _parser().parse_args()
    began = time.monotonic()
    try:
        kernel = prepare()
    except CannotRunError as error:
        print(f"laboratory skipped: {error}")
        return SKIPPED if words.must_run else 0
    out = Path(tempfile.mkdtemp(prefix="camctl-laboratory-"))
    trouble = ""
    try:
        result = boot(
            kernel,
            words.command or _tests(words),
            out,
            environment={
                "CAMCTL_IN_GUEST": "1",
                "PYTHONPATH": os.pathsep.join(map(str, MODULES)),
                "PYTHONUNBUFFERED": "1",
                "COLUMNS": "100",
                "NO_COLOR": "1",
                "TERM": "dumb",
            },
            directory=REPOSITORY,
            limit_s=words.limit,
            line=lambda text: print(text, flush=True),
        )
    except GuestError as error:
        trouble = str(error)
    else:
        print(f"the guest was up after {result.boot_s:.0f} s, start {result.boots}")
        if words.command or words.bench:
            return result.status
        if result.status:
            trouble = f"pytest ended with status {result.status}"
    counts = _counts(out)
    left = counts["collected"] - counts["passed"] - counts["failed"] - counts["skipped"]
    if left > 0:
        print(f"{left} tests did not run")
    if trouble:
        print(f"{trouble}; what the guest left: {out}")
    else:
        shutil.rmtree(out, ignore_errors=True)
    failed = max(counts["failed"], 1 if trouble else 0)
    seconds = time.monotonic() - began
    print(f"laboratory: {counts['passed']} passed, {failed} failed, {seconds:.0f} s")
    return 1 if failed else 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description="Test every road in a guest.")
    parser.add_argument("-k", metavar="EXPRESSION", help="only tests that pytest's -k selects")
    parser.add_argument("--road", choices=("v4l2", "ptp", "coolpix"), help="only this road's tests")
    parser.add_argument("--bench", action="store_true", help="measure speed instead")
    parser.add_argument("--must-run", action="store_true", help=f"status {SKIPPED} when skipped")
    parser.add_argument("--limit", type=float, default=LIMIT_S, metavar="SECONDS", help="at most")
    parser.add_argument(
        "command", nargs="*", metavar="-- COMMAND", help="what to run in the guest instead"
    )
    return parser


def _tests(words: argparse.Namespace) -> list[str]:
    """Return the command: benchmarks one after another, or tests of streams beside all others."""
    if words.bench:
        scripts = [shlex.join([sys.executable, str(BENCH / name)]) for name in BENCHES]
        each = "; ".join(f"{script} || status=1" for script in scripts)
        return ["sh", "-c", f"status=0; {each}; exit $status"]
    wanted = [f"({each})" for each in (words.road, words.k) if each]
    options = ["-q", "-ra", "--tb=short", "-p", "no:cacheprovider"]
    halves = []
    for part, own in (("streams", "v4l2"), ("stills", "not v4l2")):
        select = " and ".join([f"({own})", *wanted])
        pytest = [sys.executable, "-m", "pytest", *options, "-k", select, str(HERE / "guest")]
        halves.append(f"CAMCTL_LAB_PART={part} {shlex.join(pytest)}")
    # Status 5: none of the tests that were asked for is in this half.
    check = "[ $first = 0 -o $first = 5 ] && [ $second = 0 -o $second = 5 ]"
    return [
        "sh",
        "-c",
        f"{halves[0]} & half=$!; {halves[1]}; second=$?; wait $half; first=$?; {check}",
    ]


def _counts(out: Path) -> dict[str, int]:
    """Return how many tests were collected, and of these passed, failed and skipped so far."""
    counts = dict.fromkeys(("collected", "passed", "failed", "skipped"), 0)
    results = out / "results"
    for word in results.read_text().split() if results.exists() else ():
        counts[word] += 1
    return counts


if __name__ == "__main__":
    sys.exit(main())
