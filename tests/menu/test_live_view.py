"""The menu shows the effective camera live where the camera streams."""

from __future__ import annotations

from pathlib import Path

import pytest

import camctl
from camctl.interface.camera import Camera
from camctl.menu import live_view
from camctl.menu.camera_job import CameraJob
from camctl.menu.data import Choice, Reading
from camctl.menu.model import Model, State
from camctl.menu.screens import screen
from camctl.sim.camera import SimulatedCamera


def job_with(folder: Path, time: str = "real", **options: str) -> tuple[CameraJob, SimulatedCamera]:
    chosen = {"scene": "ramp", "size": "64x48", "time": time, **options}
    camera = camctl.open_camera("sim", chosen)
    assert isinstance(camera, SimulatedCamera)
    return CameraJob(lambda _: (camera.open(), {}), folder, folder / "menu.json"), camera


def test_a_camera_that_streams_is_shown_live(tmp_path: Path) -> None:
    job, camera = job_with(tmp_path)
    job.open("")
    try:
        first, second, third = (job.meter() for _ in range(3))
        assert first.rate == 0.0
        assert second.rate is not None
        assert third.rate is not None
        assert third.rate > 0.5
        assert third.picture is not None
        assert third.picture.columns == 64
        assert sum(third.histogram) == pytest.approx(1)
        # What else needs the camera ends the stream.
        plan = job.plan(Choice("log", 256.0, 2, None), lambda: False)
        assert len(plan.frames) == 2
        assert job.meter().rate == 0.0
    finally:
        job.close()
    assert camera.open()._is_shooting is False
    camera.close()


def test_a_stream_that_nobody_looks_at_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_view, "_UNSEEN_S", 0.05)
    job, camera = job_with(tmp_path)
    job.open("")
    job.meter()
    timer = job._view._timer
    assert timer is not None
    timer.join(10)
    assert job._view._live is None
    assert job.meter().rate == 0.0
    job.close()
    camera.close()


@pytest.mark.parametrize(
    ("camera_id", "options"),
    [("effective:sim", {"range": "low", "bits": "8"}), ("sim", {"unknown": "yes"})],
)
def test_cameras_that_state_no_control_delay_are_shown_live(
    tmp_path: Path, camera_id: str, options: dict[str, str]
) -> None:
    chosen = {"scene": "ramp", "size": "64x48", "time": "real"} | options
    camera = camctl.open_camera(camera_id, chosen)
    assert camera.controls.delay_frames is None

    def opened(_: str) -> tuple[Camera, dict[str, str]]:
        camera.open()  # type: ignore[attr-defined]
        return camera, {}

    job = CameraJob(opened, tmp_path, tmp_path / "menu.json")
    job.open("")
    try:
        rates = [job.meter().rate for _ in range(3)]
    finally:
        job.close()
        camera.close()
    assert rates[0] == 0.0
    assert rates[2] is not None
    assert rates[2] > 0.5


def test_a_camera_in_virtual_time_shows_the_exposure_meter(tmp_path: Path) -> None:
    job, camera = job_with(tmp_path, "virtual")
    job.open("")
    assert job.meter().rate is None
    job.close()
    camera.close()


def test_the_rate_is_on_the_screen() -> None:
    reading = Reading(time_s=1 / 250, rate=8.24, free_bytes=10**9)
    shown = screen(Model(state=State.IDLE, reading=reading))
    assert "8.2/s" in shown.lines[0].texts[0]
    assert "8.2/s" in shown.lines[0].texts[-1]
