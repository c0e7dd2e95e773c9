"""What `resume` does with a complete capture, and impossible numbers in a report."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import camctl
from camctl.cli import main
from camctl.errors import DataError
from camctl.sim.camera import SimulatedCamera
from camctl.sim.scenes.scene import load_scene
from camctl.sim.sensors.sensor import load_sensor


@pytest.fixture
def camera() -> SimulatedCamera:
    return SimulatedCamera(load_scene("uniform", (12, 16)), load_sensor("standard"))


@pytest.fixture
def folder(tmp_path: Path, camera: SimulatedCamera) -> Path:
    request = camctl.CaptureRequest(ratios=(1.0, 2.0, 4.0), base_s=0.001)
    source = {"camera": "sim", "options": {"scene": "uniform", "size": "16x12"}}
    camctl.capture(camera, request, tmp_path / "out", source=source)
    return tmp_path / "out"


def edit(folder: Path, **changes: Any) -> None:
    path = folder / "report.json"
    report = json.loads(path.read_text())
    for name, value in changes.items():
        *place, last = name.split("__")
        part = report
        for key in place:
            part = part[int(key) if key.isdigit() else key]
        part[last] = value
    path.write_text(json.dumps(report))


def test_resume_names_a_frame_of_a_complete_capture_that_has_changed(
    folder: Path, camera: SimulatedCamera, capsys: pytest.CaptureFixture[str]
) -> None:
    path = folder / "frames" / "frame-02.npy"
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.write_bytes(data)
    with pytest.raises(DataError, match=r"frame-02\.npy cannot be read: .*checksum"):
        camctl.resume(camera, folder)
    assert main(["resume", str(folder)]) == 1
    assert "frame-02.npy" in capsys.readouterr().err


def test_resume_names_a_frame_of_a_complete_capture_that_is_missing(
    folder: Path, camera: SimulatedCamera
) -> None:
    (folder / "frames" / "frame-03.npy").unlink()
    with pytest.raises(DataError, match=r"cannot read .*frame-03\.npy"):
        camctl.resume(camera, folder)


@pytest.mark.parametrize(
    "changes",
    [
        {"frames__0__applied_s": 0},
        {"frames__2__requested_s": -1},
        {"plan__exposures": [1, 1e308, 1e308]},
        {"plan__exposures": [1, 2]},
    ],
)
def test_numbers_of_a_report_that_contradict_each_other_are_refused(
    folder: Path, changes: dict[str, Any]
) -> None:
    edit(folder, **changes)
    with pytest.raises(DataError, match="is damaged"):
        camctl.read_report(folder)
