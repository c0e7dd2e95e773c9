"""Charge that comes without light: dark current, its non-uniformity, and hot pixels."""

from __future__ import annotations

import numpy as np

from camctl.sim.effects.record import LARGEST_NOISE, Change, Effect, Light, Shot, Stage, Tile
from camctl.sim.noise import PATTERN, Stream


def _grown_s(shot: Shot) -> float:
    """Return the exposure time at the reference temperature that gives as much dark signal."""
    return shot.sensor.dark.rate_factor * shot.time_s


def _dark_e(shot: Shot) -> float:
    """Return the mean dark signal of the exposure, electrons."""
    return shot.sensor.dark.current_e_s * _grown_s(shot)


def _dark(tile: Tile) -> None:
    np.add(tile.values, np.float32(_dark_e(tile.shot)), out=tile.values)


def _dark_change(shot: Shot) -> Change:
    signal = _dark_e(shot)
    return Change(mean_e=signal, least_e=signal)


def _dcnu(tile: Tile) -> None:
    dark = tile.shot.sensor.dark

    def draw() -> tuple[Light]:
        shot = tile.shot
        z = tile.noise.normal(tile.values.size, shot.seed, PATTERN, Stream.DCNU, tile.index)
        # No pixel has a negative dark current.
        return (np.maximum(z * np.float32(dark.dcnu_e_s), np.float32(-dark.current_e_s)),)

    rates = tile.cache.get((Stream.DCNU, tile.index), draw)[0]
    np.add(tile.values, rates * np.float32(_grown_s(tile.shot)), out=tile.values)
    # Rounding may leave less than nothing, or the mean dark current may have been left out.
    np.maximum(tile.values, np.float32(0), out=tile.values)


def _dcnu_change(shot: Shot) -> Change:
    most = LARGEST_NOISE * shot.sensor.dark.dcnu_e_s * _grown_s(shot)
    return Change(mean_e=most, least_e=-min(most, _dark_e(shot)))


def _hottest_e(shot: Shot) -> float:
    """Return the largest charge that a hot pixel collects in the exposure, electrons."""
    return shot.sensor.dark.hot_rate_e_s * _grown_s(shot)


def _hot(tile: Tile) -> None:
    dark = tile.shot.sensor.dark
    places, shares = tile.some_pixels(Stream.HOT, dark.hot_share)
    if dark.hot_decades > 0:
        shares = 10 ** (dark.hot_decades * (shares - 1))
    tile.values[places] += (shares * _hottest_e(tile.shot)).astype(np.float32)


DARK = (
    Effect(
        "dark current",
        Stage.MEAN,
        "electrons a second, doubling every doubling_k kelvin; its noise is part of photon noise",
        present=lambda shot: shot.sensor.dark.current_e_s > 0,
        change=_dark_change,
        cost=0.1,
        apply=_dark,
    ),
    Effect(
        "DCNU",
        Stage.MEAN,
        "EMVA 1288: dark current differs from pixel to pixel, normal, never below 0, electrons a"
        " second; grows with time and temperature as dark current does",
        present=lambda shot: shot.sensor.dark.dcnu_e_s > 0,
        change=_dcnu_change,
        cost=0.9,
        apply=_dcnu,
    ),
    Effect(
        "hot pixels",
        Stage.MEAN,
        "a share of the pixels has a dark rate of up to hot_rate_e_s, doubling likewise: spread"
        " evenly, or evenly in the logarithm over hot_decades, which is a long tail",
        present=lambda s: s.sensor.dark.hot_share > 0 and s.sensor.dark.hot_rate_e_s > 0,
        change=lambda shot: Change(mean_e=_hottest_e(shot)),
        cost=0.2,
        apply=_hot,
    ),
)
