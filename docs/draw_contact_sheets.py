"""Draw the contact sheets of the built-in scenes: ``python docs/draw_contact_sheets.py``.

Each is the contact.png of one simulated capture, reduced in size and in colours.
room-responses.png is the picture of ``camctl preview``.  previews.png shows each scene
as image.tiff, by three tone mappers of OpenCV, and as preview.png.  Where $CAMCTL_DATA/memorial
holds Debevec and Malik's photographs, memorial.png is the sheet of ``camctl merge`` with all of
them, and previews.png has a row of them, too.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import camctl
from camctl.captures.response_preview import preview_responses
from camctl.photographs.merge import merge
from camctl.photographs.photograph_set import PhotographOptions
from camctl.pictures.drawing import MARGIN, SMALL_TEXT, Drawing
from camctl.sim.scenes.scene import scene_names

SENSORS = {"outdoor-sun": "security", "pwm-lamp": "security", "stars": "ccd"}
COUNT = 4
#: Bytes of a sheet at most, bytes of previews.png at most, and the widths and steps of a colour
#: that are tried for it.
MOST_BYTES, PREVIEWS_BYTES = 145_000, 200_000
REDUCTIONS = ((860, 2), (860, 4), (760, 4), (680, 4), (600, 4), (520, 4), (440, 4))
#: Size of a picture in previews.png.
SMALL = (150, 112)


def main() -> None:
    """Write the pictures of the page on previews, in docs/pictures."""
    folder = Path(__file__).parent / "pictures"
    sheets = folder / "contact-sheets"
    sheets.mkdir(exist_ok=True)
    rows = {}
    for name in sorted(scene_names()):
        with tempfile.TemporaryDirectory() as place:
            out = Path(place) / name
            sensor = SENSORS.get(name, "standard")
            with camctl.open_camera("sim", scene=name, sensor=sensor, size="640x480") as camera:
                request = camctl.CaptureRequest("log", "auto", count=COUNT)
                report = camctl.capture(camera, request, out)
            write(sheets / f"{name}.png", read(out / "contact.png"))
            rows[name] = compared(out, report.image(), report.radiance())
    if data := os.environ.get("CAMCTL_DATA"):
        sheet, rows["memorial"] = memorial(Path(data, "memorial"))
        write(sheets / "memorial.png", sheet)
    with camctl.open_camera("sim", scene="room") as camera:
        shown = preview_responses(camera, camctl.CaptureRequest(dynamic_range="auto")).picture
        write(folder / "room-responses.png", shown)
    titles = ["image.tiff (log)", "Drago", "Reinhard", "Mantiuk", "preview.png"]
    write(folder / "previews.png", table(titles, rows), PREVIEWS_BYTES)


def compared(
    folder: Path, image: NDArray[np.uint16], radiance: NDArray[np.float32]
) -> list[NDArray[np.uint8]]:
    """Return the pictures of a capture by each tone mapping."""
    return [(image >> 8).astype(np.uint8), *rivals(radiance), read(folder / "preview.png")]


def memorial(photographs: Path) -> tuple[NDArray[np.uint8], list[NDArray[np.uint8]]]:
    """Return the contact sheet of Debevec and Malik's photographs, and the compared pictures."""
    rows = [line.split() for line in (photographs / "image_list.txt").read_text().splitlines()]
    found = [(photographs / row[0], float(row[1])) for row in rows if row and row[0] != "#"]
    files, times = zip(*((file, time_s) for file, time_s in found if file.exists()), strict=True)
    with tempfile.TemporaryDirectory() as place:
        out = Path(place) / "memorial"
        merged = merge(files, path=out, options=PhotographOptions(times=times))
        pictures = compared(out, merged.image(), merged.radiance())
        return read(out / "contact.png"), pictures


def rivals(radiance: NDArray[np.float32]) -> list[NDArray[np.uint8]]:
    """Return the pictures of OpenCV's tone mappers, at their defaults and a gamma of 2.2."""
    light = radiance if radiance.ndim == 3 else np.repeat(radiance[..., np.newaxis], 3, axis=2)
    mappers: list[Any] = [
        cv2.createTonemapDrago(2.2),
        cv2.createTonemapReinhard(2.2),
        cv2.createTonemapMantiuk(2.2),
    ]
    mapped = (np.nan_to_num(mapper.process(light.copy())) for mapper in mappers)
    return [np.rint(np.clip(each, 0, 1) * 255).astype(np.uint8) for each in mapped]


def table(titles: list[str], rows: dict[str, list[NDArray[np.uint8]]]) -> NDArray[np.uint8]:
    """Return all pictures beside each other, one row for each scene."""
    width, height = SMALL[0] + MARGIN // 2, SMALL[1] + MARGIN // 2
    left = 100
    drawing = Drawing(left + len(titles) * width + MARGIN, 30 + len(rows) * height + MARGIN)
    for column, title in enumerate(titles):
        drawing.text(title, (left + column * width, 10), SMALL[0])
    for row, (name, pictures) in enumerate(rows.items()):
        top = 30 + row * height
        drawing.text(name, (8, top + SMALL[1] // 2 - 8), left - 12, size=SMALL_TEXT)
        for column, picture in enumerate(pictures):
            drawing.picture(picture, (left + column * width, top), SMALL)
    return drawing.pixels


def read(path: Path) -> NDArray[np.uint8]:
    """Return a picture, (rows, columns, 3), R first."""
    found = cv2.imread(str(path))
    assert found is not None
    return np.asarray(found[..., ::-1], np.uint8)


def write(path: Path, picture: NDArray[np.uint8], most_bytes: int = MOST_BYTES) -> None:
    """Write a picture, reduced in size and in colours, so that its file is small."""
    for width, step in REDUCTIONS:
        size = (width, round(picture.shape[0] * width / picture.shape[1]))
        small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA).astype(np.float32)
        shown = np.clip(np.rint(small / step) * step, 0, 255).astype(np.uint8)[..., ::-1]
        file = cv2.imencode(".png", shown, [cv2.IMWRITE_PNG_COMPRESSION, 9])[1].tobytes()
        if len(file) <= most_bytes:
            break
    path.write_bytes(file)


if __name__ == "__main__":
    main()
