"""The menu's settings survive a kill and a power failure before each file operation."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from crash_points import is_possible

SWEEP = Path(__file__).parents[1] / "helpers" / "settings_crash_sweep.py"

pytestmark = pytest.mark.skipif(not is_possible(), reason="crash points need Linux on x86-64")


@pytest.mark.parametrize(
    ("scenario", "before_saving", "operations"),
    [
        ("first", "defaults", {"mkdir", "open", "write", "fsync", "rename", "unlink", "end"}),
        ("again", "old", {"open", "write", "fsync", "rename", "unlink", "end"}),
    ],
)
def test_settings_are_the_old_or_the_new_ones_at_every_crash(
    scenario: str, before_saving: str, operations: set[str], tmp_path: Path
) -> None:
    command = [sys.executable, str(SWEEP), str(tmp_path / "sweep"), scenario]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    checks = [json.loads(line) for line in done.stdout.splitlines()]
    assert [check for check in checks if check["wrong"]] == []
    assert {check["before"] for check in checks} == operations
    assert {check["found"] for check in checks} == {before_saving, "new"}
    # What was saved is on disk when saving has returned.
    assert [check["found"] for check in checks if check["before"] == "end"] == ["new", "new"]
