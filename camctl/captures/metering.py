"""Metering: find the shortest exposure, which puts the highlights just below saturation."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.camera import Camera, Frame, PreviewingCamera
from camctl.captures.pictures import planes
from camctl.captures.request import Metering
from camctl.controls import ExposureSetting
from camctl.errors import CaptureError, UsageError
from camctl.response.camera import FloatArray

#: Share of a channel's samples above the highlights: reflections of lamps, and hot pixels.
OUTLIER_SHARE = 1e-4
#: Target for the highlights, as a share of the levels: below white by a few times photon noise.
TARGET_SHARE = 0.97
#: Highlights at this share of the levels or above are measured well enough.
_MEASURED_SHARE = 0.75
#: A scene with no more than this share of the levels at the longest exposure is black.
BLACK_SHARE = 0.01
#: Metering frames at most; each step changes the time by a factor of up to `_LARGEST_STEP`.
_MOST_FRAMES = 16
_LARGEST_STEP = 16.0
#: Factor by which a saturated exposure is shortened while no unsaturated one is known.
_SHORTENING = 8
#: Shutter time of the first metering frame, s.
_FIRST_S = 1 / 60
#: Samples of a plane that are counted, at most.
_MOST_SAMPLES = 1 << 20
#: More than this share of saturated samples at the shortest exposure: all is white.
_WHITE_SHARE = 0.5
#: A histogram takes light from a frame where it reaches this many levels, else from a longer one.
_READABLE_LEVELS = 8
#: Longest exposure for a histogram, s: the user waits for it.
_LONGEST_HISTOGRAM_S = 1.0
#: Irradiances that stand for one brightness in a histogram.
_SPREAD = 16


def highlight(frame: Frame, camera: Camera) -> tuple[int, float]:
    """Return (brightness of the highlights above black in the fullest channel, share clipped).

    The highlights are the brightest samples without the brightest `OUTLIER_SHARE`.
    """
    brightest, clipped, total = 0, 0, 0
    for plane in planes(frame.pixels, camera.controls.layout):
        counts = np.bincount(_sample(plane), minlength=frame.white + 1)
        above = np.cumsum(counts[::-1])[::-1]  # above[B]: samples of brightness >= B
        allowed = OUTLIER_SHARE * above[0]
        brightest = max(brightest, int(np.flatnonzero(above > allowed)[-1]))
        clipped += int(above[frame.white])
        total += int(above[0])
    return max(0, min(brightest, frame.white) - frame.black), clipped / total


def _sample(plane: NDArray[Any]) -> NDArray[Any]:
    """Return about `_MOST_SAMPLES` samples of a plane at most, (N,), evenly spread."""
    step = max(1, math.isqrt(plane.size // _MOST_SAMPLES))
    return plane[::step, ::step].ravel()


def _metering_frames(camera: Camera, spend_shutter: bool) -> Callable[[ExposureSetting], Frame]:
    """Return the function that takes one metering frame."""
    if isinstance(camera, PreviewingCamera):
        return camera.preview
    if not spend_shutter:
        raise UsageError(
            f"{camera.info.id} has no preview, and metering would cost shutter actuations",
            hint="allow them with --meter, or give the shortest exposure with --base SECONDS",
        )

    def actuate(setting: ExposureSetting) -> Frame:
        with closing(camera.shoot([setting])) as frames:
            return next(frames)

    return actuate


def meter(camera: Camera, *, spend_shutter: bool = False, small_aperture: bool = False) -> Metering:
    """Take metering frames until the highlights are just below saturation.

    `small_aperture` uses the largest f-number, so that opening the aperture can lengthen an
    exposure.

    Raises:
        UsageError: the camera has no preview and `spend_shutter` does not allow actuations
        CaptureError: all is black at the longest exposure, or white at the shortest
    """
    controls = camera.controls
    take = _metering_frames(camera, spend_shutter)
    levels = controls.levels.levels
    aperture = controls.f_number
    f_number = aperture.maximum if aperture is not None and small_aperture else None
    gain = controls.gain.nearest(1.0)
    shortest, longest = controls.time_s.minimum, controls.time_s.maximum
    below = above = None  # the longest time that was not saturated, the shortest that was
    time_s = controls.time_s.nearest(min(max(_FIRST_S, shortest), longest))
    best: tuple[ExposureSetting, int, float] | None = None
    frames = 0
    while frames < _MOST_FRAMES:
        setting = ExposureSetting(time_s, gain, f_number)
        bright, clipped = highlight(take(setting), camera)
        frames += 1
        if bright >= levels.size:
            above = time_s
            if time_s <= shortest:
                best = (setting, bright, clipped)
                break
            target_s = math.sqrt(below * above) if below else time_s / _SHORTENING
        else:
            below, best = time_s, (setting, bright, clipped)
            if bright >= _MEASURED_SHARE * levels.size or time_s >= longest:
                break
            target_s = time_s * _headroom(levels, bright)
            if above and target_s >= above:
                target_s = math.sqrt(below * above)
        next_s = controls.time_s.nearest(min(max(target_s, shortest), longest))
        if next_s in (below, above):
            break
        time_s = next_s
    if best is None:
        raise CaptureError(
            f"the light changes too fast: it was not metered in {_MOST_FRAMES} frames",
            hint="give the shortest exposure with --base SECONDS",
        )
    setting, bright, clipped = best
    if bright <= BLACK_SHARE * levels.size and setting.time_s >= longest:
        raise CaptureError(
            f"the picture is black even at {longest:.4g} s",
            hint="take the lens cap off, or light the scene",
        )
    if clipped > _WHITE_SHARE:
        raise CaptureError(
            f"the picture is white even at {shortest:.4g} s",
            hint="close the aperture, or put a filter before the lens",
        )
    limit_s = setting.time_s * (_headroom(levels, bright) if bright < levels.size else 1.0)
    return Metering(
        limit_s=min(max(limit_s, shortest), longest),
        setting=setting,
        highlight=bright / levels.size,
        clipped=clipped,
        frames=frames,
    )


def light_histogram(
    camera: Camera, metering: Metering, dynamic_range: float, *, spend_shutter: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Return the histogram of the light: (irradiance, count), both (K,), E = 1 at `limit_s`.

    A frame at the metered setting gives the highlights; each longer one gives the light below
    `_READABLE_LEVELS` levels of the frame before, down to the desired range or to
    `_LONGEST_HISTOGRAM_S`.
    """
    controls = camera.controls
    take = _metering_frames(camera, spend_shutter)
    levels = controls.levels.levels
    # All irradiances between two levels have one brightness: its count is spread over them, evenly
    # in ln E.
    low, high = controls.levels.gaps
    setting, upper = metering.setting, np.inf
    light, counts = [], []
    while True:
        frame = take(setting)
        scale = metering.limit_s / setting.time_s
        found = np.zeros(levels.size + 1)
        for plane in planes(frame.pixels, controls.layout):
            above = np.clip(_sample(plane).astype(np.intp) - frame.black, 0, levels.size)
            found += np.bincount(above, minlength=levels.size + 1)
        target_s = min(setting.time_s * levels.size / (2 * _READABLE_LEVELS), _LONGEST_HISTOGRAM_S)
        longer_s = controls.time_s.nearest(max(target_s, setting.time_s))
        readable = levels[min(_READABLE_LEVELS, levels.size) - 1] * scale
        last = readable <= 1 / dynamic_range or longer_s <= setting.time_s
        lower = 0.0 if last else readable
        least = np.maximum(low * scale, min(1 / dynamic_range, levels[0] * scale))
        E = np.geomspace(least, high * scale, 2 * _SPREAD + 1)[1::2]
        kept = (high * scale > lower) & (high * scale <= upper)
        light.append(E[:, kept].ravel())
        counts.append(np.tile(found[kept] / _SPREAD, _SPREAD))
        if last:
            return np.concatenate(light), np.concatenate(counts)
        upper = lower
        setting = replace(setting, time_s=longer_s)


def _headroom(levels: FloatArray, bright: int) -> float:
    """Return the factor by which an exposure may grow until `bright` reaches the target."""
    target = float(levels[max(0, math.ceil(TARGET_SHARE * levels.size) - 1)])
    if bright == 0:
        return _LARGEST_STEP
    # The upper end of the brightness' gap: the light may be anywhere in it, and must not clip.
    return min(_LARGEST_STEP, target / float(levels[min(bright, levels.size - 1)]))
