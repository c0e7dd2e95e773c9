"""Draw the pictures of docs/how-to/menu.md: every screen on each kind of panel.

The figures are from the simulated camera: its plans for each entry, and one capture.  The
errors are from real failures, one for each screen of an error.

    python docs/draw_menu_screens.py
"""

import os
from collections.abc import Callable
from contextlib import chdir
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

import numpy as np

import camctl
from camctl.errors import CamctlError
from camctl.interface.camera import Camera
from camctl.menu import camera_job
from camctl.menu.camera_job import CameraJob
from camctl.menu.data import CameraEntry, Choice, Cost, Past, Progress, SeriesChoice, Settings
from camctl.menu.drawing import Pixels, draw, text_picture
from camctl.menu.entries import CUSTOM, choice
from camctl.menu.layout import grid
from camctl.menu.machine import choices
from camctl.menu.model import Goal, Model, State
from camctl.menu.screens import screen
from camctl.menu.tables import STATES, Work
from camctl.menu.worker import failure_text
from camctl.records import REPORT
from camctl.system.picture_operations import png

FOLDER = Path(__file__).parent.absolute() / "pictures/menu"
GAP = 6
FREE_BYTES = 12_300_000_000
CAPTURES = Path("captures")
SERIES = SeriesChoice(Choice("log", 1000.0), 10, 60.0)
WEBCAM = CameraEntry("v4l2:/dev/video9", "HD Webcam C920")


def models() -> dict[State, Model]:
    """Return a model for each screen, with what the simulated camera's plans and captures give."""
    with TemporaryDirectory() as folder, chdir(folder):
        job = _job()
        shown = _model(job)
        errors = _errors(job)
        found = {}
        for state in State:
            found[state] = replace(shown, state=state, error=errors.get(state, ""))
            if state is State.CUSTOM:
                settings = replace(shown.settings, range=CUSTOM)
                found[state] = replace(found[state], settings=settings)
            if STATES[state].work is Work.PREDICT:
                found[state] = replace(found[state], costs=_costs(job, found[state]))
            if state is State.FRONT:
                front = job.trace(choice(shown.settings, Goal.FRONT), lambda: False).points
                place = [point.is_recommended for point in front].index(True)
                found[state] = replace(found[state], front=front, cursor=place)
        found[State.CAMERA_FAILED] = replace(found[State.CAMERA_FAILED], camera=None)
        job.close()
    return found


def _job(camera: str = "sim", **options: Any) -> CameraJob:
    def opened(camera_id: str, _profile: str = "all") -> tuple[Camera, dict[str, Any]]:
        simulated = not camera_id and camera == "sim"
        given = {"scene": "room", "sensor": "phone", **options} if simulated else {}
        return camctl.open_camera(camera_id or camera, **given), {}

    return CameraJob(opened, CAPTURES, Path("menu.json"))


def _costs(job: CameraJob, model: Model) -> tuple[Cost | None, ...]:
    """Return the cost of each entry of a list."""
    asked = [each for each in choices(model) if isinstance(each, Choice)]
    costs = job.predict(asked, lambda: False)
    return tuple(next(costs) if isinstance(each, Choice) else None for each in choices(model))


def _model(job: CameraJob) -> Model:
    """Return a model that has something to show on every screen."""
    seen: list[Progress] = []
    camera, settings = job.open(""), Settings()
    calibrated = job.calibrate("still", seen.append, lambda: False)
    reading = replace(job.meter(), free_bytes=FREE_BYTES)
    plan = job.plan(choice(settings, Goal.COUNT), lambda: False)
    summary = job.shoot(plan, lambda _: None, lambda: False)
    return Model(
        settings=settings,
        reading=reading,
        plan=replace(plan, free_bytes=FREE_BYTES),
        progress=Progress(1, 3, "shooting", 0.2),
        remaining_s=7,
        summary=replace(summary, folder="captures/capture-0012"),
        cameras=(camera, WEBCAM),
        marked=(camera.id,),
        calibrated=calibrated.lines,
        camera=camera,
        captures=(Past("capture-0012-20260412-101502", True), Past("capture-0011", False)),
    )


