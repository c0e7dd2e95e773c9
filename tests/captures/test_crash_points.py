"""A capture that is killed at any of its file operations leaves whole files, and can be resumed."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from crash_points import is_possible

SWEEP = Path(__file__).parents[1] / "helpers" / "crash_sweep.py"


@pytest.mark.skipif(not is_possible(), reason="crash points need Linux on x86-64")
@pytest.mark.parametrize(
    ("step", "operations"),
    [
        (7, {"open", "write"}),
        pytest.param(
            1,
            {"open", "write", "fsync", "rename", "mkdir", "unlink"},
            marks=pytest.mark.slow,
        ),
    ],
)
def test_killed_capture_leaves_whole_files_and_can_be_resumed(
    tmp_path: Path, step: int, operations: set[str]
) -> None:
    command = [sys.executable, str(SWEEP), str(tmp_path / "capture"), str(step)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    points = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(points) >= 60 // step
    assert {point["before"] for point in points} >= operations
    assert [point for point in points if point["damaged"] or point.get("resumed")] == []
    assert sum("resumed" in point for point in points) >= len(points) / 2
