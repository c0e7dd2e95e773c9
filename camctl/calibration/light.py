"""Shutter times that suit the light, the light of a frame, and errors that calibrations raise."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from camctl.errors import CaptureError, DataError
from camctl.interface.camera import Camera, Frame
from camctl.interface.controls import Control, ExposureSetting
from camctl.model.response.camera import FloatArray
from camctl.system.number_text import time_text

LONGEST_S = 2.0
"""Longest shutter time that is used unless another one is asked for, s."""

PROBE_STEP = 4.0
"""Factor between the times of `probes`: two stops, of the eight that a frame of 8 bits shows."""

#: Samples by which light is metered, about: their mean has 1 / 256 of the noise of one.
_METERED = 1 << 16


def spread_times(control: Control, shortest_s: float, longest_s: float, count: int) -> list[float]:
    """Return up to `count` times at about equal factors that a camera can do, ascending, s."""
    requested = np.geomspace(shortest_s, max(shortest_s, longest_s), count)
    return sorted({control.nearest(float(each)) for each in requested})


def probe_times(control: Control, longest_s: float, step: float = PROBE_STEP) -> list[float]:
    """Return times from the shortest one on, about a factor `step` apart, up to `longest_s`."""
    longest_s = max(control.minimum, min(control.maximum, longest_s))
    count = 1 + max(1, math.ceil(math.log2(longest_s / control.minimum) / math.log2(step)))
    return spread_times(control, control.minimum, longest_s, count)


def probes(camera: Camera, longest_s: float, step: float = PROBE_STEP) -> Iterator[Frame]:
    """Yield frames of `probe_times`, at the gain nearest to 1."""
    gain = camera.controls.gain.nearest(1.0)
    times = probe_times(camera.controls.time_s, longest_s, step)
    yield from camera.shoot([ExposureSetting(time_s, gain) for time_s in times])


def metered(frame: Frame) -> FloatArray:
    """Return samples from all over a frame, 0 at black and 1 at white."""
    # An odd step keeps all colours of a mosaic.
    step = math.isqrt(frame.pixels.shape[0] * frame.pixels.shape[1] // _METERED) | 1
    samples = frame.pixels[::step, ::step].astype(np.float64)
    return np.clip((samples - frame.black) / (frame.white - frame.black), 0.0, 1.0)


def too_bright(shortest_s: float) -> CaptureError:
    """Return the error for a scene that is white even at the shortest time."""
    return CaptureError(
        f"the scene is too bright: it is white even at {time_text(shortest_s)}",
        hint="close the aperture, or put a filter in front of the lens",
    )


def too_dark(what: str) -> CaptureError:
    """Return the error for a scene of too little light; `what` says what it does not reach."""
    return CaptureError(
        f"the scene is too dark: {what}",
        hint="take the lens cap off, light the scene, or allow longer times",
        remedies={"longest_s": None},
    )


def all_saturated() -> DataError:
    """Return the error for frames that show nothing but white."""
    return DataError(
        "all frames are saturated everywhere", hint="expose shorter, or close the aperture"
    )


def moved(what: str) -> DataError:
    """Return the error for a scene that did not stand still; `what` says how it shows."""
    return DataError(
        f"{what}: the camera or the scene moved",
        hint="put the camera on a tripod before a scene that does not move",
    )


def check_size(shape: Sequence[int], first: Sequence[int], name: str, name_of_first: str) -> None:
    """Raise `DataError` unless a frame has the size of the first one."""
    if tuple(shape) != tuple(first):
        sizes = [f"{each[1]} x {each[0]}" for each in (shape, first)]
        raise DataError(
            f"{name} has {sizes[0]} pixels and {name_of_first} has {sizes[1]}",
            hint="give frames of one size and format",
        )
