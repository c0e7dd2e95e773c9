"""Test all backends against the kernel's own drivers, in a virtual machine.

    .venv/bin/python tests/virtual_hardware/run.py [-k EXPRESSION] [--backend NAME] [--proofs]
    .venv/bin/python tests/virtual_hardware/run.py --bench
    .venv/bin/python tests/virtual_hardware/run.py --display [--keep FOLDER]

All tests run in one guest: a guest computes for most of a minute before its first test, importing
what the tests need.  A line for each test shows the elapsed time, the outcome and how long the test
took by the guest's own clock.  The last line is "virtual hardware: N passed, M failed, S s".  With
--display the panels for boards are shown on the display of a guest, which no other run does.  Where
no guest can run it is "virtual hardware skipped: REASON; what to install", with status 0, or with
77 after --must-run.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import display
from guest_modules import gpio_module, loopback_module
from machine import CannotRunError, GuestError, Kernel, prepare, run_in_guest

HERE = Path(__file__).resolve().parent
REPOSITORY = HERE.parents[1]
PACKAGES = ("camctl", "drivers", "menu", "sim")
HELPERS = REPOSITORY / "tests" / "helpers"
BENCH = REPOSITORY / "tests" / "bench" / "bench_in_guest.py"
DISPLAY = HERE / "display_in_guest.py"
BACKENDS = ("v4l2", "ptp", "coolpix", "gphoto2")
# Limits that only catch what hangs: of a guest in the host's time, of a test in the guest's.
LIMIT_S = 2200.0
TEST_LIMIT_S = 1200
SKIPPED = 77
ENVIRONMENT = {
    "CAMCTL_IN_GUEST": "1",
    "PYTHONPATH": str(HELPERS),
    "PYTHONUNBUFFERED": "1",
    "PYTHONHASHSEED": "0",
    "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1",  # each costs seconds in a guest
    "OPENBLAS_NUM_THREADS": "1",
    "COLUMNS": "100",
    "NO_COLOR": "1",
    "TERM": "dumb",
}
PYTEST = (
    *(sys.executable, "-m", "pytest", "-q", "-ra", "--tb=short"),
    *("-p", "no:cacheprovider", "-p", "pytest_timeout", f"--timeout={TEST_LIMIT_S}"),
    f"--confcutdir={HERE}",
)
NO_TESTS = 5  # pytest's exit status where it has selected none

_TEST_LINE = re.compile(r"(passed|failed|skipped) +[\d.]+ s  ")
_COLLECTED_LINE = re.compile(r"collected (\d+)")

OnLine = Callable[[str], None]


def main() -> int:
    """Return the exit status."""
    arguments = _parser().parse_args()
    began = time.monotonic()
    try:
        kernel = prepare()
    except CannotRunError as error:
        print(f"virtual hardware skipped: {error}")
        return SKIPPED if arguments.must_run else 0
    for module in (loopback_module, gpio_module):
        try:
            ENVIRONMENT[f"CAMCTL_{module.__name__.upper()}"] = str(module(kernel))
        except CannotRunError as error:
            print(f"without a module: {error}")
    _compile()
    if arguments.command or arguments.bench:
        guest, bench = Guest("guest", kernel, arguments.limit, began), [sys.executable, str(BENCH)]
        return guest.run(arguments.command or bench, lambda text: print(text, flush=True))
    if arguments.display:
        return _display(Guest("display", kernel, arguments.limit, began), arguments.keep)
    guest = Guest("tests", kernel, arguments.limit, began)
    guest.test(_tests(arguments))
    counts = guest.counts
    failed = max(counts["failed"], int(guest.is_broken))
    if not counts["collected"]:
        failed = 1
        print("no test was selected")
    seconds = time.monotonic() - began
    print(f"virtual hardware: {counts['passed']} passed, {failed} failed, {seconds:.0f} s")
    return 1 if failed else 0


class Guest:
    """One virtual machine, and what it has printed.

    Args:
        name: part of the names of its folders
        kernel: see `machine.prepare`
        limit_s: the guest is ended after so many seconds
        began: when the whole run began, by `time.monotonic`

    Attributes:
        counts: tests collected, passed, failed and skipped
        is_broken: it did not end as it should; its folder is kept
    """

    def __init__(self, name: str, kernel: Kernel, limit_s: float, began: float) -> None:
        self.name = name
        self.counts = Counter[str]()
        self.is_broken = False
        self._kernel = kernel
        self._limit_s = limit_s
        self._began = began
        self._report: list[str] = []

    def test(self, command: Sequence[str]) -> None:
        """Run tests: print a line for each as it ends, and all other output at the end."""
        status = self.run(command, self._on_line)
        ran = sum(self.counts[outcome] for outcome in ("passed", "failed", "skipped"))
        if ran < self.counts["collected"]:
            self._say(f"{self.counts['collected'] - ran} tests did not run")
        if status not in (0, NO_TESTS) and not self.counts["failed"]:
            self.is_broken = True
        if self._report:
            sys.stdout.write("\n".join(self._report) + "\n")
            sys.stdout.flush()

    def run(
        self,
        command: Sequence[str],
        on_line: OnLine,
        out: Path | None = None,
        devices: Sequence[str] = (),
        keep: Path | None = None,
    ) -> int:
        """Run a command in the guest, with `out` as its /guest_out; return its exit status.

        Pictures that it leaves there are copied into `keep`.
        """
        out = out or Path(tempfile.mkdtemp(prefix=f"virtual-hardware-{self.name}-"))
        try:
            result = run_in_guest(
                self._kernel,
                command,
                out,
                environment=ENVIRONMENT,
                directory=REPOSITORY,
                limit_s=self._limit_s,
                on_line=on_line,
                devices=devices,
            )
        except GuestError as error:
            self.is_broken = True
            self._say(f"{error}; its console and other files: {out}")
            return 1
        for picture in out.glob("*.ppm") if keep is not None else ():
            shutil.copy(picture, str(keep))
        self._say(f"the guest was up after {result.boot_s:.0f} s, start {result.boots}")
        if result.status in (0, NO_TESTS):
            shutil.rmtree(out, ignore_errors=True)
        else:
            self._say(f"status {result.status}; its console and other files: {out}")
        return result.status

    def _on_line(self, line: str) -> None:
        text = line.lstrip("\0 ")  # probing serial ports for cameras sends a NUL to the console
        if found := _COLLECTED_LINE.fullmatch(text):
            self.counts["collected"] += int(found[1])
        elif found := _TEST_LINE.match(text):
            self.counts[found[1]] += 1
            self._say(text)
        else:
            self._report.append(line)

    def _say(self, text: str) -> None:
        elapsed_s = time.monotonic() - self._began
        print(f"{elapsed_s:5.0f} s  {text}", flush=True)


def _display(guest: Guest, keep: Path | None) -> int:
    """Run a program on the display of a guest, and compare pictures of it; return the status."""
    out = Path(tempfile.mkdtemp(prefix=f"virtual-hardware-{guest.name}-"))
    watched = display.Display(out)

    def on_line(line: str) -> None:
        if not watched.obey(line):
            print(line, flush=True)

    command = [sys.executable, str(DISPLAY)]
    status = guest.run(command, on_line, out, display.devices(out), keep)
    for line in watched.wrong:
        print(line)
    passed = not status and not watched.wrong and bool(watched.compared)
    print(f"{guest.name}: {len(watched.compared)} pictures, {'as drawn' if passed else 'FAILED'}")
    return 0 if passed else 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description="Test all backends in virtual machines.")
    parser.add_argument("-k", metavar="EXPRESSION", help="only tests that pytest's -k selects")
    parser.add_argument("--backend", choices=BACKENDS, help="only this backend's tests")
    parser.add_argument("--display", action="store_true", help="only panels, on a display")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="keep the display's pictures")
    parser.add_argument("--proofs", action="store_true", help="with the tests marked proof")
    parser.add_argument("--bench", action="store_true", help="run the benchmark instead")
    parser.add_argument("--must-run", action="store_true", help=f"status {SKIPPED} when skipped")
    parser.add_argument("--limit", type=float, default=LIMIT_S, metavar="SECONDS", help="at most")
    parser.add_argument(
        "command", nargs="*", metavar="-- COMMAND", help="command to run in a guest instead"
    )
    return parser


def _compile() -> None:
    """Write the byte code of modules and tests on the host: in a guest that takes a minute."""
    folders = [str(REPOSITORY / package) for package in PACKAGES]
    inherited = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    for command in (
        [sys.executable, "-m", "compileall", "-q", *folders, str(HELPERS)],
        [*PYTEST, "--collect-only", str(HERE / "guest")],  # pytest changes the code of tests
    ):
        subprocess.run(
            command,
            cwd=REPOSITORY,
            env={**inherited, **ENVIRONMENT},
            check=False,
            stdout=subprocess.DEVNULL,
        )


def _tests(arguments: argparse.Namespace) -> list[str]:
    """Return the command that runs the tests."""
    selected = " and ".join(f"({each})" for each in (arguments.backend, arguments.k) if each)
    marks = () if arguments.proofs else ("-m", "not proof")
    return [*PYTEST, *marks, *(("-k", selected) if selected else ()), str(HERE / "guest")]


if __name__ == "__main__":
    sys.exit(main())
