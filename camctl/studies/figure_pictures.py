"""The paper's figures 6, 7, 9 and 10, which show pictures: taken by the simulated camera."""

from __future__ import annotations

import json
import tempfile
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from camctl.exposure.goal import CaptureRequest
from camctl.exposure.solver import solve
from camctl.model.response.camera import linear_to_srgb
from camctl.model.response.desired import desired_response
from camctl.studies.figure_parts import (
    BASELINE,
    PaperFigure,
    brightness,
    computed,
    ratios_text,
    shoot,
    show,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from camctl.profiles.response import ResponseRecord
    from camctl.records.report import CaptureReport

PRINTED_4_BIT = (1.0, 1.05, 1.11)
"""The exposures of the paper's figures 5(a), 6 and 7."""

LINEAR_4_BIT = CaptureRequest(response="linear", dynamic_range=64.0, base_s=0.02)
CLOTH = CaptureRequest(response="linear", dynamic_range=64.0, base_s=0.02)
BALL = CaptureRequest(response="linear", dynamic_range=256.0, base_s=2.0)
LOG_6_BIT = CaptureRequest(response="log", dynamic_range=1000.0, base_s=0.02)

DETAIL = (slice(430, 550), slice(650, 830))
"""Rows and columns of the detail in figure 10: beside the highlight of the ball."""

NOISE_8_BIT = 1.95
"""Noise in figure 6, in brightness levels of 8 bits."""


def _figure_6(figure: Figure) -> None:
    found = computed(4, "linear", 64.0, 3).exposures
    rows = (
        ("baseline", BASELINE, "ideal-4"),
        ("printed", PRINTED_4_BIT, "ideal-4"),
        ("computed", found, "ideal-4"),
        ("one exposure of 12 bits", (1.0,), "ideal-12"),
    )
    panels = figure.subplots(len(rows), 2)
    with tempfile.TemporaryDirectory() as folder:
        for (name, ratios, sensor), (left, right) in zip(rows, panels, strict=True):
            title = name if len(ratios) == 1 else f"{name} {ratios_text(ratios)}"
            report = shoot("ramp", sensor, ratios, LINEAR_4_BIT, "600x80")
            values = np.unique(report.sum()).size
            show(left, brightness(report), f"{title}: {values} values", aspect="auto")
            noise_e = NOISE_8_BIT / 256 * 10_000
            noisy = changed_file("sensors", sensor, Path(folder), read_noise_e=noise_e)
            report = shoot("ramp", noisy, ratios, LINEAR_4_BIT, "600x80")
            show(right, brightness(report), f"{title}, with noise", aspect="auto")


def _figure_7(figure: Figure) -> None:
    found = computed(4, "linear", 64.0, 3).exposures
    pictures = [
        ("(a) baseline 1, 2, 4, of 4 bits", BASELINE, "ideal-4"),
        ("(b) one exposure of 12 bits", (1.0,), "ideal-12"),
        (f"(c) computed {ratios_text(found)}, of 4 bits", found, "ideal-4"),
        (f"(d) printed {ratios_text(PRINTED_4_BIT)}, of 4 bits", PRINTED_4_BIT, "ideal-4"),
    ]
    panels = figure.subplots(2, 2).ravel()
    for axes, (title, ratios, sensor) in zip(panels, pictures, strict=True):
        picture = brightness(shoot("cloth", sensor, ratios, CLOTH, "600x340"))
        show(axes, (picture[:, :420] - 0.35) / 0.6, title)


def _figure_9(figure: Figure) -> None:
    found = computed(6, "log", 1000.0, 3).exposures
    panels = figure.subplots(2, 2, width_ratios=(1.6, 1))
    detail = (slice(40, 290), slice(270, 500))
    pictures = ((f"(a) baseline {ratios_text(BASELINE)}", BASELINE), ("(b) computed ", found))
    for (left, right), (title, ratios) in zip(panels, pictures, strict=True):
        report = shoot("tile-floor", "ideal-6", ratios, LOG_6_BIT, "640x400")
        picture = brightness(report)
        text = title if ratios == BASELINE else title + ratios_text(ratios)
        show(left, picture, f"{text}: {np.unique(report.sum()).size} values")
        show(right, picture[detail] / 0.45, "a detail, contrast enhanced")


def draw_figure_10(figure: Figure, measured: ResponseRecord | None = None) -> None:
    """Draw figure 10; with a measured response, nothing else is known of the camera."""
    if measured is None:
        found = computed("srgb", "linear", 256.0, 3).exposures
    else:
        response = measured.camera_response()
        found = solve(response, desired_response("linear", 256.0), 3).exposures
    upper, lower = figure.subfigures(2, 1, squeeze=False)[:, 0]
    with tempfile.TemporaryDirectory() as folder:
        scene = changed_file("scenes", "ball", Path(folder), luminance_cd_m2=9.3)
        camera = changed_file(
            "sensors", "consumer", Path(folder), photon_noise=False, read_noise_e=0.0
        )
        for part, title, ratios in (
            (upper, "(a) baseline", BASELINE),
            (lower, "(b) computed", found),
        ):
            report = shoot(scene, camera, ratios, BALL, "2048x1536", measured)
            part.suptitle(f"{title} {ratios_text(ratios)}", x=0.01, ha="left", fontsize=10)
            names = [["e0", "e1", "detail"], ["e2", "sum", "detail"]]
            panels = part.subplot_mosaic(names, width_ratios=(1, 1, 1.9))
            for place, ratio in enumerate(ratios):
                picture = report.frame(place)[::4, ::4] / 255.0
                show(panels[f"e{place}"], picture, f"exposure {ratios_text([ratio])}")
            combined = linear_to_srgb(brightness(report))
            show(panels["sum"], combined[::4, ::4], "combined")
            rows, columns = DETAIL
            outline = np.array([columns.start, columns.stop, rows.start, rows.stop]) / 4
            left, right, top, bottom = outline
            panels["sum"].plot(
                [left, right, right, left, left], [top, top, bottom, bottom, top], "w", linewidth=1
            )
            _contours(panels["detail"], report)


def _contours(axes: Axes, report: CaptureReport) -> None:
    """Draw where the sum of the green channel changes from one value to the next."""
    green = report.sum()[..., 1].astype(np.int64)[DETAIL]
    changes = np.zeros(green.shape, dtype=bool)
    changes[:, 1:] |= np.diff(green, axis=1) != 0
    changes[1:] |= np.diff(green, axis=0) != 0
    count = np.unique(green).size
    show(axes, np.where(changes, 0.0, 1.0), f"iso-brightness lines of the detail: {count} values")


def changed_file(kind: str, name: str, folder: Path, **changes: Any) -> str:
    """Write a built-in sensor or scene with some changes to a file; return its path."""
    text = (resources.files("camctl.sim") / kind / f"{name}.json").read_text("utf-8")
    path = folder / f"{name}-changed.json"
    path.write_text(json.dumps(json.loads(text) | changes), "utf-8")
    return str(path)


FIGURES = (
    PaperFigure(
        "6",
        "A ramp of light, by a camera of 4 bits",
        f"""Left: the brightness of a linear ramp of light (scene 'ramp', sensor 'ideal-4'). The
        doubled exposures leave wide bands where the light is strong; the printed and the computed
        exposures have bands of a third or half of that width there, and the computed ones keep
        narrow bands in the dark. Right: the same with Gaussian noise of {NOISE_8_BIT} levels of 8
        bits in each frame (the paper does not say of how many bits its levels are): the bands of
        the baseline remain visible, the other ramps look almost continuous. Below: one exposure of
        a 12-bit camera, for comparison.""",
        (10.0, 5.8),
        _figure_6,
    ),
    PaperFigure(
        "7",
        "White cloth, by a camera of 4 bits",
        """White cloth in soft folds (scene 'cloth' instead of the paper's photograph, contrast
        enhanced as there). (a) The doubled exposures draw contours as on a map where the
        cloth should be smooth. (c) The computed and (d) the printed exposures of the same 4-bit
        camera come close to (b), one exposure of a 12-bit camera.""",
        (8.0, 7.4),
        _figure_7,
    ),
    PaperFigure(
        "9",
        "A tile floor under a strong gradient of light, by a camera of 6 bits",
        """Constant contrast over 1:1,000 (scene 'tile-floor' instead of the paper's photograph,
        sensor 'ideal-6'). (a) The doubled exposures draw the dark part of the floor in a few grey
        steps, and the rest has one value. (b) The computed exposures show the pattern of the tiles
        nearly everywhere. The detail on the right shows the same tiles in both.""",
        (9.0, 8.0),
        _figure_9,
    ),
    PaperFigure(
        "10",
        "A matte ball, by a consumer camera of 8 bits with a curve",
        """A linear response from the sRGB curve of sensor 'consumer' (scene 'ball' instead of the
        paper's photograph; in place of the calibrated Coolpix 990). Every line on the right is a
        change of the sum by one value, in the detail beside the highlight that is outlined in the
        combined picture. (a) With doubled exposures the lines lie far apart, since the longer
        exposures are saturated there. (b) With three nearly equal exposures there are up to three
        times as many. The noise of the sensor is switched off: its photon noise is about one level
        here, and would break the lines up in both.""",
        (8.6, 7.6),
        draw_figure_10,
    ),
)
