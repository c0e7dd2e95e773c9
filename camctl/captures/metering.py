"""Finding the shortest exposure: the one that puts the highlights just below saturation."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.camera import Camera, Frame, PreviewingCamera
from camctl.captures.demosaic import planes
from camctl.captures.request import Metering
from camctl.controls import ExposureSetting
from camctl.errors import CaptureError, UsageError
from camctl.response.camera import FloatArray

#: Share of a channel's samples that may lie above "the highlights": glints and hot pixels.
GLINTS = 1e-4
#: Where the highlights are put, as a share of the levels: below white by a few times photon noise.
AIM = 0.97
#: Nearer than this to saturation the highlights are known well enough.
NEAR = 0.75
#: A scene that gives no more than this share of the levels at the longest exposure is black.
NOTHING = 0.01
_LOOKS = 16
#: Levels above black from which a histogram trusts a frame, and not a longer one.
_READABLE = 8
_LONGEST_LOOK_S = 1.0
_SPREAD = 16
_FIRST_S = 1 / 60
_SAMPLES = 1 << 20


def highlight(frame: Frame, camera: Camera) -> tuple[int, float]:
    """Return (brightness of the highlights above black in the fullest channel, share clipped).

    The highlights are the brightest samples but for `GLINTS` of them.
    """
    brightest, clipped, seen = 0, 0, 0
    for plane in planes(frame.pixels, camera.controls.layout):
        counts = np.bincount(_sample(plane), minlength=frame.white + 1)
        above = np.cumsum(counts[::-1])[::-1]  # above[B]: samples of brightness >= B
        allowed = GLINTS * above[0]
        brightest = max(brightest, int(np.flatnonzero(above > allowed)[-1]))
        clipped += int(above[frame.white])
        seen += int(above[0])
    return max(0, min(brightest, frame.white) - frame.black), clipped / seen


def _sample(plane: NDArray[Any]) -> NDArray[Any]:
    """Return about `_SAMPLES` samples of a plane at most, (N,), evenly spread."""
    step = max(1, math.isqrt(plane.size // _SAMPLES))
    return plane[::step, ::step].ravel()


def _looker(camera: Camera, spend_shutter: bool) -> Callable[[ExposureSetting], Frame]:
    if isinstance(camera, PreviewingCamera):
        return camera.preview
    if not spend_shutter:
        raise UsageError(
            f"{camera.info.id} has no preview, and metering would cost shutter actuations",
            hint="say --meter to allow them, or give the shortest exposure with --base SECONDS",
        )

    def actuate(setting: ExposureSetting) -> Frame:
        with closing(camera.shoot([setting])) as frames:
            return next(frames)

    return actuate


def meter(camera: Camera, *, spend_shutter: bool = False, small_aperture: bool = False) -> Metering:
    """Look through the camera until the highlights lie below saturation but near it.

    `small_aperture` closes the lens as far as it goes, so that opening it can lengthen an exposure.

    Raises:
        UsageError: the camera has no preview and `spend_shutter` does not allow actuations
        CaptureError: nothing can be seen at the longest exposure, or all is white at the shortest

    """
    controls = camera.controls
    look = _looker(camera, spend_shutter)
    levels = controls.levels.levels
    aperture = controls.f_number
    f_number = aperture.maximum if aperture is not None and small_aperture else None
    gain = controls.gain.nearest(1.0)
    shortest, longest = controls.time_s.minimum, controls.time_s.maximum
    below = above = None  # the longest time that was not saturated, the shortest that was
    time_s = controls.time_s.nearest(min(max(_FIRST_S, shortest), longest))
    best: tuple[ExposureSetting, int, float] | None = None
    looks = 0
    while looks < _LOOKS:
        setting = ExposureSetting(time_s, gain, f_number)
        bright, clipped = highlight(look(setting), camera)
        looks += 1
        if bright >= levels.size:
            above = time_s
            if time_s <= shortest:
                best = (setting, bright, clipped)
                break
            wanted = math.sqrt(below * above) if below else time_s / 8
        else:
            below, best = time_s, (setting, bright, clipped)
            if bright >= NEAR * levels.size or time_s >= longest:
                break
            wanted = time_s * _stretch(levels, bright)
            if above and wanted >= above:
                wanted = math.sqrt(below * above)
        next_s = controls.time_s.nearest(min(max(wanted, shortest), longest))
        if next_s in (below, above):
            break
        time_s = next_s
    if best is None:
        raise CaptureError(
            f"the light changes too fast to be metered in {_LOOKS} looks",
            hint="give the shortest exposure with --base SECONDS",
        )
    setting, bright, clipped = best
    if bright <= NOTHING * levels.size and setting.time_s >= longest:
        raise CaptureError(
            f"there is nothing to see: all is black even at {longest:.4g} s",
            hint="take the lens cap off, or light the scene",
        )
    if clipped > 0.5:
        raise CaptureError(
            f"all is white even at {shortest:.4g} s",
            hint="close the aperture, or put a filter before the lens",
        )
    limit_s = setting.time_s * (_stretch(levels, bright) if bright < levels.size else 1.0)
    return Metering(
        limit_s=min(max(limit_s, shortest), longest),
        setting=setting,
        highlight=bright / levels.size,
        clipped=clipped,
        frames=looks,
    )


def light_histogram(
    camera: Camera, metering: Metering, dynamic_range: float, *, spend_shutter: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Return what light there is: (irradiance, count), both (K,), E = 1 at the metered limit.

    One frame at the metered setting tells the highlights; ever longer ones tell what lay below
    `_READABLE` levels of the one before, down to the wanted range or as long as a person waits.
    """
    controls = camera.controls
    look = _looker(camera, spend_shutter)
    levels = controls.levels.levels
    # A brightness stands for all light of its gap: spread over it, evenly in its logarithm.
    low, high = controls.levels.gaps
    setting, upper = metering.setting, np.inf
    light, counts = [], []
    while True:
        frame = look(setting)
        scale = metering.limit_s / setting.time_s
        found = np.zeros(levels.size + 1)
        for plane in planes(frame.pixels, controls.layout):
            above = np.clip(_sample(plane).astype(np.intp) - frame.black, 0, levels.size)
            found += np.bincount(above, minlength=levels.size + 1)
        wanted_s = min(setting.time_s * levels.size / (2 * _READABLE), _LONGEST_LOOK_S)
        longer_s = controls.time_s.nearest(max(wanted_s, setting.time_s))
        readable = levels[min(_READABLE, levels.size) - 1] * scale
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


def _stretch(levels: FloatArray, bright: int) -> float:
    """Return by how much an exposure may grow until `bright` reaches `AIM` of the levels."""
    aim = float(levels[max(0, math.ceil(AIM * levels.size) - 1)])
    if bright == 0:
        return 16.0
    # The upper end of the brightness' gap: the light may lie anywhere in it, and must not clip.
    return min(16.0, aim / float(levels[min(bright, levels.size - 1)]))
