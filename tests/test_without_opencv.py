"""The menu and captures on a device without OpenCV, and what `requirements-device.txt` installs."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import tomllib
from importlib.metadata import distribution, requires
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOME_TESTS = (
    "tests/menu/test_camera_job.py::test_settings_reviewed_are_the_settings_shot[0-1-3]",
    "tests/pictures/test_contact_sheet.py::test_nothing_overlaps_or_leaves_the_sheet",
    "tests/pictures/test_files.py::test_files_and_memory_hold_the_same_arrays",
    "tests/pictures/test_files.py::test_channels_of_radiance_exr",
)


@pytest.mark.slow
def test_some_tests_of_menu_and_captures_pass_without_opencv() -> None:
    options = ["-q", "-p", "no:cacheprovider", "-m", "not serial"]
    command = [sys.executable, "-m", "pytest", *options, *SOME_TESTS]
    without = {**os.environ, "CAMCTL_TEST_WITHOUT_OPENCV": "1", "PYTEST_ADDOPTS": ""}
    done = subprocess.run(command, cwd=ROOT, env=without, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-3000:]
    passed = re.search(r"(\d+) passed", done.stdout)
    assert passed is not None
    assert int(passed[1]) > 40


def test_device_requirements_are_the_dependencies_without_opencv() -> None:
    lines = (ROOT / "docs/how-to/requirements-device.txt").read_text().splitlines()
    assert {each for each in _dependencies() if not each.startswith("opencv")} <= {*lines}
    listed = {_name(line) for line in lines if not line.startswith("#")}
    assert listed == _needed("camctl", set()) - {"camctl"}


def test_the_command_beside_another_opencv_names_all_other_dependencies() -> None:
    page = (ROOT / "docs/how-to/install.md").read_text(encoding="utf-8")
    (command,) = re.findall(r"^pip install ('numpy.*)$", page, re.MULTILINE)
    needed = _dependencies()
    (opencv,) = [each for each in needed if each.startswith("opencv")]
    assert sorted(shlex.split(command)) == sorted(needed - {opencv})
    assert f"camctl works with each of the four, from version {opencv.split('>=')[1]} on." in page


def test_page_states_the_aarch64_wheels_of_all_compiled_dependencies() -> None:
    """Every dependency that is installed here with compiled code has its row."""
    needed = _needed("camctl", set(), without="") - {"camctl"}
    compiled = {name for name in needed if "Root-Is-Purelib: false" in _wheel_file(name)}
    page = (ROOT / "docs/how-to/menu.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| ([\w-]+) \| [\d.]+, `manylinux\w+_aarch64` \|", page, re.MULTILINE)
    assert {_name(row) for row in rows} == compiled


def _dependencies() -> set[str]:
    """Return the dependencies of pyproject.toml, with their least versions."""
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    return {*tomllib.loads(text)["project"]["dependencies"]}


def _wheel_file(package: str) -> str:
    return distribution(package).read_text("WHEEL") or ""


def _needed(package: str, known: set[str], without: str = "opencv") -> set[str]:
    """Return a package and what it needs on Linux, without extras and packages named `without`."""
    known.add(package)
    for line in requires(package) or []:
        name = _name(line)
        is_left_out = bool(without) and name.startswith(without)
        if ";" not in line and name not in known and not is_left_out:
            _needed(name, known, without)
    return known


def _name(requirement: str) -> str:
    found = re.match(r"[A-Za-z0-9._-]+", requirement)
    assert found is not None
    return re.sub(r"[-_.]+", "-", found[0]).lower()
