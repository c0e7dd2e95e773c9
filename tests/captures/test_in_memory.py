"""Captures in memory: the same pictures as in a folder, and nothing on disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from sampling import some
from small_cameras import small_camera

import camctl
from camctl.captures.sequencer import capture
from camctl.errors import CameraDisconnectedError, DataError, InterruptedCaptureError
from camctl.exposure.goal import CaptureRequest
from camctl.records.folder_store import read_report
from camctl.sim.camera import Faults

GIVEN = CaptureRequest("log", 1000.0, ratios=(1.0, 4.0, 16.0))


@pytest.fixture(autouse=True)
def empty_working_directory(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> Path:
    """A working directory in which a file would be noticed."""
    folder = tmp_path_factory.mktemp("here")
    monkeypatch.chdir(folder)
    return folder


@pytest.mark.parametrize("sensor", some(["standard", "phone", "machine-vision"], every=3))
def test_pictures_are_those_of_a_capture_in_a_folder(
    sensor: str, tmp_path: Path, empty_working_directory: Path
) -> None:
    with small_camera(sensor, seed=3) as camera:
        in_memory = capture(camera, GIVEN)
    assert list(empty_working_directory.iterdir()) == []
    with small_camera(sensor, seed=3) as camera:
        in_folder = capture(camera, GIVEN, tmp_path / "out")
    for report in (in_folder, read_report(tmp_path / "out")):
        for name in ("radiance", "mask", "image", "sum"):
            expected, found = getattr(report, name)(), getattr(in_memory, name)()
            assert expected.dtype == found.dtype
            assert np.array_equal(expected, found)
        for position in range(3):
            assert np.array_equal(report.frame(position), in_memory.frame(position))
        assert report.achieved == in_memory.achieved
        assert report.irradiance == in_memory.irradiance
    assert in_memory.files == {}
    assert [frame.file for frame in in_memory.frames] == [None] * 3


def test_path_may_be_a_string(empty_working_directory: Path) -> None:
    with small_camera() as camera:
        report = capture(camera, GIVEN, "out")
    assert (empty_working_directory / "out" / "report.json").exists()
    assert np.array_equal(read_report("out").radiance(), report.radiance())


def test_failure_reports_that_the_frames_are_lost() -> None:
    message = (
        "2 of 3 frames were taken and are lost; capture again, into a folder to keep the frames"
    )
    with (
        small_camera(faults=Faults(unplug_after=2)) as camera,
        pytest.raises(CameraDisconnectedError, match=message),
    ):
        capture(camera, GIVEN)
    with small_camera() as camera, pytest.raises(InterruptedCaptureError, match="are lost"):
        capture(camera, GIVEN, cancelled=lambda: True)


def test_report_without_its_folder_has_no_pictures() -> None:
    with small_camera() as camera:
        report = capture(camera, GIVEN)
    alone = type(report).model_validate_json(report.model_dump_json())
    with pytest.raises(DataError, match=r"has no pictures.*camctl\.read_report"):
        alone.radiance()


def test_plan_of_another_request_is_refused() -> None:
    with camctl.open_camera("sim", scene="uniform", size="64x48") as camera:
        plan = camctl.plan_capture(camera, camctl.CaptureRequest(ratios=(1, 4)))
        with pytest.raises(camctl.UsageError, match="is not of this request"):
            camctl.capture(camera, camctl.CaptureRequest("linear", ratios=(1, 4)), plan=plan)


def test_frame_out_of_range_is_a_usage_error() -> None:
    with camctl.open_camera("sim", scene="uniform", size="64x48") as camera:
        report = camctl.capture(camera, camctl.CaptureRequest(ratios=(1, 4)))
    with pytest.raises(camctl.UsageError, match="invalid frame position 2: expected 0 to 1"):
        report.frame(2)


def test_a_capture_of_one_exposure_has_no_measured_noise() -> None:
    with camctl.open_camera("sim", scene="ramp", size="64x48") as camera:
        report = camctl.capture(camera, camctl.CaptureRequest(ratios=(1,)))
    assert report.radiance().shape == (48, 64)
