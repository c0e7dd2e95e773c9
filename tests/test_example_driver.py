"""The example driver, installed as a package of its own, is a camera like any other."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).parent / "example_driver"
MODULE = EXAMPLE / "camctl_example.py"
SUITE = """
from camctl import Camera, VirtualClock
from camctl.testing import CameraConformance
from camctl_example import ExampleCamera


class TestExample(CameraConformance):
    def open_camera(self) -> Camera:
        return ExampleCamera("bright", VirtualClock()).open()
"""
# Why checks are left out: the example has neither gain nor aperture nor a device behind it.
#: What the suite may skip for a camera with one control and none of its optional hooks.
SKIPPED = (
    "of the camera has one setting",
    "is not overridden: ",
    "the camera repeats no list of exposures",
    "frames are released one by one",
)

Python = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the installed example, and nothing else."""
    source = tmp_path_factory.mktemp("source") / "example"
    shutil.copytree(EXAMPLE, source)
    target = tmp_path_factory.mktemp("packages")
    quiet = ("--quiet", "--no-deps", "--no-build-isolation", "--no-index")
    words = [sys.executable, "-m", "pip", "install", *quiet, "--target", str(target), str(source)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    return target


@pytest.fixture
def python(packages: Path, tmp_path: Path) -> Python:
    """Run Python in an empty folder, with the example installed."""
    path = os.pathsep.join([str(packages), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep)
    environment = {**os.environ, "PYTHONPATH": path}

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, *arguments],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )

    return run


def camctl(python: Python, *arguments: str) -> subprocess.CompletedProcess[str]:
    return python("-c", "import sys; from camctl.cli import main; sys.exit(main())", *arguments)


def test_example_is_small_enough_to_read() -> None:
    assert len(MODULE.read_text().splitlines()) <= 50


def test_example_is_found_only_where_it_is_installed(tmp_path: Path) -> None:
    bare = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    done = subprocess.run(
        [sys.executable, "-c", "import camctl_example"],
        cwd=tmp_path,
        env=bare,
        capture_output=True,
        text=True,
        check=False,
    )
    assert "No module named 'camctl_example'" in done.stderr


def test_cameras_lists_the_example(python: Python) -> None:
    done = camctl(python, "cameras")
    assert done.returncode == 0
    cameras, backends = done.stdout.split("\n\n")
    assert "example:bright  camctl" in cameras
    assert "example:dim" in cameras
    assert "an example of a driver: a gradient of light" in backends


def test_shoot_takes_a_picture_with_the_example(python: Python, tmp_path: Path) -> None:
    done = camctl(python, "shoot", "--camera", "example:bright", "-n", "2", "-o", "x")
    assert done.returncode == 0, done.stderr
    # It has no noise, and states none.
    assert done.stderr.startswith("camctl: warning: the frames do not show the noise of ")
    assert done.stderr.count("\n") == 1
    report = json.loads((tmp_path / "x" / "report.json").read_text())
    assert report["status"] == "complete"
    assert report["camera"]["serial"] == "bright"
    assert all(frame["ratio"]["agrees"] for frame in report["frames"] if "ratio" in frame)
    assert (tmp_path / "x" / "radiance.exr").exists()


@pytest.mark.slow
def test_errors_of_the_example_are_one_line(python: Python) -> None:
    lines = {
        "--camera example:brigth": "1 no camera example:brigth; try bright",
        "--camera example:dim -O a=b": "2 unknown camera option 'a'; there are none",
        "--camera exampel:dim": "2 unknown camera 'exampel'; did you mean example?",
    }
    code = (
        "import sys; from camctl.cli import main; "
        "print(*(main(['shoot', *line.split()]) for line in sys.argv[1:]))"
    )
    done = python("-c", code, *lines)
    found = zip(done.stdout.split(), done.stderr.splitlines(), strict=True)
    assert [f"{status} {line.removeprefix('camctl: ')}" for status, line in found] == [
        *lines.values()
    ]


def test_example_passes_the_conformance_suite(python: Python, tmp_path: Path) -> None:
    (tmp_path / "test_suite.py").write_text(SUITE)
    done = python("-m", "pytest", "-q", "-rs", "-p", "no:cacheprovider", "test_suite.py")
    assert done.returncode == 0, done.stdout
    assert "passed" in done.stdout
    skipped = [line for line in done.stdout.splitlines() if line.startswith("SKIPPED")]
    assert [line for line in skipped if not any(reason in line for reason in SKIPPED)] == []
