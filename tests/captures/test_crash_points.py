"""All that was acknowledged to the user is there after a kill or a power failure at any operation.

Captures, series, profiles, the menu's settings, tables and cached rows; see `crash_witness`.  That
the sweep would notice a broken order of the writes is shown with such orders, `crash_mutations`.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from crash_mutations import MUTATIONS
from crash_points import is_possible

WITNESS = Path(__file__).parents[1] / "helpers" / "crash_witness.py"

pytestmark = pytest.mark.skipif(not is_possible(), reason="crash points need Linux on x86-64")


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    """A folder in memory where there is one: thousands of fsyncs would wait for the disk."""
    memory = Path("/dev/shm")
    with tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else tmp_path) as name:
        yield Path(name) / "sweep"


def sweep(folder: Path, *arguments: str) -> list[dict[str, Any]]:
    command = [sys.executable, str(WITNESS), str(folder), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


@pytest.mark.slow
@pytest.mark.parametrize("every", [False, pytest.param(True, marks=pytest.mark.proof)])
@pytest.mark.parametrize(
    ("scenario", "least", "some"),
    [
        ("fresh", 90, 40),
        *(("resume", 60, 15), ("force", 80, 20), ("retry", 120, 20), ("series", 200, 30)),
    ],
)
def test_no_crash_of_a_capture_loses_what_was_acknowledged(
    folder: Path, scenario: str, least: int, some: int, every: bool
) -> None:
    checks = sweep(folder, scenario, "--torn", "1", *["--every"] * every)
    assert [check for check in checks if check["wrong"]] == []
    assert len(checks) >= 3 * (least if every else some)
    assert {check["before"] for check in checks} >= {"open", "write", "fsync", "rename", "end"}


@pytest.mark.parametrize(
    ("scenario", "least"),
    [
        ("settings", 13),
        *(pytest.param(*each, marks=pytest.mark.slow) for each in (("profile", 20), ("table", 20))),
        pytest.param("row", 10, marks=pytest.mark.slow),
    ],
)
def test_no_crash_loses_what_is_kept(folder: Path, scenario: str, least: int) -> None:
    checks = sweep(folder, scenario, "--every", "--torn", "3")
    assert [check for check in checks if check["wrong"]] == []
    assert len(checks) >= 5 * least


@pytest.mark.slow
def test_broken_orders_of_the_writes_are_noticed(folder: Path) -> None:
    found = {each["mutation"]: each["wrong"] for each in sweep(folder, "mutations")}
    assert [name for name in MUTATIONS if not found.get(name)] == []
