"""Draw the pictures of docs/menu.md: every screen on each kind of panel.

The screens come from one model with values of the simulated camera, so that they stay the same.

    python docs/draw_menu_screens.py
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

import camctl
from camctl.picture_operations import png
from menu.data import (
    CameraEntry,
    Cost,
    Past,
    Plan,
    Progress,
    Reading,
    Summary,
)
from menu.drawing import Pixels, draw, text_picture
from menu.layout import grid
from menu.model import Model, State
from menu.screens import screen
from menu.thumbnails import image_picture

FOLDER = Path(__file__).with_name("menu")
GAP = 6
CAMERA = CameraEntry("sim", "Simulated phone")


def model() -> Model:
    """Return a model that has something to show on every screen."""
    with camctl.open_camera("sim", scene="room", size="240x180") as camera:
        report = camctl.capture(camera, camctl.CaptureRequest())
    picture = image_picture(report.image())
    shares = report.achieved.light_shares
    costs = tuple(
        Cost(n, 0.02 * 9.0 ** (n - 1), 0.1 + 0.02 * 9.0 ** (n - 1), levels, True)
        for n, levels in enumerate((9.6, 62.0, 99.6, 131.0, 148.0, 164.0), start=1)
    )
    frames = (("19.88 ms", 1.0), ("178.9 ms", 9.0), ("1.61 s", 81.0))
    plan = Plan(
        frames, 1.81, 1.9, True, 99.6, 380.0, True, 86.0, 765.0, 1000.0,
        needed_bytes=36_200_000, free_bytes=12_300_000_000,
    )  # fmt: skip
    return Model(
        costs=(*costs, *costs, *costs),
        reading=Reading(0.0199, 0.0012, shares, picture, 12_300_000_000, CAMERA),
        plan=plan,
        progress=Progress(1, 3, "shooting", 0.2),
        remaining_s=7,
        summary=Summary(
            99.1, 380.0, True, 99.6, 0.0007, "captures/capture-0012",
            histogram=shares, picture=picture,
        ),
        cameras=(CAMERA, CameraEntry("v4l2:/dev/video0", "HD Webcam C920")),
        camera=CAMERA,
        captures=(Past("capture-0012-20260412-101502", True), Past("capture-0011", False)),
        error="the camera was disconnected; connect it again",
    )  # fmt: skip


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
    shown = model()
    states = [state for state in State if state not in (State.SAVER, State.QUIT)]
    captures = (State.SHOOTING, State.RESUMING, State.CANCELLING)
    screens = [
        screen(replace(shown, state=state, progress=shown.progress if state in captures else None))
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
