"""What needs no Linux device runs where the modules of POSIX systems are missing."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

BLOCKED = ("curses", "fcntl", "grp", "pwd", "resource", "termios", "tty")
BLOCKER = f"""
import sys

for name in {BLOCKED}:
    sys.modules[name] = None  # an import of it raises ImportError
"""


def run(code: str, folder: Path) -> str:
    """Return what code prints in a fresh interpreter without the modules `BLOCKED`."""
    done = subprocess.run(
        [sys.executable, "-c", BLOCKER + textwrap.dedent(code)],
        cwd=folder,
        env={**os.environ, "CAMCTL_PROFILES": str(folder / "profiles")},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_blocked_modules_are_missing(tmp_path: Path) -> None:
    code = f"""
        from importlib import import_module

        for name in {BLOCKED}:
            try:
                import_module(name)
            except ImportError as error:
                print(error.name)
    """
    assert run(code, tmp_path).split() == [*BLOCKED]


def test_capture_with_the_simulated_camera(tmp_path: Path) -> None:
    code = """
        import camctl

        with camctl.open_camera("sim", size="64x48") as camera:
            report = camctl.capture(camera, camctl.CaptureRequest(ratios=(1, 4)), "out")
        print(report.status, report.radiance().shape)
    """
    assert run(code, tmp_path) == "complete (48, 64)\n"


@pytest.mark.slow
def test_v4l2_backend_reports_that_it_needs_linux(tmp_path: Path) -> None:
    code = """
        import camctl

        print(*(camera.id for camera in camctl.list_cameras()))
        for listing in camctl.list_backends():
            if listing.name == "v4l2":
                print(listing.problem)
        try:
            camctl.open_camera("v4l2:/dev/video0")
        except camctl.CameraError as error:
            print(error)
    """
    cameras, *problems = run(code, tmp_path).splitlines()
    assert "sim" in cameras.split()
    assert problems == ["V4L2 cameras need Linux; choose another camera"] * 2


@pytest.mark.slow
def test_commands_that_need_no_device(tmp_path: Path) -> None:
    code = """
        from camctl.cli import main

        for line in (
            "shoot -O size=64x48 --ratios 1,4 -o out",
            "solve -n 2 --bits 4",
            "cameras",
            "calibrate delay --camera sim -O size=32x24 --trials 4",
            "profile list",
        ):
            print("$", line, flush=True)
            assert main(line.split()) == 0, line
    """
    printed = [part.partition("\n")[2] for part in run(code, tmp_path).split("$ ")[1:]]
    assert (tmp_path / "out" / "radiance.exr").exists()
    assert "exposures" in printed[1]
    assert "sim" in printed[2]
    assert "simulated standard" in printed[4]
