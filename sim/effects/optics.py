"""Effects on light, before it becomes charge: timing, lens, colour filters, crosstalk, lamps."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from camctl.picture_operations import correlated, enlarged_smoothly, reduced_by_area, smoothed
from sim.effects.record import Change, Effect, Light, Lines, RowTiming, Shot, Stage

_GLARE_SAMPLES_PER_SIGMA = 2.5
"""Glare is computed at this many samples a standard deviation, enough for a smooth Gaussian."""

_ROUNDED_SWING = 2.0**-26  # 1 plus or minus less than this is 1 in float32
_STEADY = "over this exposure the light of the lamps averages out"


def _has_moving_target(shot: Shot) -> bool:
    return shot.view.target is not None and shot.statistics.speed_px_s > 0


def _blur_motion(timing: RowTiming, _: Shot) -> RowTiming:
    return replace(timing, is_motion_blurred=True)


def _motion_change(shot: Shot) -> Change:
    # Left out, the target is drawn where it is in the middle of the exposure: on average wrong by a
    # quarter of the distance that it travels.
    s = shot.statistics
    off = min(s.drift * s.speed_px_s * shot.time_s / 4, s.most - s.least)
    return Change(light=off)


def _has_rolling_shutter(shot: Shot) -> bool:
    depends_on_time = shot.view.target is not None or shot.view.lamps is not None
    return shot.sensor.read_out.row_s > 0 and depends_on_time


def _roll(timing: RowTiming, shot: Shot) -> RowTiming:
    return replace(timing, starts_s=shot.row_starts_s)


def _rolling_change(shot: Shot) -> Change:
    # Left out, every row has the time of the middle one, which is at most half the picture away.
    s = shot.statistics
    late_s = shot.sensor.read_out.row_s * (s.height // 2)
    light = min(s.drift * s.speed_px_s * late_s, s.most - s.least)
    lamps = shot.view.lamps
    if lamps is None:
        return Change(light=light)
    swing = lamps.remaining_depth(shot.time_s)
    if swing < _ROUNDED_SWING and light == 0:
        return Change(nothing=_STEADY)
    change = min(2 * swing, 2 * math.pi * lamps.flicker_hz * late_s * swing)
    share = change / (1 - swing) if swing < 1 else math.inf
    return Change(light=light, less=min(share, 1.0), more=share, within="mains flicker")


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
    return Change(light=min(moment / 2 * (s.bend + _glare_bend(shot)), s.most - s.least))


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


def _glare_bend(shot: Shot) -> float:
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


def _crosstalk(light: Light, shot: Shot) -> Light:
    share = shot.sensor.pixels.crosstalk
    kernel = np.array([[0, share, 0], [share, 1 - 4 * share, share], [0, share, 0]], np.float32)
    return correlated(light, kernel, repeats_border=True)


def _crosstalk_change(shot: Shot) -> Change:
    s, share = shot.statistics, shot.sensor.pixels.crosstalk
    spread = s.most - s.least * (1 - shot.sensor.lens.vignetting)
    if s.is_mosaic:  # neighbours have other colours
        return Change(light=4 * share * spread)
    bend = s.bend + _glare_bend(shot) + _vignetting_bend(shot)
    return Change(light=share * min(bend, 4 * spread))


def _vignetting_loss(shot: Shot) -> tuple[float, float, float]:
    """Return the loss a square pixel, and the distance of the edges from the middle, (y, x)."""
    y, x = (shot.rows - 1) / 2, (shot.width // shot.channels - 1) / 2
    return shot.sensor.lens.vignetting / max(y**2 + x**2, 1.0), y, x


def _vignetting(light: Light, shot: Shot) -> Light:
    rows, columns = light.shape[:2]
    loss, top, left = _vignetting_loss(shot)
    along = (1 - loss * (np.arange(rows) - top) ** 2).astype(np.float32)
    across = (loss * (np.arange(columns) - left) ** 2).astype(np.float32)
    factors = np.subtract(along[:, np.newaxis], across)
    np.maximum(factors, np.float32(0), out=factors)
    return light * (factors if light.ndim == 2 else factors[..., np.newaxis])


def _vignetting_bend(shot: Shot) -> float:
    """Return by how much vignetting can enlarge second differences, along rows plus along columns.

    The second difference of a product V E is at most that of E, plus twice the product of the
    slopes, plus E times the second difference of V; at a border, which is mirrored, plus E times
    the slope of V instead.  A slope of E is at most its range.
    """
    s = shot.statistics
    loss, *edges = _vignetting_loss(shot)
    slopes = [2 * loss * edge for edge in edges]
    bent = [2 * slope * (s.most - s.least) + s.most * max(slope, 2 * loss) for slope in slopes]
    return sum(bent)


def _flicker_lines(shot: Shot, timing: RowTiming) -> Lines:
    assert shot.view.lamps is not None
    return Lines(np.multiply, rows=shot.view.lamps.factors(timing.starts_s, shot.time_s))


def _flicker_change(shot: Shot) -> Change:
    assert shot.view.lamps is not None
    swing = shot.view.lamps.remaining_depth(shot.time_s)
    if swing < _ROUNDED_SWING:
        return Change(nothing=_STEADY)
    return Change(less=swing, more=swing)


def rounding_count(shot: Shot) -> float:
    """Return how many roundings in float32 the light of a sample goes through, one after another.

    A sum of n terms >= 0 is wrong by at most n units of rounding.  Those of glare count by the
    share of the light that is glare.
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
    if shot.view.target is not None:
        count += 6
    return count


