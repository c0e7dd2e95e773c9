"""Effects on charge: what the pixels make of light, and what comes without light."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.effects.record import LARGEST, Change, Effect, Light, Shot, Stage, Tile
from sim.noise import PATTERN, TILE, Stream

_NO_LIMIT = np.float32(-3e38)
_LONGEST_TRACK = 6
_LARGEST_HIT = 20.0  # times the mean charge


def _prnu(tile: Tile) -> None:
    shot = tile.shot
    z = tile.noise.normal(tile.electrons.size, shot.seed, PATTERN, Stream.PRNU, tile.index)
    np.multiply(z, np.float32(shot.sensor.pixels.prnu), out=z)
    np.add(z, np.float32(1), out=z)
    np.multiply(tile.electrons, z, out=tile.electrons)


def _prnu_change(shot: Shot) -> Change:
    most = shot.sensor.pixels.prnu * LARGEST
    return Change(less=most, more=most)


def _lag(tile: Tile) -> None:
    # The last frame was of the same scene: its charge is this one's, scaled by the exposure time.
    shot = tile.shot
    left = np.multiply(tile.electrons, np.float32(shot.lag_ratio))
    np.clip(left, _NO_LIMIT, np.float32(shot.sensor.full_well_e), out=left)
    np.multiply(left, np.float32(shot.sensor.pixels.lag), out=left)
    np.add(tile.electrons, left, out=tile.electrons)


def _lag_change(shot: Shot) -> Change:
    sensor = shot.sensor
    most = shot.statistics.most * shot.electrons_per_photon_s * shot.lag_ratio
    most *= 1 + LARGEST * sensor.pixels.prnu
    if shot.view.lamps is not None:
        most *= 1 + shot.view.lamps.left(shot.time_s)
    return Change(mean_e=sensor.pixels.lag * min(most, sensor.full_well_e))


def _smear_lines(shot: Shot) -> tuple[None, Light]:
    light = shot.view.light.reshape(shot.rows, shot.width)
    column = np.mean(light, axis=0, dtype=np.float64)
    per_photon = shot.sensor.quantum_efficiency * shot.sensor.pixels.smear_s
    return None, np.asarray(column * per_photon, dtype=np.float32)


def _smear(tile: Tile) -> None:
    np.add(tile.electrons, tile.spread(tile.shot.lines["smear"]), out=tile.electrons)


def _smear_change(shot: Shot) -> Change:
    per_photon = shot.sensor.quantum_efficiency * shot.sensor.pixels.smear_s
    return Change(mean_e=shot.statistics.most * per_photon)


def dark_e(shot: Shot) -> float:
    """Return the mean dark signal of the exposure, electrons."""
    dark = shot.sensor.dark
    return dark.current_e_s * dark.warmth * shot.time_s


def _dark(tile: Tile) -> None:
    np.add(tile.electrons, np.float32(dark_e(tile.shot)), out=tile.electrons)


def hottest_e(shot: Shot) -> float:
    """Return the most that a hot pixel collects in the exposure, electrons."""
    dark = shot.sensor.dark
    return dark.hot_rate_e_s * dark.warmth * shot.time_s


def _hot(tile: Tile) -> None:
    shot = tile.shot
    stem = np.random.SeedSequence(shot.seed, spawn_key=(PATTERN, int(Stream.HOT), tile.index))
    random = np.random.Generator(np.random.SFC64(stem))
    # Of a whole tile always, so that a tile is the same in a frame that ends in it.
    count = int(TILE * shot.sensor.dark.hot_share + random.random())
    places = (random.random(count) * TILE).astype(np.intp)
    charge = (random.random(count) * hottest_e(shot)).astype(np.float32)
    places, first = np.unique(places, return_index=True)
    inside = places < tile.electrons.size
    tile.electrons[places[inside]] += charge[first][inside]


def _photon_noise(tile: Tile) -> None:
    shot = tile.shot
    tile.noise.add_photon_noise(tile.electrons, shot.seed, shot.number, tile.index)


def draw_hits(shot: Shot) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Return the samples that cosmic rays hit in this frame, ascending, and their charge.

    Hits are a Poisson process over pixels and exposure time.  Each leaves its charge, exponential
    around the mean, evenly on a straight track of 1 to 6 pixels.
    """
    read_out = shot.sensor.read_out
    pixels = shot.view.light.size // shot.channels
    mean = read_out.cosmic_rate_s * pixels * 1e-6 * shot.time_s
    stem = np.random.SeedSequence(shot.seed, spawn_key=(shot.number, int(Stream.COSMIC), 0))
    random = np.random.Generator(np.random.SFC64(stem))
    gaps = -np.log(1 - random.random(int(mean + 12 * np.sqrt(mean) + 40)))
    count = int(np.count_nonzero(np.cumsum(gaps) < mean))
    places = np.zeros(0, dtype=np.int64)
    charges = np.zeros(0, dtype=np.float32)
    if count == 0:
        return places, charges
    row, column, turn, length, charge = random.random((5, count))
    lengths = 1 + (length * _LONGEST_TRACK).astype(np.int64)
    charge = np.minimum(-np.log(1 - charge), _LARGEST_HIT) * read_out.cosmic_e / lengths
    step = np.arange(_LONGEST_TRACK)
    angle = 2 * np.pi * turn[:, np.newaxis]
    rows = (row[:, np.newaxis] * shot.rows + step * np.sin(angle)).astype(np.int64)
    width = shot.width // shot.channels
    columns = (column[:, np.newaxis] * width + step * np.cos(angle)).astype(np.int64)
    on = (step < lengths[:, np.newaxis]) & (rows >= 0) & (rows < shot.rows)
    on &= (columns >= 0) & (columns < width)
    samples = (rows * width + columns) * shot.channels
    samples += np.arange(count)[:, np.newaxis] % shot.channels
    places, inverse = np.unique(samples[on], return_inverse=True)
    total = np.zeros(places.size)
    np.add.at(total, inverse, np.broadcast_to(charge[:, np.newaxis], on.shape)[on])
    return places, total.astype(np.float32)


