"""The same plan on several cameras at once, and the calibration of a camera, from the menu."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from ptp_bench import bench

from camctl import read_report
from camctl.errors import DataError, InterruptedCaptureError, StorageError, UsageError
from camctl.exposure.goal import CaptureRequest
from camctl.interface.camera import Camera
from camctl.menu.camera_job import CameraJob
from camctl.menu.data import CameraEntry, Choice, Progress, SeriesChoice
from camctl.menu.entries import rows
from camctl.menu.machine import step
from camctl.menu.model import Model, State
from camctl.menu.ports import Key
from camctl.menu.tables import Start, Work
from camctl.profiles.profile import load_profile
from camctl.records.folder_store import FolderStore
from camctl.sim.backend import SimulatedBackend

pytestmark = pytest.mark.usefixtures("own_profiles")
LOG = Choice("log", 1000.0, 3)
Cameras = dict[str, Camera]


def never() -> bool:
    return False


def ignored(_: Progress) -> None:
    pass


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., tuple[CameraJob, Cameras]]]:
    """Return a function that opens a job with cameras, by their options."""
    with ExitStack() as jobs:

        def begin(**options: dict[str, str]) -> tuple[CameraJob, Cameras]:
            opened: Cameras = {}

            def open_camera(camera_id: str, profile: str = "all") -> tuple[Camera, dict[str, Any]]:
                given = {"size": "48x32", **options[camera_id]}
                opened[camera_id] = SimulatedBackend().open("", given)
                return opened[camera_id], {"camera": camera_id}

            job = CameraJob(open_camera, tmp_path / "pictures", tmp_path / "menu.json")
            jobs.callback(job.close)
            job.open(" + ".join(options))
            return job, opened

        yield begin


def shots(camera: Camera, monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Return a list that gets the time of each call of `shoot`."""
    times: list[float] = []
    shoot = camera.shoot

    def timed(settings: Any) -> Any:
        times.append(time.monotonic())
        return shoot(settings)

    monkeypatch.setattr(camera, "shoot", timed)
    return times


def test_each_camera_shoots_the_exposures_of_the_first_into_its_own_folder(
    start: Callable[..., tuple[CameraJob, Cameras]], tmp_path: Path
) -> None:
    job, _ = start(a={"sensor": "phone"}, b={"sensor": "consumer"}, c={"sensor": "phone"})
    summary = job.shoot(job.plan(LOG, never), ignored, never)
    folders = sorted((tmp_path / "pictures").iterdir())
    reports = [read_report(folder) for folder in folders]
    assert [each.source["camera"] for each in reports] == ["a", "b", "c"]
    first = [frame.requested.time_s for frame in reports[0].frames if frame is not None]
    for report in reports[1:]:
        times = [frame.requested.time_s for frame in report.frames if frame is not None]
        assert times == pytest.approx(first, rel=0.02)  # the steps of a rolling shutter
    assert [folder.name in note for folder, note in zip(folders[1:], summary.notes, strict=False)]
    assert summary.folder == str(folders[0])
    assert len(job.captures()) == 3


def test_no_camera_begins_before_all_are_ready(
    start: Callable[..., tuple[CameraJob, Cameras]], monkeypatch: pytest.MonkeyPatch
) -> None:
    job, cameras = start(a={}, b={})
    plan = job.plan(LOG, never)
    times = [shots(camera, monkeypatch) for camera in cameras.values()]
    create, late_s = FolderStore.create, []

    def slow(path: Path, **options: Any) -> Any:
        if path.name.startswith("capture-0002"):
            time.sleep(0.5)
            late_s.append(time.monotonic())
        return create(path, **options)

    monkeypatch.setattr(FolderStore, "create", slow)
    job.shoot(plan, ignored, never)
    assert min(each[0] for each in times) >= late_s[0]


def test_nothing_that_takes_time_comes_between_the_first_frames(
    start: Callable[..., tuple[CameraJob, Cameras]], monkeypatch: pytest.MonkeyPatch
) -> None:
    job, cameras = start(a={}, b={}, c={})
    plan = job.plan(LOG, never)
    events: list[str] = []
    all_asked = threading.Barrier(len(cameras))

    def asked(shoot: Callable[[Any], Any], settings: Any) -> Any:
        events.append("asked")
        all_asked.wait(10)  # no frame arrives before all were asked
        return shoot(settings)

    for camera in cameras.values():
        monkeypatch.setattr(camera, "shoot", partial(asked, camera.shoot))

    def slow(_: Progress) -> None:
        time.sleep(0.05)
        events.append("shown")

    job.shoot(plan, slow, never)
    first = events.index("asked")
    assert events[first : first + 3] == ["asked"] * 3
    assert "shown" in events[:first]


