"""Effects on charge: what the pixels make of light, photon noise, and what limits charge."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from camctl.sim.compiled import Kernels
from camctl.sim.effects.record import (
    LARGEST_NOISE,
    Change,
    Effect,
    Light,
    Lines,
    RowTiming,
    Shot,
    Stage,
    Tile,
)
from camctl.sim.noise import Stream

Hits = tuple[NDArray[np.int64], NDArray[np.float32]]

_NO_LOWER_LIMIT = np.float32(-3e38)  # near the end of float32
_LONGEST_TRACK_PX = 6  # of a cosmic ray, see `cosmic_hits`
_LARGEST_HIT = 20.0  # times the mean charge: an exponential exceeds it once in 5e8 hits
_PLANNED_FRAMES = 8  # frames whose hits are kept from planning to rendering


def _prnu(tile: Tile) -> None:
    factors = tile.pattern(Stream.PRNU, tile.shot.sensor.pixels.prnu, 1.0)
    np.multiply(tile.values, factors, out=tile.values)


def _prnu_change(shot: Shot) -> Change:
    most = shot.sensor.pixels.prnu * LARGEST_NOISE
    return Change(less=most, more=most)


def _lag(tile: Tile) -> None:
    # The frame before was of the same scene: its charge is this one's, scaled by exposure time.
    shot, sensor = tile.shot, tile.shot.sensor
    ratio, full = np.float32(shot.lag_ratio), np.float32(sensor.full_well_e)
    lag = np.float32(sensor.pixels.lag)
    if tile.noise.kernels is not None:
        tile.noise.kernels.add_lag(tile.values, ratio, full, lag)
        return
    before = np.multiply(tile.values, ratio)
    np.clip(before, _NO_LOWER_LIMIT, full, out=before)
    np.multiply(before, lag, out=before)
    np.add(tile.values, before, out=tile.values)


def _lag_change(shot: Shot) -> Change:
    sensor = shot.sensor
    most = shot.statistics.most * shot.electrons_per_photon_s * shot.lag_ratio
    most *= 1 + LARGEST_NOISE * sensor.pixels.prnu
    if shot.view.lamps is not None:
        most *= 1 + shot.view.lamps.swing(shot.time_s)[1]
    lag = sensor.pixels.lag
    return Change(mean_e=lag * min(most, sensor.full_well_e), repeats=lag * shot.lag_ratio)


def _smear_lines(shot: Shot, _: RowTiming) -> Lines:
    column = shot.view.column_means
    per_photon = shot.sensor.quantum_efficiency * shot.sensor.pixels.smear_s
    return Lines(np.add, columns=np.asarray(column * per_photon, dtype=np.float32))


def _smear_change(shot: Shot) -> Change:
    per_photon = shot.sensor.quantum_efficiency * shot.sensor.pixels.smear_s
    return Change(mean_e=shot.statistics.most * per_photon)


def _photon_noise(tile: Tile) -> None:
    shot, noise = tile.shot, tile.noise
    draw = noise.count_photons if shot.counts_photons else noise.add_photon_noise
    draw(tile.values, shot.seed, shot.number, tile.index)


def cosmic_hits(shot: Shot) -> Hits:
    """Return the samples that cosmic rays hit in this frame, ascending, and their charge.

    Hits are a Poisson process over pixels and exposure time.  Each leaves its charge, exponential
    around the mean, evenly on a straight track of 1 to 6 pixels.  Not to be written to.
    """
    read_out = shot.sensor.read_out
    pixels = shot.view.light.size // shot.channels
    mean = read_out.cosmic_rate_s * pixels * 1e-6 * shot.time_s
    shape = (shot.rows, shot.width // shot.channels, shot.channels)
    return _draw_hits(shot.seed, shot.number, mean, read_out.cosmic_e, shape)


@lru_cache(maxsize=_PLANNED_FRAMES)
def _draw_hits(
    seed: int, number: int, mean: float, charge_e: float, shape: tuple[int, int, int]
) -> Hits:
    """Return `cosmic_hits` of a frame of `shape` (rows, columns, channels) with `mean` hits."""
    key = np.random.SeedSequence(seed, spawn_key=(number, int(Stream.COSMIC), 0))
    random = np.random.Generator(np.random.SFC64(key))
    gaps = -np.log(1 - random.random(int(mean + 12 * np.sqrt(mean) + 40)))
    count = int(np.count_nonzero(np.cumsum(gaps) < mean))
    if count == 0:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.float32)
    height, width, channels = shape
    row, column, turn, length, charge = random.random((5, count))
    lengths = 1 + (length * _LONGEST_TRACK_PX).astype(np.int64)
    charge = np.minimum(-np.log(1 - charge), _LARGEST_HIT) * charge_e / lengths
    step = np.arange(_LONGEST_TRACK_PX)
    angle = 2 * np.pi * turn[:, np.newaxis]
    rows = (row[:, np.newaxis] * height + step * np.sin(angle)).astype(np.int64)
    columns = (column[:, np.newaxis] * width + step * np.cos(angle)).astype(np.int64)
    inside = (step < lengths[:, np.newaxis]) & (rows >= 0) & (rows < height)
    inside &= (columns >= 0) & (columns < width)
    samples = (rows * width + columns) * channels
    samples += np.arange(count)[:, np.newaxis] % channels
    places, inverse = np.unique(samples[inside], return_inverse=True)
    total = np.zeros(places.size)
    np.add.at(total, inverse, np.broadcast_to(charge[:, np.newaxis], inside.shape)[inside])
    charges = total.astype(np.float32)
    places.flags.writeable = charges.flags.writeable = False
    return places, charges


def _cosmic(tile: Tile) -> None:
    places, charges = cosmic_hits(tile.shot)
    stop = tile.start + tile.values.size
    low, high = np.searchsorted(places, (tile.start, stop))
    tile.values[places[low:high] - tile.start] += charges[low:high]


def _hit_limit_e(shot: Shot) -> float:
    """Return a power of two above the largest hit of the frame, electrons; 0 without hits.

    Frames with hits of about the same size thus share a plan.
    """
    charges = cosmic_hits(shot)[1]
    return 2.0 ** math.ceil(math.log2(float(charges.max()))) if charges.size else 0.0


def _cosmic_change(shot: Shot) -> Change:
    limit = _hit_limit_e(shot)
    if limit == 0:
        return Change(nothing="none hits this frame")
    return Change(never="not left out: samples were hit in this frame", hit_e=limit)


def _bloom(picture: Light, shot: Shot, kernels: Kernels | None) -> None:
    """Let charge beyond the well flow along the columns, in place; (rows, width).

    Half of the share `blooming` flows down and half up, and fills each well that it passes; the
    rest is drained.  No charge is lost but beyond the border.  Only the columns that have a full
    well are touched, and only the rows that charge reaches.
    """
    full = float(np.float32(shot.sensor.full_well_e))
    share = shot.sensor.pixels.blooming / 2
    columns = np.flatnonzero(picture.max(axis=0) > full)
    if kernels is not None:
        kernels.bloom(picture, columns, full, share)
        return
    if columns.size == 0:
        return
    charge = picture.take(columns, axis=1).astype(np.float64)
    flowing = charge - full
    np.maximum(flowing, 0, out=flowing)
    flowing *= share
    np.minimum(charge, full, out=charge)
    sources = np.flatnonzero(flowing.max(axis=1))
    if sources.size == 0:  # the share was too small for any number
        return
    # More than all wells of a column cannot be taken up: without a limit, rounding would grow.
    most, span = full * len(charge), int(sources[-1] - sources[0])
    for rows in (slice(sources[0], None), slice(sources[-1], None, -1)):
        _fill_wells(charge[rows], flowing[rows], full, most, span)
    picture[:, columns] = charge


def _fill_wells(
    charge: NDArray[np.float64],
    flowing: NDArray[np.float64],
    full: float,
    most: float,
    span: int,
) -> None:
    """Let the charge `flowing` out of each pixel flow down and fill wells; in place.

    Both (rows, columns) electrons; only the first row and the `span` ones after it have sources.
    No more than `most` flows in a column.
    """
    carried, taken = np.zeros(charge.shape[1]), full - charge
    for row, (here, more) in enumerate(zip(taken, flowing, strict=True)):
        if row > span and not carried.any():
            taken = taken[:row]
            break
        carried += more
        np.minimum(carried, most, out=carried)
        np.minimum(carried, here, out=here)
        carried -= here
    charge[: len(taken)] += taken


def _blooming_change(shot: Shot) -> Change:
    # More charge anywhere is never less charge elsewhere, and none is created.  Such a map does not
    # enlarge the sum of the differences in a column (Crandall and Tartar 1980), which is at most
    # the largest one times the rows.
    return Change(only_below_well=True, spreads=shot.rows - 1.0)


def _well(tile: Tile) -> None:
    # numpy's clip with a lower limit that nothing reaches takes half the time of its minimum.
    full = np.float32(tile.shot.sensor.full_well_e)
    np.clip(tile.values, _NO_LOWER_LIMIT, full, out=tile.values)


PIXELS = (
    Effect(
        "PRNU",
        Stage.MEAN,
        "EMVA 1288: sensitivity differs from pixel to pixel, normal, relative",
        present=lambda shot: shot.sensor.pixels.prnu > 0,
        change=_prnu_change,
        cost=0.6,
        apply=_prnu,
    ),
    Effect(
        "lag",
        Stage.MEAN,
        "a share of the charge of the frame before, at most of a full well, stays in the pixel",
        present=lambda shot: shot.sensor.pixels.lag > 0,
        change=_lag_change,
        cost=0.9,
        apply=_lag,
    ),
    Effect(
        "smear",
        Stage.MEAN,
        "while charge moves, each pixel sees the mean of its column for smear_s seconds",
        present=lambda shot: shot.sensor.pixels.smear_s > 0,
        change=_smear_change,
        cost=0.4,
        lines=_smear_lines,
    ),
)

CHARGE = (
    Effect(
        "photon noise",
        Stage.CHARGE,
        "Poisson, electrons: whole numbers if read noise is below 2.5 e-, else continuous ones",
        present=lambda shot: shot.sensor.photon_noise,
        change=lambda _: Change(is_noise=True),
        cost=3.8,
        apply=_photon_noise,
    ),
    Effect(
        "cosmic rays",
        Stage.CHARGE,
        "hits on a million pixels a second, each a short track of exponential charge",
        present=lambda shot: shot.sensor.read_out.cosmic_rate_s > 0,
        change=_cosmic_change,
        cost=0.4,
        varies=_hit_limit_e,
        apply=_cosmic,
    ),
    Effect(
        "blooming",
        Stage.WELL,
        "a share of the charge beyond the well flows along the column and fills the wells it meets",
        present=lambda shot: shot.sensor.pixels.blooming > 0,
        change=_blooming_change,
        cost=3.8,
        flow=_bloom,
    ),
    Effect(
        "full well",
        Stage.WELL,
        "EMVA 1288: saturation capacity, electrons; the charge is clipped there",
        present=lambda _: True,
        change=lambda _: Change(only_below_well=True),
        cost=0.3,
        apply=_well,
    ),
)
