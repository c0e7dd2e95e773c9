"""Effects on light, before it becomes charge: timing, colour filters, crosstalk, lamps."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from camctl.sim.effects.lens import LENS, glare_bend
from camctl.sim.effects.record import (
    Change,
    Effect,
    Lacking,
    Light,
    Lines,
    RowTiming,
    Shot,
    Stage,
)
from camctl.sim.scenes.motion import Lamps, PwmLamps
from camctl.system.picture_operations import correlated

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
    less, more = lamps.swing(shot.time_s)
    if max(less, more) < _ROUNDED_SWING and light == 0:
        return Change(nothing=_STEADY)
    change = min(less + more, lamps.steepest(shot.time_s) * late_s)
    share = change / (1 - less) if less < 1 else math.inf
    within = "PWM lamps" if isinstance(lamps, PwmLamps) else "mains flicker"
    return Change(light=light, less=min(share, 1.0), more=share, within=within)


def _crosstalk(light: Light, shot: Shot) -> Light:
    share = shot.sensor.pixels.crosstalk
    kernel = np.array([[0, share, 0], [share, 1 - 4 * share, share], [0, share, 0]], np.float32)
    return correlated(light, kernel, repeats_border=True)


def _crosstalk_change(shot: Shot) -> Change:
    s, share = shot.statistics, shot.sensor.pixels.crosstalk
    spread = s.most - s.least * (1 - shot.sensor.lens.vignetting)
    # Neighbours in a mosaic have other colours, and lateral colour bends light in other ways.
    if s.is_mosaic or shot.sensor.lens.lateral_colour > 0:
        return Change(light=4 * share * spread)
    bend = s.bend + glare_bend(shot) + _vignetting_bend(shot)
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

    The second difference of a product V E is at most the second difference of E, plus twice the
    product of the slopes, plus E times the second difference of V; at a border, which is mirrored,
    plus E times the slope of V instead.  A slope of E is at most its range.
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
    less, more = shot.view.lamps.swing(shot.time_s)
    if max(less, more) < _ROUNDED_SWING:
        return Change(nothing=_STEADY)
    return Change(less=less, more=more)


OPTICS = (
    Effect(
        "motion blur",
        Stage.SCENE,
        "mean of the target's positions over the exposure, pixels a second; exact along the rows",
        present=_has_moving_target,
        change=_motion_change,
        cost=3.0,
        lacking=lambda _: Lacking.SCENE,
        timing=_blur_motion,
    ),
    Effect(
        "rolling shutter",
        Stage.SCENE,
        "each row is exposed row_s seconds after the row above; acts on targets and on flicker",
        present=_has_rolling_shutter,
        change=_rolling_change,
        cost=0.3,
        lacking=lambda s: Lacking.SCENE if s.sensor.read_out.row_s > 0 else Lacking.MODEL,
        timing=_roll,
    ),
    *LENS,
    Effect(
        "colour mosaic",
        Stage.SAMPLES,
        "one colour a pixel, each with the spectral response of `Sensor.spectrum`",
        present=lambda shot: shot.view.layout.is_mosaic,
        change=lambda _: Change(never="never left out: it determines the colour of each sample"),
        cost=0.0,
        lacking=lambda _: Lacking.KIND,
    ),
    Effect(
        "vignetting",
        Stage.SAMPLES,
        "1 - v r^2, r from 0 in the middle to 1 in the corners: the first term of cos^4",
        present=lambda shot: shot.sensor.lens.vignetting > 0,
        change=lambda shot: Change(less=shot.sensor.lens.vignetting),
        cost=1.5,
        picture=_vignetting,
    ),
    Effect(
        "crosstalk",
        Stage.SAMPLES,
        "a share of a pixel's light goes to each of its four neighbours (diffusion)",
        present=lambda shot: shot.sensor.pixels.crosstalk > 0,
        change=_crosstalk_change,
        cost=1.0,
        picture=_crosstalk,
    ),
    Effect(
        "mains flicker",
        Stage.MEAN,
        "lamps on 50 or 60 Hz mains peak at 100 or 120 Hz: 1 + a cos, averaged over the exposure",
        present=lambda shot: isinstance(shot.view.lamps, Lamps),
        change=_flicker_change,
        cost=0.4,
        lacking=lambda _: Lacking.SCENE,
        lines=_flicker_lines,
    ),
    Effect(
        "PWM lamps",
        Stage.MEAN,
        "lamps that are on for the share `duty` of each period of pwm_hz, averaged over the"
        " exposure exactly; with a rolling shutter each row begins elsewhere in the period",
        present=lambda shot: isinstance(shot.view.lamps, PwmLamps),
        change=_flicker_change,
        cost=0.5,
        lacking=lambda _: Lacking.SCENE,
        lines=_flicker_lines,
    ),
)