def _cosmic(tile: Tile) -> None:
    places, charges = tile.shot.cosmic
    stop = tile.start + tile.electrons.size
    low, high = np.searchsorted(places, (tile.start, stop))
    tile.electrons[places[low:high] - tile.start] += charges[low:high]


def _cosmic_change(shot: Shot) -> Change:
    hits = shot.cosmic[0].size
    return Change(never=f"{hits} samples were hit") if hits else Change(is_nothing=True)


def _well(tile: Tile) -> None:
    # clip with a lower end that nothing reaches: numpy's minimum takes twice as long.
    full = np.float32(tile.shot.sensor.full_well_e)
    np.clip(tile.electrons, _NO_LIMIT, full, out=tile.electrons)


def bloom(electrons: Light, shot: Shot) -> None:
    """Let charge beyond the well flow along the columns, in place; (rows, columns[, 3]).

    Half of the share `blooming` goes up and half down, less and less with distance; what meets a
    full well or the border is drained.  The result is not clipped.
    """
    import cv2

    sensor = shot.sensor
    full, reach = np.float32(sensor.full_well_e), sensor.pixels.blooming_px
    weights = np.exp(-np.arange(1, reach + 1) / (reach / 3))
    half = sensor.pixels.blooming / 2 * weights / weights.sum()
    kernel = np.concatenate([half[::-1], [0.0], half]).astype(np.float32)
    beyond = np.maximum(electrons - full, 0)
    # An anti-blooming drain takes what is more than the wells around could hold.
    np.minimum(beyond, full * np.float32(64), out=beyond)
    flown = cv2.sepFilter2D(
        beyond, -1, np.ones(1, np.float32), kernel, borderType=cv2.BORDER_CONSTANT
    )
    np.minimum(electrons, full, out=electrons)
    np.add(electrons, flown.reshape(electrons.shape), out=electrons)


CHARGE = (
    Effect(
        "PRNU",
        Stage.MEAN,
        "EMVA 1288: sensitivity differs from pixel to pixel, normal, relative",
        present=lambda shot: shot.sensor.pixels.prnu > 0,
        change=_prnu_change,
        cost=1.6,
        apply=_prnu,
    ),
    Effect(
        "lag",
        Stage.MEAN,
        "a share of the last frame's charge, at most the well's, stays in the pixel",
        present=lambda shot: shot.sensor.pixels.lag > 0,
        change=_lag_change,
        cost=0.4,
        apply=_lag,
    ),
    Effect(
        "smear",
        Stage.MEAN,
        "while charge moves, each pixel sees its whole column's mean for smear_s seconds",
        present=lambda shot: shot.sensor.pixels.smear_s > 0,
        change=_smear_change,
        cost=0.6,
        apply=_smear,
        lines=_smear_lines,
    ),
    Effect(
        "dark current",
        Stage.MEAN,
        "electrons a second, doubling every doubling_k kelvin; its noise is part of photon noise",
        present=lambda shot: shot.sensor.dark.current_e_s > 0,
        change=lambda shot: Change(mean_e=dark_e(shot)),
        cost=0.1,
        apply=_dark,
    ),
    Effect(
        "hot pixels",
        Stage.MEAN,
        "a share of the pixels has a dark rate up to hot_rate_e_s, doubling likewise",
        present=lambda s: s.sensor.dark.hot_share > 0 and s.sensor.dark.hot_rate_e_s > 0,
        change=lambda shot: Change(mean_e=hottest_e(shot)),
        cost=0.2,
        apply=_hot,
    ),
    Effect(
        "photon noise",
        Stage.CHARGE,
        "Poisson, electrons; see `TileNoise.add_photon_noise`",
        present=lambda shot: shot.sensor.photon_noise,
        change=lambda _: Change(is_noise=True),
        cost=2.5,
        apply=_photon_noise,
    ),
    Effect(
        "cosmic rays",
        Stage.CHARGE,
        "hits on a million pixels a second, each a short track of exponential charge",
        present=lambda shot: shot.sensor.read_out.cosmic_rate_s > 0,
        change=_cosmic_change,
        cost=0.1,
        apply=_cosmic,
    ),
    Effect(
        "blooming",
        Stage.WELL,
        "charge beyond the well flows along the column, geometrically less with distance",
        present=lambda shot: shot.sensor.pixels.blooming > 0,
        change=lambda _: Change(only_below_well=True),
        cost=4.5,
    ),
    Effect(
        "full well",
        Stage.WELL,
        "EMVA 1288: saturation capacity, electrons; the charge is cut there",
        present=lambda _: True,
        change=lambda _: Change(only_below_well=True),
        cost=0.1,
        apply=_well,
    ),
)
