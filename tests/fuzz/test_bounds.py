"""Damaged inputs are read or refused within limits on memory and processor time."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import settings

HELPERS = Path(__file__).parents[1] / "helpers"


def run(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run Python among the helpers, with one thread in numpy's libraries."""
    own = {"OPENBLAS_NUM_THREADS": "1", "CAMCTL_CACHE": str(folder), "TMPDIR": str(folder)}
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=HELPERS,
        env={**os.environ, **own},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.slow
def test_every_reader_keeps_to_500_mb_and_5_s(tmp_path: Path) -> None:
    count = settings().max_examples // 10
    seed = "1" if count <= 10 else str(os.getpid())  # "explore" tries new inputs each time
    done = run("read_bounded_inputs.py", str(count), seed, folder=tmp_path)
    assert done.returncode == 0, done.stdout
    assert " inputs: {" in done.stdout


READS = {
    "lambda data, folder: data": "read",
    "refuse": "refused",
    "lambda data, folder: 1 / 0": "ZeroDivisionError",
    "lambda data, folder: bytearray(600 << 20)": "MemoryError",
    "endless": "ended by signal",
    "lambda data, folder: ctypes.string_at(0)": "ended by signal 11",
}
"""Functions that read, and what is found of them."""


@pytest.mark.slow
def test_what_exceeds_a_limit_is_found(tmp_path: Path) -> None:
    program = f"""
import ctypes
from pathlib import Path
import read_bounded_inputs as program
from camctl.errors import DataError
program.MOST_SECONDS = 1
def endless(data, folder):
    while True:
        pass
def refuse(data, folder):
    raise DataError("no")
for read in ({", ".join(READS)}):
    print(repr(program.read_within_limits(program.Reader(list, read), b"", Path())))
"""
    done = run("-c", program, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    for line, found in zip(done.stdout.splitlines(), READS.values(), strict=True):
        assert found in line
