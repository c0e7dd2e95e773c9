"""The menu and captures on a device without OpenCV, and what `requirements-device.txt` installs."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from importlib.metadata import requires
from pathlib import Path

ROOT = Path(__file__).parents[1]
SOME_TESTS = (
    "tests/menu/test_camera_job.py::test_settings_reviewed_are_the_settings_shot[0-1-3]",
    "tests/captures/test_contact_sheet.py",
    "tests/captures/test_picture_files.py",
)


def test_some_tests_of_menu_and_captures_pass_without_opencv() -> None:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *SOME_TESTS]
    without = {**os.environ, "CAMCTL_TEST_WITHOUT_OPENCV": "1", "PYTEST_ADDOPTS": ""}
    done = subprocess.run(command, cwd=ROOT, env=without, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-3000:]
    passed = re.search(r"(\d+) passed", done.stdout)
    assert passed is not None
    assert int(passed[1]) > 40


def test_device_requirements_are_the_dependencies_without_opencv() -> None:
    listed = {
        _name(line)
        for line in (ROOT / "requirements-device.txt").read_text().splitlines()
        if not line.startswith("#")
    }
    assert listed == _needed("camctl", set()) - {"camctl"}


def _needed(package: str, known: set[str]) -> set[str]:
    """Return a package and what it needs on Linux, without extras and without OpenCV."""
    known.add(package)
    for line in requires(package) or []:
        name = _name(line)
        if ";" not in line and name not in known and not name.startswith("opencv"):
            _needed(name, known)
    return known


def _name(requirement: str) -> str:
    found = re.match(r"[A-Za-z0-9._-]+", requirement)
    assert found is not None
    return re.sub(r"[-_.]+", "-", found[0]).lower()
