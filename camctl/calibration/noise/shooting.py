"""Shoot the pairs of frames from which a camera's noise is estimated: see `noise_frames`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from camctl.calibration.light import LONGEST_S, metered, probes, spread_times, too_bright, too_dark
from camctl.calibration.limits import DIM, FEW
from camctl.calibration.noise.estimate import NoiseFrames, estimate_noise, same_response
from camctl.interface.camera import Camera
from camctl.interface.controls import Control, ExposureSetting
from camctl.model.response.camera import CameraResponse
from camctl.profiles.noise import NoiseRecord

EXPOSURES = 12
#: Factor between the gains that are measured, and how many of them at most.
_GAIN_STEP, _MOST_GAINS = 4.0, 3


def measure_noise(
    camera: Camera,
    *,
    is_flat: bool = False,
    exposures: int = EXPOSURES,
    longest_s: float = LONGEST_S,
    response: CameraResponse | None = None,
    progress: Callable[[float], None] | None = None,
) -> NoiseRecord:
    """Shoot pairs of frames from dark to saturated at some gains, and return the noise.

    Args:
        camera: an open camera
        is_flat: an evenly lit surface fills the picture
        exposures: pairs at each gain, at least 3
        longest_s: longest shutter time, s
        response: of the camera; None: as its controls state it
        progress: called with the share that is done, 0 to 1

    Raises:
        CaptureError: the scene is too dark or too bright for the camera's shutter times
        DataError: the response is only assumed, or the frames are not suitable; says why and what
            to do
        CameraError: as `Camera.shoot` raises
    """
    controls = camera.controls
    if response is None:
        controls.check_response("noise")
    responses = same_response(response or controls.levels, controls.layout)
    if controls.responses and response is None:
        responses = dict(zip("RGB", controls.responses, strict=True))
    frames = NoiseFrames(controls.layout, controls.black, controls.white, responses, is_flat)
    settings = _settings(camera, exposures, longest_s)
    for done, frame in enumerate(camera.shoot([each for each in settings for _ in (0, 1)])):
        frames.add(frame.pixels, frame.requested)
        if progress is not None:
            progress((done + 1) / (2 * len(settings)))
        if frame.original is not None:
            frames.note_format(frame.original.suffix)
    return estimate_noise(frames)


def _settings(camera: Camera, count: int, longest_s: float) -> list[ExposureSetting]:
    """Return settings from dark to saturated, at some gains."""
    controls = camera.controls
    base = controls.gain.nearest(1.0)
    shortest = controls.time_s.minimum
    middle = {}
    for frame in probes(camera, longest_s):
        samples = metered(frame)
        middle[frame.requested.time_s] = float(np.quantile(samples, 0.9))
        if np.quantile(samples, 2 * FEW) >= 1:
            break
    seen = list(middle)
    if middle[seen[0]] >= 1 and len(seen) == 1:
        raise too_bright(seen[0])
    if middle[seen[-1]] < DIM:
        raise too_dark(
            f"its brighter parts have {middle[seen[-1]]:.0%} of full scale at {seen[-1]:.4g} s"
        )
    first = next(time_s for time_s in seen if middle[time_s] >= FEW)
    found = []
    for gain in _gains(controls.gain, base):
        scale = base / gain
        least, most = (max(shortest, each * scale) for each in (first, seen[-1]))
        chosen = spread_times(controls.time_s, least, most, count)
        if len(chosen) >= 3 or gain == base:
            found += [ExposureSetting(time_s, gain) for time_s in chosen]
    return found


def _gains(control: Control, base: float) -> list[float]:
    """Return the gain `base` and those a factor `_GAIN_STEP` apart above it."""
    gains = [base]
    while len(gains) < _MOST_GAINS and gains[-1] * 2 <= control.maximum:
        gains.append(control.nearest(min(gains[-1] * _GAIN_STEP, control.maximum)))
    return gains
