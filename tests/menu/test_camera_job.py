"""The menu with the simulated camera: the settings reviewed are the settings shot."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from panel_fakes import TO_REVIEW, Script, ScriptedPanel, quit_from
from ptp_bench import bench

import camctl
from camctl import read_report
from camctl.captures.series_sets import CameraSets
from camctl.errors import (
    CaptureError,
    DataError,
    InterruptedCaptureError,
    StorageError,
    UsageError,
)
from camctl.exposure.goal import CaptureRequest
from camctl.interface.camera import Frame
from camctl.interface.controls import ExposureSetting
from camctl.menu.app import run
from camctl.menu.camera_job import CameraJob
from camctl.menu.capture_list import list_captures, next_folder
from camctl.menu.data import Choice, Past, Reading, SeriesChoice, Settings
from camctl.menu.entries import METERINGS, choice, requested
from camctl.menu.layout import grid
from camctl.menu.model import Goal, Model, State
from camctl.menu.ports import Key
from camctl.menu.screens import screen
from camctl.menu.studio.sight import Sight
from camctl.menu.thumbnails import focus_value
from camctl.messages.menu import error_text
from camctl.sim.camera import Faults, SimulatedCamera
from camctl.sim.scenes.scene import load_scene
from camctl.sim.sensors.sensor import load_sensor

SIZE = (60, 16)


class RecordingCamera(SimulatedCamera):
    """Records the lists of settings that it shoots, and calls `on_frame` before each frame."""

    def __init__(self, faults: Faults | None = None, *, sensor: str = "phone") -> None:
        scene = load_scene("tile-floor", (24, 32))
        # With the same noise in every frame, two plans of the same light are equal.
        super().__init__(scene, load_sensor(sensor), faults=faults, repeat_noise=True)
        self.lists: list[tuple[ExposureSetting, ...]] = []
        self.on_frame: Callable[[], object] = lambda: None

    def shoot(self, settings: Sequence[ExposureSetting]) -> Generator[Frame, None, None]:
        self.lists.append(tuple(settings))
        return self._recorded(super().shoot(settings))

    def _recorded(self, frames: Iterable[Frame]) -> Generator[Frame, None, None]:
        for frame in frames:
            self.on_frame()
            yield frame


def job_with(
    camera: SimulatedCamera, parent: Path, request: CaptureRequest | None = None
) -> CameraJob:
    """Return the job of a camera; opening it again returns the same camera."""
    return CameraJob(
        lambda camera_id: (camera.open(), {"camera": camera_id or "sim"}),
        parent,
        parent / "menu.json",
        request=request,
    )


def never() -> bool:
    return False


@pytest.fixture
def camera() -> Iterator[RecordingCamera]:
    with RecordingCamera() as opened:
        yield opened


@pytest.mark.parametrize(
    ("response", "dynamic_range", "count"),
    [
        (0, 1, 3),
        *(
            pytest.param(*each, marks=pytest.mark.slow)
            for each in ((0, 0, 1), (1, 2, 2), (2, 0, 4))
        ),
    ],
)
def test_settings_reviewed_are_the_settings_shot(
    camera: RecordingCamera, tmp_path: Path, response: int, dynamic_range: int, count: int
) -> None:
    script: Script = [TO_REVIEW[0]]
    script += [("Desired", Key.DOWN)] * response + [("Desired", Key.ENTER)]
    script += [("Dynamic", Key.UP)] * 3 + [("Dynamic", Key.DOWN)] * dynamic_range
    script += [("Dynamic", Key.ENTER)]
    script += [("Exposures", Key.UP)] * 8 + [("Exposures", Key.DOWN)] * (count + 1)
    script += [("Exposures", Key.ENTER)]
    panel = ScriptedPanel(script, SIZE)
    reviewed: list[str] = []
    panel.script += [("Review", lambda: reviewed.extend(panel.lines)), ("Review", Key.ENTER)]
    panel.script += quit_from("Done")
    summary = run(panel, lambda: job_with(camera, tmp_path))

    assert summary is not None
    report = read_report(summary.folder)
    assert report.source == {"camera": "sim"}
    assert camera.lists[-1] == report.plan.settings
    assert len(report.plan.settings) == count
    for place, setting in enumerate(report.plan.settings, start=1):
        (line,) = [each for each in reviewed if each.startswith(f"{place} ")]
        value, unit, *_ = line.split()[1:]
        factor = {"s": 1.0, "ms": 1e-3, "us": 1e-6}[unit]
        assert float(value) * factor == pytest.approx(setting.time_s, rel=1e-6, abs=0)
    assert summary.effective_levels == report.achieved.effective_levels
    assert summary.picture is not None
    assert summary.histogram == tuple(report.achieved.light_shares)


def test_predicted_costs_are_those_of_the_plan(camera: RecordingCamera, tmp_path: Path) -> None:
    job = job_with(camera, tmp_path)
    choices = [
        Choice("log", 1000.0, 3),
        Choice("linear", 256.0, 2),
        Choice("auto", 1000.0, 2),
        Choice("log", None, 2),
        Choice("log", 1000.0, time_budget_s=0.5),
    ]
    for asked, cost in zip(choices, job.predict(choices, never), strict=True):
        plan = job.plan(asked, never)
        assert cost.problem == ""
        assert cost.count == len(plan.frames)
        assert cost.effective_levels == pytest.approx(plan.effective_levels)
        assert cost.shutter_s == pytest.approx(plan.shutter_s)
        assert cost.wall_s is not None


def test_impossible_choice_says_why(camera: RecordingCamera, tmp_path: Path) -> None:
    job = job_with(camera, tmp_path)
    (cost,) = job.predict([Choice("log", 1000.0, time_budget_s=1e-3)], never)
    assert "0.001 s" in cost.problem


@pytest.mark.slow
def test_points_of_the_front_are_planned_as_they_are_listed(
    camera: RecordingCamera, tmp_path: Path
) -> None:
    job = job_with(camera, tmp_path)
    front = job.trace(Choice("log", None), never).points
    assert [point.is_recommended for point in front].count(True) == 1
    assert max(point.count for point in front) > 6
    assert [point.effective_levels for point in front] == sorted(p.effective_levels for p in front)
    for point in (front[0], front[-1]):
        assert point.wall_s is not None
        model = Model(goal=Goal.FRONT, point=(point, choice(Settings(), Goal.FRONT)))
        plan = job.plan(requested(model), never)
        assert plan.dynamic_range == point.dynamic_range
        assert plan.effective_levels == pytest.approx(point.effective_levels, rel=0.02)


def test_brackets_that_cameras_offer_are_not_better_than_the_front(
    camera: RecordingCamera, tmp_path: Path
) -> None:
    job = CameraJob(lambda _: (camera, {}), tmp_path, tmp_path / "menu.json", sight=Sight())
    traced = job.trace(Choice("log", 256.0), never)
    assert {(rival.count, rival.stops) for rival in traced.rivals} >= {(3, 1), (5, 1), (3, 2)}
    for rival in traced.rivals:
        asked = Choice("log", 256.0, time_budget_s=rival.wall_s)
        assert job.plan(asked, never).effective_levels > 0.998 * rival.effective_levels


def test_without_noise_there_is_no_front(tmp_path: Path) -> None:
    with camctl.open_camera("sim", unknown="yes", size="32x24", profile="none") as unknown:
        job = CameraJob(lambda _: (unknown, {}), tmp_path, tmp_path / "menu.json")
        with pytest.raises(UsageError, match="the noise of this camera is unknown"):
            job.trace(Choice("log", 1000.0), never)


def test_prediction_ends_when_it_is_cancelled(camera: RecordingCamera, tmp_path: Path) -> None:
    job = job_with(camera, tmp_path)
    assert list(job.predict([Choice("log", 1000.0, 3)] * 3, lambda: True)) == []


def test_request_supplies_what_the_menu_does_not_ask_for(
    camera: RecordingCamera, tmp_path: Path
) -> None:
    request = CaptureRequest(base_s=0.002, ratios=(1.0, 2.0))
    plan = job_with(camera, tmp_path, request).plan(Choice("gamma", 256.0, 3), never)
    assert len(plan.frames) == 3
    assert plan.frames[0][0].startswith("2 ms") or plan.frames[0][0].startswith("1.99")


def test_cancelled_capture_is_listed_and_resumed(camera: RecordingCamera, tmp_path: Path) -> None:
    job = job_with(camera, tmp_path)
    plan = job.plan(Choice("log", 1000.0, 3), never)
    frames: list[int] = []
    camera.on_frame = lambda: frames.append(1)
    with pytest.raises(CaptureError, match="1 of 3 frames are kept; shoot the others"):
        job.shoot(plan, lambda progress: None, lambda: bool(frames))
    camera.on_frame = lambda: None
    (past,) = job.captures()
    assert not past.is_complete
    assert job.load().unfinished == 1
    summary = job.resume(past, lambda progress: None, never)
    (complete,) = job.captures()
    assert complete.is_complete
    assert job.look(complete) == summary


def test_camera_that_was_unplugged_is_opened_again(tmp_path: Path) -> None:
    script: Script = [*TO_REVIEW, ("Review", Key.ENTER), ("Capture failed", Key.ENTER)]
    panel = ScriptedPanel([*script, ("Review", Key.ENTER), *quit_from("Done")], SIZE)
    opened: list[RecordingCamera] = []

    def open_camera(_: str) -> tuple[RecordingCamera, dict[str, str]]:
        opened.append(RecordingCamera(None if opened else Faults(unplug_after=1)))
        return opened[-1].open(), {}

    job = CameraJob(open_camera, tmp_path, tmp_path / "menu.json")
    assert run(panel, lambda: job) is not None
    assert len(opened) == 2
    failed = next(lines for lines in panel.screens if lines[0].startswith("Capture failed"))
    assert re.search(r"\b1 of \d frames are kept", " ".join(" ".join(failed).split()))


def test_reading_shows_the_light(camera: RecordingCamera, tmp_path: Path) -> None:
    reading = job_with(camera, tmp_path).meter()
    assert reading.time_s > 0
    assert sum(reading.histogram) == pytest.approx(1.0)
    assert reading.picture is not None
    assert len(reading.picture.rgb) == 3 * reading.picture.columns * reading.picture.rows
    assert reading.free_bytes > 0


def test_capture_that_needs_more_space_than_is_free_is_refused(
    camera: RecordingCamera, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = job_with(camera, tmp_path)
    monkeypatch.setattr(CameraJob, "_free_bytes", lambda _: 1000)
    with pytest.raises(StorageError, match="the capture needs 0 MB, and 0 MB are free"):
        job.plan(Choice("log", 1000.0, 3), never)


def test_a_capture_works_without_opencv_and_says_what_is_missing(
    camera: RecordingCamera, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    monkeypatch.setitem(sys.modules, "tifffile", None)
    job = job_with(camera, tmp_path)
    assert job.meter().picture is not None
    plan = job.plan(Choice("log", 1000.0, 2), never)
    with pytest.raises(UsageError, match="tifffile is not installed; install it with: pip inst"):
        job.shoot(plan, lambda progress: None, never)
    assert camera.lists == []
    monkeypatch.undo()
    monkeypatch.setitem(sys.modules, "cv2", None)
    summary = job.shoot(plan, lambda progress: None, never)
    assert {"sum.tiff", "preview.png", "contact.png"} <= {
        p.name for p in Path(summary.folder).iterdir()
    }


def test_names_count_up_whatever_the_clock_shows(tmp_path: Path) -> None:
    unset, later = datetime(1970, 1, 1, 0, 0, 9), datetime(2030, 5, 6, 7, 8, 9)
    names = []
    for now in (later, unset, unset, later):
        folder = next_folder(tmp_path, now)
        folder.mkdir()
        (folder / "report.json").write_text('{"status": "complete"}')
        names.append(folder.name)
    assert names == [
        "capture-0001-20300506-070809",
        "capture-0002",
        "capture-0003",
        "capture-0004-20300506-070809",
    ]
    assert list_captures(tmp_path) == tuple(Past(name, True) for name in reversed(names))


def test_result_shows_what_is_darker_than_the_range(tmp_path: Path) -> None:
    """The small picture is the preview: in the image most of the room is black."""
    camera = SimulatedCamera(load_scene("room", (96, 128)), load_sensor("phone"))
    job = job_with(camera, tmp_path)
    job.open("")
    plan = job.plan(Choice("log", 1000.0, count=3), never)
    shot = job.shoot(plan, lambda _: None, never)
    (past,) = job.captures()
    report = read_report(shot.folder)
    assert np.mean(report.image() == 0) > 0.5
    for summary in (shot, job.look(past)):
        assert summary.picture is not None
        shown = np.frombuffer(summary.picture.rgb, np.uint8)
        assert shown.size == 96 * 128 * 3
        assert np.mean(shown < 16) < 0.1
    (Path(shot.folder) / "preview.png").write_bytes(b"")
    with pytest.raises(DataError, match="PNG"):
        job.look(past)
    # Three bytes for each of 2560 x 2560 pixels, and a third more.
    os.truncate(Path(shot.folder) / "preview.png", 4 * 2560**2 + 1)
    with pytest.raises(DataError, match=r"preview\.png: it is larger than 25 MiB"):
        job.look(past)
    job.close()


SERIES = SeriesChoice(Choice("log", 1000.0, count=2), 3, 30.0)


def test_series_is_taken_at_its_interval_and_listed_by_its_last_picture(tmp_path: Path) -> None:
    camera = RecordingCamera()
    job = job_with(camera, tmp_path)
    seen: list[tuple[int, int]] = []
    began_s = camera.clock.now()
    summary = job.series(SERIES, lambda each: seen.append((each.done, each.total)), lambda: False)
    (directory,) = tmp_path.glob("series-0001*")
    assert summary.folder == str(directory / "set-0003")
    assert summary.notes[0] == f"3 of 3 pictures are in {directory}"
    assert camera.clock.now() - began_s >= 60
    assert seen[0] == (0, 3)
    assert seen[-1] == (2, 3)
    shot = [setting for setting in camera.lists if len(setting) == 2]
    assert len(shot) == 3
    assert len(set(shot)) == 1, "the light is metered once"
    (past,) = job.captures()
    assert past == Past(f"{directory.name}/set-0003", is_complete=True)
    assert job.look(past).folder == summary.folder
    assert next_folder(tmp_path, datetime(2026, 11, 25)).name.startswith("capture-0002")


def test_series_that_is_cancelled_is_continued_from_the_list_of_captures(tmp_path: Path) -> None:
    camera = RecordingCamera()
    job = job_with(camera, tmp_path)
    done: list[int] = []
    with pytest.raises(InterruptedCaptureError, match=r"1 of 3 sets"):
        job.series(SERIES, lambda each: done.append(each.done), lambda: 1 in done)
    (directory,) = tmp_path.glob("series-0001*")
    assert (directory / "set-0001" / "report.json").exists()
    assert not (directory / "set-0003").exists()
    past, taken = job.captures()
    assert past == Past(directory.name, is_complete=False)
    assert taken == Past(f"{directory.name}/set-0001", is_complete=True)
    assert job.look(taken).folder == str(directory / "set-0001")
    assert job.load().unfinished == 1
    journal = directory / "series.json"
    written = journal.read_text()
    journal.write_text(written.replace('"serial": "', '"serial": "another '))
    with pytest.raises(DataError, match=r"was begun with .*; connect the same"):
        job.resume(past, lambda _: None, never)
    journal.write_text(written)
    summary = job.resume(past, lambda _: None, never)
    assert summary.notes[0] == f"3 of 3 pictures are in {directory}"
    assert job.captures() == (Past(f"{directory.name}/set-0003", is_complete=True),)


def test_series_without_a_picture_is_a_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise CaptureError("the flash did not fire")

    monkeypatch.setattr(CameraSets, "take", fail)
    job = job_with(RecordingCamera(), tmp_path)
    with pytest.raises(
        CaptureError, match="none of 3 pictures is complete: the flash did not fire"
    ):
        job.series(SERIES, lambda _: None, lambda: False)


def test_ready_shows_focus_battery_and_card_where_they_are_stated() -> None:
    reading = Reading(focus_percent=87, battery_percent=64, free_images=512)
    for size, texts in (
        (
            (60, 16),
            ("Focus 87 % of the best seen", "Battery 64 %", "512 pictures free on the card"),
        ),
        ((16, 12), ("Focus 87 %", "Battery 64 %", "Card 512 free")),
    ):
        lines = grid(screen(Model(state=State.IDLE, reading=reading)), *size).lines
        assert [text for text in texts if any(text in line for line in lines)] == list(texts)
    lines = grid(screen(Model(state=State.IDLE, reading=Reading())), 60, 16).lines
    assert not [line for line in lines if "Focus" in line or "Battery" in line or "card" in line]


def test_focus_falls_where_the_picture_is_blurred() -> None:
    sharp = np.indices((300, 300)).sum(axis=0) // 8 % 2 * 1000.0 + 100
    blurred = (sharp[:-4, :-4] + sharp[2:-2, 2:-2] + sharp[4:, 4:]) / 3
    assert focus_value(blurred) < 0.8 * focus_value(sharp)
    assert focus_value(3 * sharp) == pytest.approx(focus_value(sharp), rel=1e-5)
    assert focus_value(np.zeros((4, 4))) == 0


def test_what_ready_does_without_is_not_loaded(tmp_path: Path) -> None:
    """It would take memory of a board for as long as the menu waits."""
    without = ("OpenEXR", "PIL", "camctl.captures.sequencer", "camctl.stills", "cv2", "scipy")
    code = f"""
import sys
from pathlib import Path
from camctl.menu.camera_job import CameraJob
from camctl.sim.backend import SimulatedBackend
job = CameraJob(lambda _: (SimulatedBackend().open("", {{}}), {{}}), Path("."), Path("menu.json"))
job.open("")
assert job.meter().time_s
print([name for name in {without} if name in sys.modules])
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path
    )
    assert done.stdout.strip() == "[]"


def test_body_without_preview_meters_once_the_settings_allow_its_shutter(tmp_path: Path) -> None:
    pair = bench(scene="ramp")
    job = CameraJob(lambda _: (pair.camera(), {}), tmp_path, tmp_path / "menu.json")
    job.open("")
    try:
        with pytest.raises(UsageError) as refused:
            job.plan(choice(Settings(), Goal.COUNT), lambda: False)
        assert "(menu: Settings, Shots for metering)" in error_text(refused.value)
        allowed = Settings(
            metering=[each.labels[0] for each in METERINGS].index("Shots for metering")
        )
        assert job.plan(choice(allowed, Goal.COUNT), lambda: False).frames
    finally:
        job.close()
