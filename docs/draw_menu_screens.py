"""Draw the pictures of docs/menu.md: every screen on each kind of panel.

The figures are those of the simulated camera: its plans for each entry, and one capture.

    python docs/draw_menu_screens.py
"""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import camctl
from camctl.camera import Camera
from camctl.picture_operations import png
from menu.camera_job import CameraJob
from menu.data import CameraEntry, Choice, Cost, Past, Progress, Settings
from menu.drawing import Pixels, draw, text_picture
from menu.entries import CUSTOM, choice
from menu.layout import grid
from menu.machine import choices
from menu.model import Goal, Model, State
from menu.screens import screen
from menu.tables import STATES, Work

FOLDER = Path(__file__).with_name("menu")
GAP = 6
FREE_BYTES = 12_300_000_000


def models() -> dict[State, Model]:
    """Return a model for each screen, with what the simulated camera's plans and captures give."""
    with TemporaryDirectory() as folder:
        job = CameraJob(_opened, Path(folder), Path(folder) / "menu.json")
        shown = _model(job)
        found = {}
        for state in State:
            found[state] = replace(shown, state=state)
            if state is State.CUSTOM:
                settings = replace(shown.settings, range=CUSTOM)
                found[state] = replace(found[state], settings=settings)
            if STATES[state].work is Work.PREDICT:
                found[state] = replace(found[state], costs=_costs(job, found[state]))
        job.close()
    return found


def _opened(_: str) -> tuple[Camera, dict[str, Any]]:
    return camctl.open_camera("sim", scene="room", sensor="phone"), {}


def _costs(job: CameraJob, model: Model) -> tuple[Cost | None, ...]:
    """Return the cost of each entry of a list."""
    asked = [each for each in choices(model) if isinstance(each, Choice)]
    costs = job.predict(asked, lambda: False)
    return tuple(next(costs) if isinstance(each, Choice) else None for each in choices(model))


def _model(job: CameraJob) -> Model:
    """Return a model that has something to show on every screen."""
    camera, settings = job.open(""), Settings()
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
        cameras=(camera, CameraEntry("v4l2:/dev/video0", "HD Webcam C920")),
        camera=camera,
        captures=(Past("capture-0012-20260412-101502", True), Past("capture-0011", False)),
        error="the camera was disconnected; connect it again",
    )


def sheet(pictures: list[Pixels], columns: int) -> bytes:
    """Return pictures of one size side by side, as a PNG file."""
    tall = [np.pad(each, ((GAP, 0), (GAP, 0), (0, 0)), constant_values=60) for each in pictures]
    while len(tall) % columns:
        tall.append(np.full_like(tall[0], 60))
    rows = [np.concatenate(tall[i : i + columns], 1) for i in range(0, len(tall), columns)]
    return png(np.concatenate(rows), level=9)


def main() -> None:
    """Draw all sheets."""
    FOLDER.mkdir(exist_ok=True)
    shown = models()
    states = [state for state in State if state not in (State.SAVER, State.QUIT)]
    captures = (State.SHOOTING, State.RESUMING, State.CANCELLING)
    screens = [
        screen(replace(shown[state], progress=shown[state].progress if state in captures else None))
        for state in states
    ]
    for columns, rows, across in ((16, 2, 5), (20, 4, 5), (60, 16, 2)):
        pictures = [text_picture(grid(each, columns, rows).lines) for each in screens]
        (FOLDER / f"text-{columns}x{rows}.png").write_bytes(sheet(pictures, across))
    for columns, rows, across in ((240, 240, 5), (480, 320, 3)):
        pictures = [draw(each, columns, rows).pixels for each in screens]
        (FOLDER / f"picture-{columns}x{rows}.png").write_bytes(sheet(pictures, across))


if __name__ == "__main__":
    main()