def _errors(job: CameraJob) -> dict[State, str]:
    """Return the error of a failure for each screen that shows one."""
    plan = job.plan(choice(Settings(), Goal.COUNT), lambda: False)
    unplugged = _job(faults="unplug@1")
    stored: list[Progress] = []
    cancelled = _error(
        lambda: job.shoot(plan, stored.append, lambda: any(each.done for each in stored))
    )
    unfinished = next(past for past in job.captures() if not past.is_complete)
    damaged = next(past for past in job.captures() if past.is_complete)
    (CAPTURES / damaged.name / REPORT).write_text("{")
    other = _job(sensor="ideal-8")
    denied = PermissionError(13, os.strerror(13))
    broken = OSError(5, os.strerror(5))
    with patch.object(camera_job, "list_captures", side_effect=denied):
        not_listed = _error(job.captures)
    with patch.object(camera_job, "list_cameras", side_effect=broken):
        not_found = _error(job.find_cameras)
    with patch.object(CameraJob, "_free_bytes", return_value=12_000_000):
        too_large = _error(lambda: job.plan(choice(Settings(), Goal.COUNT), lambda: False))
    found = {
        State.CAMERA_FAILED: _error(lambda: _job().open(WEBCAM.id)),
        State.PLAN_FAILED: too_large,
        State.CANCELLED: cancelled,
        State.CAPTURE_FAILED: _error(
            lambda: unplugged.shoot(plan, lambda _: None, lambda: False),
        ),
        State.SEARCH_FAILED: not_found,
        State.BROWSE_FAILED: not_listed,
        State.LOOK_FAILED: _error(lambda: job.look(damaged)),
        State.SERIES_FAILED: _error(
            lambda: _job(camera=WEBCAM.id).series(SERIES, lambda _: None, lambda: False)
        ),
        State.CALIBRATION_FAILED: _error(
            lambda: job.calibrate("covered", lambda _: None, lambda: False)
        ),
        State.RESUME_FAILED: _error(
            lambda: other.resume(unfinished, lambda _: None, lambda: False)
        ),
    }
    unplugged.close()
    other.close()
    return found


def _error(act: Callable[[], object]) -> str:
    """Return what the menu shows of the error that `act` raises."""
    try:
        act()
    except (CamctlError, OSError) as error:
        return failure_text(error)
    raise AssertionError("there was no error")


def sheet(pictures: list[Pixels], columns: int) -> bytes:
    """Return pictures of one size side by side, as a PNG file."""
    tall = [np.pad(each, ((GAP, 0), (GAP, 0), (0, 0)), constant_values=60) for each in pictures]
    while len(tall) % columns:
        tall.append(np.full_like(tall[0], 60))
    rows = [np.concatenate(tall[i : i + columns], 1) for i in range(0, len(tall), columns)]
    return png(np.concatenate(rows))


def main() -> None:
    """Draw all sheets."""
    FOLDER.mkdir(exist_ok=True)
    with TemporaryDirectory() as profiles:
        os.environ["CAMCTL_PROFILES"] = profiles
        shown = models()
    states = [state for state in State if state not in (State.SAVER, State.QUIT)]
    captures = (State.SHOOTING, State.RESUMING, State.CANCELLING, State.SERIES_SHOOTING)
    screens = [
        screen(replace(shown[state], progress=shown[state].progress if state in captures else None))
        for state in states
    ]
    for columns, rows, across in ((16, 2, 5), (20, 4, 5), (60, 16, 2)):
        pictures = [text_picture(grid(each, columns, rows).lines) for each in screens]
        (FOLDER / f"text-{columns}x{rows}.png").write_bytes(sheet(pictures, across))
    for columns, rows, across in ((128, 64, 6), (240, 240, 5), (480, 320, 3)):
        pictures = [draw(each, columns, rows).pixels for each in screens]
        (FOLDER / f"picture-{columns}x{rows}.png").write_bytes(sheet(pictures, across))


if __name__ == "__main__":
    main()
