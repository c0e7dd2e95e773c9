"""A capture that is killed, or loses power, at any of its file operations can be completed.

What was lost in a power failure is what no fsync had brought to disk; see `crash_points`.
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
from crash_points import is_possible

SWEEP = Path(__file__).parents[1] / "helpers" / "crash_sweep.py"
OPERATIONS = {"open", "write", "fsync", "rename", "mkdir", "unlink", "end"}

pytestmark = pytest.mark.skipif(not is_possible(), reason="crash points need Linux on x86-64")


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    """A folder in memory where there is one: thousands of fsyncs would wait for the disk."""
    memory = Path("/dev/shm")
    with tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else tmp_path) as name:
        yield Path(name) / "sweep"


def sweep(folder: Path, scenario: str, step: int) -> list[dict[str, Any]]:
    command = [sys.executable, str(SWEEP), str(folder), scenario, str(step)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scenario", "least", "saved", "completed"),
    [
        ("resume", 55, {1, 2}, {"resumed", "complete"}),
        ("force", 80, {0, 1, 2}, {"resumed", "complete"}),
        ("retry", 120, {0, 2, 4}, {"shot anew", "resumed", "complete"}),
    ],
)
def test_no_crash_loses_a_saved_frame_or_spoils_the_sum(
    folder: Path, scenario: str, least: int, saved: set[int], completed: set[str]
) -> None:
    checks = sweep(folder, scenario, 1)
    assert [check for check in checks if check["wrong"]] == []
    assert len(checks) >= 2 * least
    assert {check["before"] for check in checks} >= OPERATIONS - {"mkdir"}
    assert {check["saved"] for check in checks} == saved
    assert {check["done"] for check in checks} == completed


@pytest.mark.parametrize("scenario", ["retry", pytest.param("force", marks=pytest.mark.slow)])
def test_some_crash_points(folder: Path, scenario: str) -> None:
    checks = sweep(folder, scenario, 31)
    assert [check for check in checks if check["wrong"]] == []
    assert len(checks) >= 8
