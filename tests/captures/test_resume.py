"""Captures that fail, are interrupted or damaged, and how they are resumed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile
from small_cameras import gradient, small_camera, sum_of_frames

from camctl.captures.sequencer import capture, resume
from camctl.errors import (
    CameraDisconnectedError,
    CameraError,
    CameraTimeoutError,
    DataError,
)
from camctl.exposure.goal import CaptureRequest
from camctl.records.folder_store import read_capture, read_report
from camctl.sim.camera import Faults

GIVEN = CaptureRequest("log", 1000.0, ratios=(1.0, 4.0, 16.0))


@pytest.mark.parametrize(
    ("faults", "kind"),
    [
        (Faults(unplug_after=2), CameraDisconnectedError),
        (Faults(freeze_after=2), CameraTimeoutError),
    ],
)
def test_frames_before_a_failure_are_kept_and_resume_completes_them(
    tmp_path: Path, faults: Faults, kind: type[CameraError]
) -> None:
    with small_camera(faults=faults) as camera, pytest.raises(kind) as failure:
        capture(camera, GIVEN, tmp_path / "out")
    assert str(failure.value).endswith("; 2 of 3 frames are kept; shoot the others")
    assert failure.value.remedies == {"resume": tmp_path / "out"}
    assert "\n" not in str(failure.value)
    kept = [np.load(tmp_path / "out" / "frames" / f"frame-0{k}.npy") for k in (1, 2)]
    assert read_capture(tmp_path / "out").status == "incomplete"
    with pytest.raises(DataError, match="holds an incomplete capture; shoot its other frames"):
        read_report(tmp_path / "out")
    with small_camera(seed=1) as camera:
        report = resume(camera, tmp_path / "out")
    assert report.status == "complete"
    for k, before in enumerate(kept, start=1):
        assert np.array_equal(np.load(tmp_path / "out" / "frames" / f"frame-0{k}.npy"), before)
    total = sum_of_frames(tmp_path / "out", report)
    assert np.array_equal(tifffile.imread(tmp_path / "out" / "sum.tiff"), total)


def test_advice_of_a_resumed_capture_is_to_clip_less_where_that_was_asked_for(
    tmp_path: Path,
) -> None:
    """A smaller aperture changes nothing: the exposure is metered again."""
    request = CaptureRequest(dynamic_range=256.0, count=2, clip_percent=20.0)
    with (
        small_camera("standard", gradient(), Faults(unplug_after=1)) as camera,
        pytest.raises(CameraDisconnectedError),
    ):
        capture(camera, request, tmp_path / "out")
    with small_camera("standard", gradient()) as camera:
        (finding,) = resume(camera, tmp_path / "out").findings
    assert (finding.code, finding.remedies) == ("light_above_range", {"clip_percent": False})


@pytest.fixture
def unfinished(tmp_path: Path) -> Path:
    """A folder with two frames of three."""
    with (
        small_camera(faults=Faults(unplug_after=2)) as camera,
        pytest.raises(CameraDisconnectedError),
    ):
        capture(camera, GIVEN, tmp_path / "out")
    return tmp_path / "out"


def test_resume_shoots_a_frame_again_whose_file_is_missing(unfinished: Path) -> None:
    (unfinished / "frames" / "frame-01.npy").unlink()
    with small_camera() as camera:
        assert resume(camera, unfinished).status == "complete"


@pytest.mark.parametrize("content", [b"\x93NUMPY", b""])
def test_resume_names_a_damaged_frame(unfinished: Path, content: bytes) -> None:
    (unfinished / "frames" / "frame-01.npy").write_bytes(content)
    with small_camera() as camera, pytest.raises(DataError, match=r"frame-01.npy cannot be read"):
        resume(camera, unfinished)


def test_resume_refuses_complete_captures_other_cameras_and_empty_folders(tmp_path: Path) -> None:
    with small_camera() as camera:
        capture(camera, GIVEN, tmp_path / "out")
        with pytest.raises(DataError, match="is complete: all"):
            resume(camera, tmp_path / "out")
    named = (
        r"was begun with camctl simulated \w+, and this camera is camctl simulated phone; connect"
    )
    with small_camera("phone") as camera, pytest.raises(DataError, match=named):
        resume(camera, tmp_path / "out")
    with small_camera() as camera:
        camera._info = replace(camera.info, serial="N2")
        with pytest.raises(
            DataError, match=r"begun with the camctl simulated (.+) \1, and this camera is N2;"
        ):
            resume(camera, tmp_path / "out")
    with (
        small_camera() as camera,
        pytest.raises(DataError, match=r"holds no capture: report\.json"),
    ):
        resume(camera, tmp_path / "nowhere")


def test_resume_refuses_another_format(unfinished: Path) -> None:
    with (
        small_camera(layout="rgb") as camera,
        pytest.raises(DataError, match="was begun in another format of the camera; set the same"),
    ):
        resume(camera, unfinished)
