"""The menu before the simulated camera: what was reviewed is what the camera was told to shoot."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest
from panel_fakes import ScriptedPanel

from camctl import read_report
from camctl.camera import Frame
from camctl.captures.request import CaptureRequest
from camctl.captures.sequencer import resume
from camctl.controls import ExposureSetting
from camctl.errors import CaptureError
from menu.app import run
from menu.camera_job import CameraJob
from menu.model import Model, State
from menu.ports import Choice, Key
from menu.screens import screen
from sim.camera import Faults, SimulatedCamera
from sim.scenes.scene import load_scene
from sim.sensors.sensor import load_sensor
from tests.menu.test_screens import settings_on

SIZE = (60, 16)
Script = list[tuple[str, Key | Callable[[], object]]]


class WatchedCamera(SimulatedCamera):
    """Notes the lists of settings that it is told to shoot."""

    def __init__(self, faults: Faults | None = None) -> None:
        scene = load_scene("tile-floor", (24, 32))
        super().__init__(scene, load_sensor("ideal-8"), faults=faults)
        self.lists: list[tuple[ExposureSetting, ...]] = []
        self.on_frame: Callable[[], object] = lambda: None

    def shoot(self, settings: Sequence[ExposureSetting]) -> Iterator[Frame]:
        self.lists.append(tuple(settings))
        return self._watched(super().shoot(settings))

    def _watched(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        for frame in frames:
            self.on_frame()
            yield frame


class Folders:
    """A fresh folder for each capture."""

    def __init__(self, parent: Path) -> None:
        self.parent = parent
        self.given: list[Path] = []

    def __call__(self) -> Path:
        self.given.append(self.parent / f"capture-{len(self.given) + 1}")
        return self.given[-1]


@pytest.fixture
def folders(tmp_path: Path) -> Folders:
    return Folders(tmp_path)


@pytest.mark.parametrize(
    ("response", "dynamic_range", "count"), [(0, 1, 3), (1, 2, 2), (2, 0, 4), (0, 0, 1)]
)
def test_what_was_reviewed_is_what_was_shot(
    folders: Folders, response: int, dynamic_range: int, count: int
) -> None:
    camera = WatchedCamera()
    job = CameraJob(camera, folders, source={"camera": "sim"})
    script: Script = [("Desired", Key.DOWN)] * response + [("Desired", Key.ENTER)]
    script += [("Dynamic", Key.UP)] * 2 + [("Dynamic", Key.DOWN)] * dynamic_range
    script += [("Dynamic", Key.ENTER)]
    script += [("Exposures", Key.UP)] * 6 + [("Exposures", Key.DOWN)] * (count - 1)
    script += [("Exposures", Key.ENTER)]
    panel = ScriptedPanel(script, SIZE)
    reviewed: list[str] = []
    panel.script += [("Review", lambda: reviewed.extend(panel.lines)), ("Review", Key.ENTER)]
    panel.script += [("Done", key) for key in (Key.RIGHT, Key.RIGHT, Key.ENTER)]
    summary = run(panel, job)

    report = read_report(folders.given[0])
    assert report.status == "complete"
    assert report.source == {"camera": "sim"}
    assert camera.lists[-1] == report.plan.settings
    assert len(report.plan.settings) == count
    shot = Model(State.REVIEW, response, dynamic_range, count, plan=report.plan)
    assert reviewed == list(screen(shot, *SIZE).lines)
    assert [setting.time_s for setting in settings_on(shot, *SIZE)] == pytest.approx(
        [setting.time_s for setting in camera.lists[-1]], rel=1e-6, abs=0
    )
    assert [r.applied.time_s for r in report.frames if r] == [
        s.time_s for s in report.plan.settings
    ]
    assert summary is not None
    assert report.achieved is not None
    assert summary.effective_levels == report.achieved.effective_levels
    assert summary.folder == str(folders.given[0])


def test_each_number_of_exposures_costs_what_its_exposures_add_up_to(folders: Folders) -> None:
    with WatchedCamera() as camera:
        costs = list(CameraJob(camera, folders).predict("log", 1000.0))
    assert [cost.count for cost in costs] == [1, 2, 3, 4, 5, 6]
    for cost in costs:
        assert len(cost.exposures) == cost.count
        assert cost.shutter_time == pytest.approx(sum(cost.exposures))
    levels = [cost.effective_levels for cost in costs]
    assert levels == sorted(levels)


def test_what_the_menu_does_not_ask_comes_from_the_request(folders: Folders) -> None:
    with WatchedCamera() as camera:
        request = CaptureRequest(base_s=0.002, ratios=(1.0, 2.0))
        plan = CameraJob(camera, folders, request=request).plan(Choice("gamma", 256.0, 3))
    assert (plan.response, plan.dynamic_range, len(plan.settings)) == ("gamma", 256.0, 3)
    assert plan.base_s == pytest.approx(0.002, rel=0.01)
    assert plan.metering is None


def test_a_cancelled_capture_keeps_its_frames(folders: Folders) -> None:
    camera = WatchedCamera()
    job = CameraJob(camera, folders)
    plan = job.plan(Choice("log", 1000.0, 3))
    frames: list[int] = []
    camera.on_frame = lambda: frames.append(1)
    with pytest.raises(CaptureError, match=r"1 of 3 frames are kept; .*--resume .*capture-1"):
        job.shoot(plan, lambda progress: None, lambda: bool(frames))
    camera.on_frame = lambda: None
    assert resume(camera, folders.given[0]).status == "complete"


def test_a_camera_that_goes_away_is_an_error_with_a_way_on(folders: Folders) -> None:
    camera = WatchedCamera(Faults(unplug_after=1))
    script: Script = [
        ("Desired", Key.ENTER),
        ("Dynamic", Key.ENTER),
        ("Exposures", Key.ENTER),
        ("Review", Key.ENTER),
        ("Failed", Key.RIGHT),
        ("Failed", Key.ENTER),
        ("Review", Key.EXIT),
        ("Exposures", Key.EXIT),
        ("Dynamic", Key.EXIT),
        ("Desired", Key.EXIT),
    ]
    panel = ScriptedPanel(script, SIZE)
    assert run(panel, CameraJob(camera, folders)) is None
    failed = next(lines for lines in panel.seen if lines[0].startswith("Failed"))
    assert "1 of 3 frames are kept" in " ".join(" ".join(failed).split())
