"""Effects of the lens: veiling glare, point spread, diffraction, and lateral colour."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from camctl.sim.effects.record import Change, Effect, Lacking, Light, Shot, Stage
from camctl.system.picture_operations import (
    enlarged_smoothly,
    reduced_by_area,
    required_opencv,
    smoothed,
)

_GLARE_SAMPLES_PER_SIGMA = 2.5
"""Glare is computed at this many samples a standard deviation, enough for a smooth Gaussian."""

_CHANNELS_UM = (0.60, 0.54, 0.46)  # wavelengths of red, green and blue
_FIRST_ZERO, _THIRD_ZERO = 3.8317, 10.1735  # of the Bessel function J1: dark rings of an Airy disk
_PARTS_OF_A_PIXEL = 7  # along rows and columns, to average the Airy disk over a pixel


def gaussian(sigma: float) -> Light:
    """Return a Gaussian kernel with sum 1 that reaches 3 sigma to both sides."""
    reach = max(1, math.ceil(3 * sigma))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    return np.asarray(kernel / kernel.sum(), dtype=np.float32)


def _blur(planes: Light, shot: Shot) -> Light:
    return smoothed(planes, gaussian(shot.sensor.lens.blur_px))


def _blur_change(shot: Shot) -> Change:
    # sum_j k_j E(x + j) - E(x) for a symmetric k is a sum of second differences over j, each at
    # most j^2 times the largest one: half the second moment times that, along and across.
    s = shot.statistics
    kernel = gaussian(shot.sensor.lens.blur_px).astype(np.float64)
    reach = kernel.size // 2
    moment = float((kernel * np.arange(-reach, reach + 1) ** 2).sum())
    return Change(light=min(moment / 2 * (s.bend + glare_bend(shot)), s.most - s.least))


def _glare_samples(shot: Shot) -> tuple[tuple[int, int], Light]:
    """Return the (columns, rows) at which glare is computed, and its kernel at that scale."""
    rows, columns = shot.rows, shot.width // shot.channels
    sigma = shot.sensor.lens.glare_width * max(rows, columns)
    step = max(1, int(sigma / _GLARE_SAMPLES_PER_SIGMA))
    return (max(1, columns // step), max(1, rows // step)), gaussian(sigma / step)


def _glare(planes: Light, shot: Shot) -> Light:
    lens = shot.sensor.lens
    rows, columns = planes.shape[:2]
    size, kernel = _glare_samples(shot)
    small = smoothed(reduced_by_area(planes, size), kernel)
    wide = enlarged_smoothly(small, (columns, rows))
    return planes * np.float32(1 - lens.glare) + wide * np.float32(lens.glare)


def _glare_change(shot: Shot) -> Change:
    s = shot.statistics
    return Change(light=shot.sensor.lens.glare * (s.most - s.least))


def glare_bend(shot: Shot) -> float:
    """Return by how much glare can enlarge second differences, along rows plus along columns.

    A kernel that rises and falls once changes what it smooths from sample to sample by at most its
    peak times the light's range.  Enlarged to pixels, that slope is smaller by the scale, and a
    second difference is the difference of two slopes.
    """
    s, glare = shot.statistics, shot.sensor.lens.glare
    if glare == 0:
        return 0.0
    (columns, rows), kernel = _glare_samples(shot)
    scale = columns * shot.channels / shot.width + rows / shot.rows
    return 2 * glare * float(kernel.max()) * scale * (s.most - s.least)


def _bessel_1(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return J1(x) by its integral over 64 angles, which is exact to rounding for abs(x) < 40."""
    angle = (np.arange(64) + 0.5) * (np.pi / 64)
    waves = np.cos(angle - x[..., np.newaxis] * np.sin(angle))
    return np.asarray(waves.mean(axis=-1))


