"""An exposure series that suits the light before a camera, for its response."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.calibration.light import (
    LONGEST_S,
    PROBE_STEP,
    probes,
    spread_times,
    too_bright,
    too_dark,
)
from camctl.calibration.limits import FEW
from camctl.calibration.response.series import Series
from camctl.interface.camera import Camera
from camctl.interface.controls import ExposureSetting

FRAMES = 8


def measure_response(
    camera: Camera,
    *,
    count: int = FRAMES,
    longest_s: float = LONGEST_S,
    frames: list[NDArray[Any]] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Series:
    """Shoot an exposure series that suits the light before the camera; return it.

    The exposures are the true ones where the camera's controls know them, else as stated.

    Args:
        camera: an open camera
        count: number of frames, at least 2
        longest_s: longest shutter time, s
        frames: a list to which the frames are added
        progress: called with the share that is done, 0 to 1

    Raises:
        CaptureError: the scene is too dark or too bright for the camera's shutter times
        CameraError: as `Camera.shoot` raises
    """
    controls = camera.controls
    gain = controls.gain.nearest(1.0)
    settings = [ExposureSetting(time_s, gain) for time_s in _bracket(camera, count, longest_s)]
    series = Series(
        controls.layout,
        controls.bits,
        controls.black,
        controls.white,
        phase=controls.quantiser_phase,
        levels_are_stated=True,
        is_shot=True,
        has_measured_exposures=controls.true_exposures is not None,
    )
    for frame in camera.shoot(settings):
        exposure = controls.exposure(frame.applied)
        series.add(frame.pixels, exposure, f"the frame of {frame.applied.time_s:.4g} s")
        if frames is not None:
            frames.append(frame.pixels)
        if progress is not None:
            progress(len(series.names) / len(settings))
    return series


def _bracket(camera: Camera, count: int, longest_s: float) -> list[float]:
    """Return up to `count` shutter times from dark frames to nearly saturated ones.

    They begin one probe before `FEW` of the pixels reach half of full scale.
    """
    controls = camera.controls
    shortest, first, last = controls.time_s.minimum, None, 0.0
    half = controls.black + (controls.white - controls.black) / 2
    for frame in probes(camera, longest_s):
        last = frame.applied.time_s
        if first is None and np.mean(frame.pixels >= half) >= FEW:
            first = last / PROBE_STEP
        if np.mean(frame.pixels >= controls.white) >= 1 - 2 * FEW:
            if frame.index == 0:
                raise too_bright(last)
            break
    if first is None:
        raise too_dark(f"it does not reach half of full scale at {last:.4g} s")
    return spread_times(controls.time_s, max(first, shortest), last, count)
