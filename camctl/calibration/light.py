"""Shutter times that are tried to find those that suit the light, and the light of a frame."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from camctl.interface.camera import Camera, Frame
from camctl.interface.controls import Control, ExposureSetting
from camctl.model.response.camera import FloatArray

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