OPTICS = (
    Effect(
        "motion blur",
        Stage.SCENE,
        "mean of the target's positions over the exposure, pixels a second; exact along the rows",
        present=_has_moving_target,
        change=_motion_change,
        cost=3.0,
        timing=_blur_motion,
    ),
    Effect(
        "rolling shutter",
        Stage.SCENE,
        "each row is exposed row_s seconds after the row above; acts on targets and on flicker",
        present=_has_rolling_shutter,
        change=_rolling_change,
        cost=0.3,
        timing=_roll,
    ),
    Effect(
        "veiling glare",
        Stage.LENS,
        "ISO 9358: a share of all light is scattered widely; a Gaussian of glare_width",
        present=lambda shot: shot.sensor.lens.glare > 0,
        change=_glare_change,
        cost=1.5,
        picture=_glare,
    ),
    Effect(
        "point spread",
        Stage.LENS,
        "a Gaussian of blur_px for the point spread of the lens, as blur in ISO 12233; pixels",
        present=lambda shot: shot.sensor.lens.blur_px > 0,
        change=_blur_change,
        cost=1.2,
        picture=_blur,
    ),
    Effect(
        "colour mosaic",
        Stage.SAMPLES,
        "one colour a pixel, each with the spectral response of `Sensor.spectrum`",
        present=lambda shot: shot.view.layout.is_mosaic,
        change=lambda _: Change(never="never left out: it determines the colour of each sample"),
        cost=0.0,
    ),
    Effect(
        "vignetting",
        Stage.SAMPLES,
        "1 - v r^2, r from 0 in the middle to 1 in the corners: the first term of cos^4",
        present=lambda shot: shot.sensor.lens.vignetting > 0,
        change=lambda shot: Change(less=shot.sensor.lens.vignetting),
        cost=0.4,
        picture=_vignetting,
    ),
    Effect(
        "crosstalk",
        Stage.SAMPLES,
        "a share of a pixel's light goes to each of its four neighbours (diffusion)",
        present=lambda shot: shot.sensor.pixels.crosstalk > 0,
        change=_crosstalk_change,
        cost=0.6,
        picture=_crosstalk,
    ),
    Effect(
        "mains flicker",
        Stage.MEAN,
        "lamps on 50 or 60 Hz mains peak at 100 or 120 Hz: 1 + a cos, averaged over the exposure",
        present=lambda shot: shot.view.lamps is not None,
        change=_flicker_change,
        cost=0.3,
        lines=_flicker_lines,
    ),
)