@lru_cache(maxsize=1)
def _airy_intensity() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return distances in the argument of J1, and the light of an Airy disk there."""
    v = np.linspace(0, _THIRD_ZERO, 4096)
    intensity = np.ones_like(v)
    intensity[1:] = (2 * _bessel_1(v[1:]) / v[1:]) ** 2
    return v, intensity


@lru_cache(maxsize=8)
def airy_kernel(radius_px: float) -> NDArray[np.float64]:
    """Return the Airy disk averaged over pixels, with sum 1, up to its third dark ring.

    The light beyond that ring, 6 %, is spread over the rest.  `radius_px`: of the first dark ring.
    """
    reach = max(1, math.ceil(radius_px * _THIRD_ZERO / _FIRST_ZERO))
    parts, side = _PARTS_OF_A_PIXEL, 2 * reach + 1
    at = ((np.arange(side * parts) + 0.5) / parts - side / 2) * (_FIRST_ZERO / radius_px)
    distance = np.hypot(at, at[:, np.newaxis])
    fine = np.interp(distance, *_airy_intensity(), right=0.0)
    kernel = fine.reshape(side, parts, side, parts).sum(axis=(1, 3))
    return np.asarray(kernel / kernel.sum())


def _diffraction(planes: Light, shot: Shot) -> Light:
    cv2 = required_opencv("the simulation of diffraction")
    spread = np.empty(planes.shape, np.float32)
    lengths = _CHANNELS_UM if planes.ndim == 3 else (0.55,)
    for number, length_um in enumerate(lengths):
        here = (..., number) if planes.ndim == 3 else (...,)
        kernel = airy_kernel(shot.sensor.airy_radius_px(length_um))
        # In double precision, since large kernels are applied by a Fourier transform, whose
        # rounding error is relative to the brightest light; results may be negative.
        wide = cv2.filter2D(
            planes[here].astype(np.float64), -1, kernel, borderType=cv2.BORDER_REFLECT
        )
        spread[here] = np.maximum(wide, 0)
    return spread


def _diffraction_change(shot: Shot) -> Change:
    # As for `_blur_change`: half the second moment times the second differences.
    s = shot.statistics
    kernel = airy_kernel(shot.sensor.airy_radius_px(max(_CHANNELS_UM)))
    reach = kernel.shape[0] // 2
    moment = float((kernel.sum(axis=0) * np.arange(-reach, reach + 1) ** 2).sum())
    return Change(light=min(moment / 2 * (s.bend + glare_bend(shot)), s.most - s.least))


def _magnified(plane: Light, scale: float, axis: int) -> Light:
    """Return a picture drawn larger by `scale` along an axis, around its middle."""
    size = plane.shape[axis]
    middle = (size - 1) / 2
    at = np.clip(middle + (np.arange(size) - middle) / scale, 0, size - 1)
    cell = np.minimum(at.astype(np.intp), max(size - 2, 0))
    part = (at - cell).astype(np.float32)
    left, right = plane.take(cell, axis), plane.take(np.minimum(cell + 1, size - 1), axis)
    if axis == 0:
        part = part[:, np.newaxis]
    return np.asarray(left * (1 - part) + right * part)


def _lateral_colour(planes: Light, shot: Shot) -> Light:
    share = shot.sensor.lens.lateral_colour
    drawn = planes.copy()
    for channel, scale in ((0, 1 + share), (2, 1 - share)):
        wide = _magnified(planes[..., channel], scale, 0)
        drawn[..., channel] = _magnified(wide, scale, 1)
    return drawn


def _has_lateral_colour(shot: Shot) -> bool:
    is_coloured = shot.view.light.ndim == 3 or shot.statistics.is_mosaic
    return shot.sensor.lens.lateral_colour > 0 and is_coloured


def _lateral_change(shot: Shot) -> Change:
    # Light comes from at most so many pixels away; glare adds half of what it adds to two slopes.
    s, lens = shot.statistics, shot.sensor.lens
    share = lens.lateral_colour / (1 - lens.lateral_colour)
    away = [share * (n - 1) / 2 for n in (shot.rows, shot.width // shot.channels)]
    across, along = (slope + glare_bend(shot) / 2 for slope in s.slopes)
    return Change(light=min(away[0] * across + away[1] * along, s.most - s.least))


def rounding_count(shot: Shot) -> float:
    """Return how many roundings in float32 the light of a sample goes through, one after another.

    A sum of n terms >= 0 is wrong by at most n units of rounding.  Roundings of glare count by
    the share of the light that is glare.
    """
    lens = shot.sensor.lens
    count = 0.0
    if lens.blur_px > 0:
        count += 2 * gaussian(lens.blur_px).size
    if lens.glare > 0:
        (columns, rows), kernel = _glare_samples(shot)
        averaged = shot.width / shot.channels / columns + shot.rows / rows
        count += 4 + lens.glare * (2 * kernel.size + 2 * averaged + 8)
    if lens.vignetting > 0:
        count += 3
    if shot.sensor.pixels.crosstalk > 0:
        count += 6
    if lens.diffraction:
        count += 2
    if lens.lateral_colour > 0:
        count += 6
    if shot.view.target is not None:
        count += 6
    return count


LENS = (
    Effect(
        "veiling glare",
        Stage.LENS,
        "ISO 9358: a share of all light is scattered widely; a Gaussian of glare_width",
        present=lambda shot: shot.sensor.lens.glare > 0,
        change=_glare_change,
        cost=3.2,
        picture=_glare,
    ),
    Effect(
        "point spread",
        Stage.LENS,
        "a Gaussian of blur_px for the point spread of the lens, as blur in ISO 12233; pixels",
        present=lambda shot: shot.sensor.lens.blur_px > 0,
        change=_blur_change,
        cost=1.4,
        picture=_blur,
    ),
    Effect(
        "diffraction",
        Stage.LENS,
        "Airy disk of 600, 540 and 460 nm (grey: 550 nm) to its third dark ring, mean over each"
        " pixel; first dark ring 1.22 x wavelength x f-number",
        present=lambda shot: shot.sensor.lens.diffraction,
        change=_diffraction_change,
        cost=5.0,
        picture=_diffraction,
    ),
    Effect(
        "lateral colour",
        Stage.LENS,
        "transverse chromatic aberration: red drawn larger than green by a share, and blue smaller",
        present=_has_lateral_colour,
        change=_lateral_change,
        cost=4.5,
        lacking=lambda s: Lacking.KIND if s.sensor.lens.lateral_colour > 0 else Lacking.MODEL,
        picture=_lateral_colour,
    ),
)
