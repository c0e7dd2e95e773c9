"""A long series in one process: memory, open files and threads do not grow."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import cast

import leaks
import pytest

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not leaks.can_count(), reason="the C library has no mallinfo2"),
]


def left(*arguments: str | Path) -> dict[str, list[str]]:
    """Return what grew in a process of its own: by itself (""), and with each leak."""
    done = subprocess.run(
        [sys.executable, leaks.__file__, *arguments],
        env={**os.environ, **leaks.ENVIRONMENT},
        stdout=subprocess.PIPE,
        check=True,
    )
    return cast("dict[str, list[str]]", json.loads(done.stdout))


def check(name: str, folder: Path) -> None:
    """Nothing is left; a leak in each of 20 calls more is found, by the measure that is for it."""
    grew = left(name, folder, "--planted")
    assert grew.pop("") == []
    found = {leak: {text.split(":")[0] for text in texts} for leak, texts in grew.items()}
    assert found["objects"] == found["array"] == found["memory of C"] == {"bytes in use"}
    assert "resident bytes" in found["mapping"]
    assert "files" in found["file"]
    assert "threads" in found["thread"]


@pytest.mark.timeout(900)
def test_hundreds_of_captures_leave_nothing_behind(tmp_path: Path) -> None:
    check("captures", tmp_path)


@pytest.mark.timeout(900)
def test_hundreds_of_plans_leave_nothing_behind(tmp_path: Path) -> None:
    """One row for each second of 300, and that of all others: the settings, and their levels."""
    check("plans", tmp_path)
    assert len(list((tmp_path / "exposure").iterdir())) == 2 * (300 // 2 + 1)
