"""What the picture files say of a capture beside its light: camera, date, exposures, frames."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.interface.camera import CameraInfo, Pixels
from camctl.interface.colour import CameraColour
from camctl.interface.controls import ExposureControls, ExposureSetting, Layout
from camctl.interface.orientation import UPRIGHT, Orientation
from camctl.pictures.mosaic import colour_of
from camctl.pictures.preview import srgb_codes
from camctl.system.number_text import range_text, time_text
from camctl.system.picture_operations import reduced_in_steps

THUMBNAIL_SIDE = 400
"""Longest side of a thumbnail, pixels."""


@dataclass(frozen=True, eq=False)
class ShownFrame:
    """One frame of a capture, as contact.png shows it.

    Attributes:
        thumbnail: a small picture of it, (rows, columns) or (rows, columns, 3), sRGB
        applied: its setting
        saturated: share of its samples that are saturated
        lowest: irradiance of its first level, in the unit of the pictures
        highest: irradiance from which it is saturated
        iso: ISO speed that it states; None where it does not
    """

    thumbnail: NDArray[np.uint8]
    applied: ExposureSetting
    saturated: float
    lowest: float
    highest: float
    iso: float | None = None


@dataclass(frozen=True, eq=False)
class PictureDetails:
    """What the picture files say of a capture.

    Attributes:
        camera: its identity
        taken_at: when the capture began; None where that is not known
        software: name and version of this program
        desired: name of the desired response
        lowest: least irradiance of the desired range, in the unit of the pictures
        highest: largest irradiance of the desired range
        unit: unit of the irradiance
        frames: in ascending exposure
        saturated: share of the samples that every frame saturated
        dark: share of the samples that are too dark
        moved: share of the samples whose frames contradict each other; None: not examined
        spread: share of the samples that light spread to, which is not in `moved`
        colour: as `ExposureControls.colour`: None: the colours of the pictures are the camera's own
        orientation: of the pixels of the frames
    """

    camera: CameraInfo
    taken_at: datetime | None
    software: str
    desired: str
    lowest: float
    highest: float
    unit: str
    frames: tuple[ShownFrame, ...]
    saturated: float
    dark: float
    moved: float | None = None
    spread: float = 0.0
    colour: CameraColour | None = None
    orientation: Orientation = UPRIGHT

    @property
    def total_time_s(self) -> float:
        """The sum of the shutter times, s."""
        return sum(frame.applied.time_s for frame in self.frames)

    @property
    def f_number(self) -> float | None:
        """The f-number of all frames; None where it is unknown, or not the same."""
        numbers = {frame.applied.f_number for frame in self.frames}
        return numbers.pop() if len(numbers) == 1 else None

    @property
    def gain(self) -> float | None:
        """The gain of all frames; None where it is not the same."""
        gains = {frame.applied.gain for frame in self.frames}
        return gains.pop() if len(gains) == 1 else None

    @property
    def iso(self) -> float | None:
        """The ISO speed of all frames; None where it is not stated, or not the same."""
        speeds = {frame.iso for frame in self.frames}
        return speeds.pop() if len(speeds) == 1 else None

    @property
    def summary(self) -> str:
        """The exposures and the desired response in one line."""
        times = ", ".join(time_text(frame.applied.time_s) for frame in self.frames)
        gain = f" at gain {self.gain:g}" if self.gain not in (None, 1.0) else ""
        response = self.desired
        if self.lowest > 0:
            response += f", range {range_text(self.highest / self.lowest)}"
        return f"sum of the exposures {times}{gain}; desired response {response}"


def thumbnail(pixels: Pixels, controls: ExposureControls) -> NDArray[np.uint8]:
    """Return a small picture of a frame, in sRGB: (rows, columns) or (rows, columns, 3).

    Samples of a camera with a curved response are already encoded, and shown as they are.
    """
    picture = reduced(pixels, controls.layout)
    light = np.clip((picture - controls.black) / (controls.white - controls.black), 0, 1)
    encoded = controls.response is not None
    codes = np.rint(light * 255).astype(np.uint8) if encoded else srgb_codes(light)
    return codes[..., 0] if codes.shape[2] == 1 else codes


def reduced(
    values: NDArray[Any], layout: Layout, side: int = THUMBNAIL_SIDE
) -> NDArray[np.float32]:
    """Return means of the samples of a frame, (rows, columns, 1 or 3), at most `side` pixels long.

    A cell of a mosaic is one pixel.
    """
    if not layout.is_mosaic or min(values.shape[:2]) < 2:
        planes = [values if layout is Layout.RGB else values[..., np.newaxis]]
    else:
        rows, columns = values.shape[0] // 2, values.shape[1] // 2
        places = [(row, column) for row in (0, 1) for column in (0, 1)]
        # The first green is enough for a small picture.
        first = {colour_of(layout, *place): place for place in reversed(places)}
        cells = [values[first[k][0] :: 2, first[k][1] :: 2] for k in range(3)]
        planes = [cell[:rows, :columns, np.newaxis] for cell in cells]
    height, width = planes[0].shape[:2]
    factor = min(1.0, side / max(height, width))
    size = (max(1, round(width * factor)), max(1, round(height * factor)))
    small = [reduced_in_steps(plane, size) for plane in planes]
    return np.dstack(small).astype(np.float32)