def test_no_camera_begins_where_one_of_them_cannot(
    start: Callable[..., tuple[CameraJob, Cameras]], monkeypatch: pytest.MonkeyPatch
) -> None:
    job, cameras = start(a={}, b={})
    plan = job.plan(LOG, never)
    times = [shots(camera, monkeypatch) for camera in cameras.values()]
    create = FolderStore.create

    def full(path: Path, **options: Any) -> Any:
        if path.name.startswith("capture-0002"):
            raise StorageError("the disk is full", hint="delete captures")
        return create(path, **options)

    monkeypatch.setattr(FolderStore, "create", full)
    with pytest.raises(StorageError, match="the disk is full"):
        job.shoot(plan, ignored, never)
    assert times == [[], []]


def test_a_camera_that_fails_later_leaves_the_others_their_pictures(
    start: Callable[..., tuple[CameraJob, Cameras]],
) -> None:
    job, _ = start(a={"faults": "unplug@1"}, b={})
    summary = job.shoot(job.plan(LOG, never), ignored, never)
    assert summary.folder.rpartition("/")[2].startswith("capture-0002")
    assert "1 of 3 frames" in summary.notes[0]
    assert [each.is_complete for each in job.captures()] == [True, False]


def test_all_end_where_the_capture_is_cancelled(
    start: Callable[..., tuple[CameraJob, Cameras]],
) -> None:
    job, _ = start(a={}, b={})
    plan = job.plan(LOG, never)
    seen: list[Progress] = []
    with pytest.raises(InterruptedCaptureError):
        job.shoot(plan, seen.append, lambda: any(each.stage == "shooting" for each in seen))
    assert [each.is_complete for each in job.captures()] == [False, False]


def test_what_several_cameras_cannot_do_is_refused(
    start: Callable[..., tuple[CameraJob, Cameras]],
) -> None:
    job, _ = start(a={}, b={})
    with pytest.raises(UsageError, match="an automatic response follows the light of one camera"):
        job.plan(Choice("auto", None), never)
    with pytest.raises(UsageError, match="a series is taken with one camera"):
        job.series(SeriesChoice(LOG, 2, None), ignored, never)


def test_bodies_of_two_makers_take_one_picture_together(tmp_path: Path) -> None:
    pairs = {"ptp:N": bench(vendor="nikon"), "ptp:C": bench(vendor="canon")}
    job = CameraJob(
        lambda each: (pairs[each].camera(), {}),
        tmp_path / "pictures",
        tmp_path / "menu.json",
        request=CaptureRequest(base_s=1 / 60),
    )
    try:
        assert job.open("ptp:N + ptp:C").name.count(" + ") == 1
        assert (reading := job.meter()).lens == "18-55 mm f/3.5-5.6"
        assert reading.mode == "M"
        summary = job.shoot(job.plan(LOG, never), ignored, never)
        assert "EOS" in summary.notes[0]
        models = [
            read_report(each).camera.model for each in sorted((tmp_path / "pictures").iterdir())
        ]
        assert models == ["D7000 (virtual)", "EOS 5D (virtual)"]
    finally:
        job.close()


def test_cameras_are_marked_and_opened_together() -> None:
    cameras = tuple(CameraEntry(each, f"camera {each}") for each in "abc")
    model = Model(state=State.CAMERAS, cameras=cameras, cursor=3)
    model, _ = step(model, Key.ENTER)
    assert model.state is State.SEVERAL
    assert [row.labels[0] for row in rows(model)][-1] == "Use all 3"
    for key in (Key.ENTER, Key.DOWN, Key.DOWN, Key.ENTER, Key.DOWN):
        model, _ = step(model, key)
    assert [row.labels[0] for row in rows(model)] == [
        *("[x] camera a", "[ ] camera b", "[x] camera c"),
        "Use these 2",
    ]
    model, effect = step(model, Key.ENTER)
    assert effect == Start(model.request_id, Work.OPEN, "a + c")
    assert model.settings.camera == "a + c"


def test_a_calibration_says_what_each_step_has_measured_and_keeps_it(
    start: Callable[..., tuple[CameraJob, Cameras]],
) -> None:
    job, cameras = start(a={"size": "160x120"})
    seen: list[Progress] = []
    found = job.calibrate("still", seen.append, never)
    parts = ("control delay: ", "response: ", "exposures: ", "noise: ")
    assert [part for part in parts if any(part in line for line in found.lines)] == list(parts)
    assert len(seen[-1].lines) >= 3
    assert load_profile(cameras["a"].info).noises
    with pytest.raises(DataError, match="put the lens cap on"):
        job.calibrate("covered", ignored, never)


def test_a_calibration_can_be_cancelled(
    start: Callable[..., tuple[CameraJob, Cameras]],
) -> None:
    job, _ = start(a={"size": "320x240"})
    seen: list[Progress] = []
    with pytest.raises(InterruptedCaptureError):
        job.calibrate("still", seen.append, lambda: any(each.stage == "response" for each in seen))
    assert {each.stage for each in seen} == {"control delay", "response"}
