"""The menu with the simulated camera: the settings reviewed are the settings shot."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from pathlib import Path

import pytest
from panel_fakes import Script, ScriptedPanel

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


class RecordingCamera(SimulatedCamera):
    """Records the lists of settings that it shoots, and calls `on_frame` before each frame."""

    def __init__(self, faults: Faults | None = None, *, sensor: str = "ideal-8") -> None:
        scene = load_scene("tile-floor", (24, 32))
        super().__init__(scene, load_sensor(sensor), faults=faults)
        self.lists: list[tuple[ExposureSetting, ...]] = []
        self.on_frame: Callable[[], object] = lambda: None

    def shoot(self, settings: Sequence[ExposureSetting]) -> Generator[Frame, None, None]:
        self.lists.append(tuple(settings))
        return self._recorded(super().shoot(settings))

    def _recorded(self, frames: Iterable[Frame]) -> Generator[Frame, None, None]:
        for frame in frames:
            self.on_frame()
            yield frame


class Folders:
    """A new folder for each capture; `given` lists them."""

    def __init__(self, parent: Path) -> None:
        self.parent = parent
        self.given: list[Path] = []

    def __call__(self) -> Path:
        self.given.append(self.parent / f"capture-{len(self.given) + 1}")
        return self.given[-1]


@pytest.fixture
def camera() -> Iterator[RecordingCamera]:
    with RecordingCamera() as opened:
        yield opened


@pytest.fixture
def folders(tmp_path: Path) -> Folders:
    return Folders(tmp_path)


@pytest.mark.parametrize(
    ("response", "dynamic_range", "count"), [(0, 1, 3), (1, 2, 2), (2, 0, 4), (0, 0, 1)]
)
def test_settings_reviewed_are_the_settings_shot(
    camera: RecordingCamera, folders: Folders, response: int, dynamic_range: int, count: int
) -> None:
    job = CameraJob(camera, folders, source={"camera": "sim"})
    script: Script = []
    script += [("Desired", Key.DOWN)] * response + [("Desired", Key.ENTER)]
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


def test_cost_is_the_sum_of_the_exposures(camera: RecordingCamera, folders: Folders) -> None:
    costs = list(CameraJob(camera, folders).predict("log", 1000.0))
    assert [cost.count for cost in costs] == [1, 2, 3, 4, 5, 6]
    for cost in costs:
        assert len(cost.exposures) == cost.count
        assert cost.total_exposure == pytest.approx(sum(cost.exposures))
    levels = [cost.effective_levels for cost in costs]
    assert levels == sorted(levels)


def test_costs_are_computed_for_a_camera_outside_the_table(folders: Folders) -> None:
    with RecordingCamera(sensor="ideal-4") as camera:
        costs = list(CameraJob(camera, folders).predict("log", 256.0))
    assert [cost.count for cost in costs] == [1, 2, 3, 4, 5, 6]
    levels = [cost.effective_levels for cost in costs]
    assert levels == sorted(levels)


def test_request_supplies_what_the_menu_does_not_ask_for(
    camera: RecordingCamera, folders: Folders
) -> None:
    request = CaptureRequest(base_s=0.002, ratios=(1.0, 2.0))
    plan = CameraJob(camera, folders, request=request).plan(Choice("gamma", 256.0, 3))
    assert (plan.response, plan.dynamic_range, len(plan.settings)) == ("gamma", 256.0, 3)
    assert plan.base_s == pytest.approx(0.002, rel=0.01)
    assert plan.metering is None


def test_cancelled_capture_keeps_its_frames(camera: RecordingCamera, folders: Folders) -> None:
    job = CameraJob(camera, folders)
    plan = job.plan(Choice("log", 1000.0, 3))
    frames: list[int] = []
    camera.on_frame = lambda: frames.append(1)
    with pytest.raises(CaptureError, match=r"1 of 3 frames are kept; .*--resume .*capture-1"):
        job.shoot(plan, lambda progress: None, lambda: bool(frames))
    camera.on_frame = lambda: None
    assert resume(camera, folders.given[0]).status == "complete"


def test_disconnected_camera_is_reported_and_the_menu_goes_on(folders: Folders) -> None:
    script: Script = [
        ("Desired", Key.ENTER),
        ("Dynamic", Key.ENTER),
        ("Exposures", Key.ENTER),
        ("Review", Key.ENTER),
        ("Capture failed", Key.RIGHT),
        ("Capture failed", Key.ENTER),
        ("Review", Key.EXIT),
        ("Exposures", Key.EXIT),
        ("Dynamic", Key.EXIT),
        ("Desired", Key.EXIT),
    ]
    panel = ScriptedPanel(script, SIZE)
    with RecordingCamera(Faults(unplug_after=1)) as camera:
        assert run(panel, CameraJob(camera, folders)) is None
    failed = next(lines for lines in panel.screens if lines[0].startswith("Capture failed"))
    assert "1 of 3 frames are kept" in " ".join(" ".join(failed).split())
