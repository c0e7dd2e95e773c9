"""Small captures in folders, complete or not, and changes of their files."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from small_cameras import gradient, small_camera, sum_of_frames

from camctl.captures.sequencer import capture, resume
from camctl.errors import (
    CameraDisconnectedError,
)
from camctl.exposure.goal import CaptureRequest
from camctl.sim.camera import Faults

REQUEST = CaptureRequest(ratios=(1.0, 4.0), base_s=0.01)
LIGHT = gradient(12, 16)
FIRST = Path("frames/frame-01.npy")


def shoot(folder: Path, *, seed: int = 0, overwrite: bool = False) -> None:
    with small_camera(light=LIGHT, seed=seed) as camera:
        capture(camera, REQUEST, folder, overwrite=overwrite)


def complete(folder: Path) -> None:
    """Resume the capture; check that its sum is that of its frames."""
    with small_camera(light=LIGHT, seed=9) as camera:
        report = resume(camera, folder)
    assert np.array_equal(tifffile.imread(folder / "sum.tiff"), sum_of_frames(folder, report))


def one_of_two(folder: Path) -> Path:
    """Leave a capture with one frame of two in `folder`."""
    with (
        small_camera(light=LIGHT, faults=Faults(unplug_after=1)) as camera,
        pytest.raises(CameraDisconnectedError),
    ):
        capture(camera, REQUEST, folder)
    return folder


def edit(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    report = json.loads((folder / "report.json").read_text())
    change(report)
    (folder / "report.json").write_text(json.dumps(report))


def contents(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != ".camctl.lock"
    }
