"""The picture of `camctl preview`: the desired responses beside each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camctl.exposure.light import DARK_SHARE
from camctl.interface.controls import ExposureSetting
from camctl.pictures.drawing import (
    LINE_HEIGHT,
    MARGIN,
    PALE,
    SMALL_TEXT,
    TITLE,
    Drawing,
)
from camctl.records.capture_plan import MUCH, CapturePlan
from camctl.system.number_text import percent_text, range_text, time_text

PANEL_WIDTH = 520
"""Width of the picture of one response, pixels."""

#: Width and largest height of what image.tiff holds.
_STORED = 200, 150
#: What each response is, in a few words.
_MEANING = {
    "linear": "equal steps of light",
    "gamma": "between linear and log",
    "log": "equal steps of contrast",
}


@dataclass(frozen=True, eq=False)
class Panel:
    """One desired response, or why the camera cannot take it.

    Attributes:
        name: of the response
        reason: why there is no picture; "" where there is one
        plan: of the capture
        picture: as preview.png, uint8, (rows, columns) or (rows, columns, 3)
        stored: as image.tiff, in its shape
        dark: share of the samples that would be too dark
        saturated: share of the samples that would be saturated in every frame
    """

    name: str
    reason: str
    plan: CapturePlan | None = None
    picture: NDArray[np.uint8] | None = None
    stored: NDArray[np.uint8] | None = None
    dark: float = 0.0
    saturated: float = 0.0


def response_sheet(
    panels: Sequence[Panel],
    settings: Sequence[ExposureSetting],
    left_out_s: Sequence[float],
    *,
    is_range_given: bool,
) -> NDArray[np.uint8]:
    """Return the picture, (rows, columns, 3), in sRGB.

    Args:
        panels: the responses, from left to right
        settings: of the preview frames from which the light was computed
        left_out_s: planned shutter times that were too long for a preview frame
        is_range_given: the range was given, and not chosen so that it holds the light
    """
    width = len(panels) * (PANEL_WIDTH + MARGIN) + MARGIN
    shapes = [panel.picture.shape[:2] for panel in panels if panel.picture is not None]
    height = min([PANEL_WIDTH, *(round(rows * PANEL_WIDTH / each) for rows, each in shapes)])
    height = max(height, 1)
    top = MARGIN + 2 * LINE_HEIGHT
    below = top + height + LINE_HEIGHT + 8
    notes_top = below + _STORED[1] + LINE_HEIGHT + MARGIN
    drawing = Drawing(width, notes_top + 4 * LINE_HEIGHT + MARGIN)
    title = "the picture in each desired response; nothing was shot"
    drawing.text(title, (MARGIN, MARGIN), width - 2 * MARGIN, size=TITLE)
    for number, panel in enumerate(panels):
        left = MARGIN + number * (PANEL_WIDTH + MARGIN)
        text = f"{panel.name}: {_MEANING[panel.name]}"
        drawing.text(text, (left, top + height + 2), PANEL_WIDTH)
        if panel.picture is None or panel.stored is None:
            drawing.text(panel.reason, (left, top + height // 2), PANEL_WIDTH, size=SMALL_TEXT)
            continue
        drawing.picture(panel.picture, (left, top), (PANEL_WIDTH, height))
        drawing.picture(panel.stored, (left, below), _STORED)
        place = (left, below + _STORED[1] + 2)
        drawing.text("image.tiff", place, _STORED[0], size=SMALL_TEXT, colour=PALE, align=0.5)
        for line, fact in enumerate(_facts(panel)):
            place = (left + _STORED[0] + MARGIN, below + 8 + line * (LINE_HEIGHT + 2))
            drawing.text(fact, place, PANEL_WIDTH - _STORED[0] - MARGIN)
    frames = ", ".join(_setting_text(setting) for setting in settings)
    notes = [f"computed from preview frames of {frames}"]
    if left_out_s:
        times = ", ".join(map(time_text, left_out_s))
        notes.append(
            f"left out, too long for a preview: {times}; the capture has less noise in the dark "
            "than these pictures; the shares are predicted for all its exposures"
        )
    lights = [panel.plan.light for panel in panels if panel.plan is not None]
    unseen = max((light.unseen for light in lights if light is not None), default=0.0)
    if unseen > DARK_SHARE:
        notes.append(
            f"metering shows no light in {percent_text(unseen)}, all of which may be too dark"
        )
    if is_range_given and any(panel.dark > MUCH for panel in panels):
        notes.append(
            "a range that the light decides has exposures that show the dark in "
            "each response, as far as the camera can"
        )
    for line, text in enumerate(notes):
        place = (MARGIN, notes_top + line * LINE_HEIGHT)
        drawing.text(text, place, width - 2 * MARGIN, size=SMALL_TEXT, colour=PALE)
    return drawing.pixels


def _facts(panel: Panel) -> list[str]:
    """Return what decides between the responses, one line each."""
    assert panel.plan is not None  # there is a picture
    plan = panel.plan
    times = ", ".join(map(time_text, (setting.time_s for setting in plan.settings)))
    return [
        f"range {range_text(plan.dynamic_range)}",
        f"{plan.effective_levels:.0f} effective levels",
        f"exposures {times}",
        f"{time_text(plan.shutter_s)} in all",
        f"too dark: {percent_text(panel.dark)}",
        f"saturated: {percent_text(panel.saturated)}",
    ]


def _setting_text(setting: ExposureSetting) -> str:
    gain = "" if setting.gain == 1 else f" (gain {setting.gain:.3g})"
    return time_text(setting.time_s) + gain
