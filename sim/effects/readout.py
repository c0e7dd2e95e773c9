"""Effects of reading: noise, fixed patterns, and the ADC."""

from __future__ import annotations

import numpy as np

from camctl.sim.effects.record import (
    LARGEST_NOISE,
    Change,
    Effect,
    Lacking,
    Lines,
    RowTiming,
    Shot,
    Stage,
    Tile,
)
from camctl.sim.noise import PATTERN, Stream, line_noise

_SETS_BRIGHTNESS = "never left out: it determines brightness"


def _dsnu(tile: Tile) -> None:
    offsets = tile.pattern(Stream.DSNU, tile.shot.sensor.pixels.dsnu_e, 0.0)
    np.add(tile.values, offsets, out=tile.values)


def _read_noise(tile: Tile) -> None:
    shot = tile.shot
    sigma_e = shot.sensor.read_noise_e
    tile.noise.add_read_noise(tile.values, sigma_e, shot.seed, shot.number, tile.index)


def _adc_noise_e(shot: Shot) -> float:
    """Return the noise behind the amplifier, in electrons in front of it."""
    return shot.sensor.read_out.adc_noise_e / shot.gain


def _adc_noise(tile: Tile) -> None:
    shot = tile.shot
    sigma_e = _adc_noise_e(shot)
    tile.noise.add_read_noise(tile.values, sigma_e, shot.seed, shot.number, tile.index, Stream.ADC)


def _row_noise_lines(shot: Shot, _: RowTiming) -> Lines:
    read_out = shot.sensor.read_out
    z = line_noise(shot.seed, shot.number, Stream.ROW, shot.rows, read_out.pink_share)
    return Lines(np.add, rows=z * np.float32(read_out.row_noise_e))


def _column_noise_lines(shot: Shot, _: RowTiming) -> Lines:
    read_out = shot.sensor.read_out
    z = line_noise(shot.seed, PATTERN, Stream.COLUMN, shot.width, read_out.pink_share)
    return Lines(np.add, columns=z * np.float32(read_out.column_noise_e))


def _rts(tile: Tile) -> None:
    shot = tile.shot
    places, sizes = tile.some_pixels(Stream.RTS, shot.sensor.read_out.rts_share)
    key = (shot.number, int(Stream.RTS_STATE), tile.index)
    random = np.random.Generator(np.random.SFC64(np.random.SeedSequence(shot.seed, spawn_key=key)))
    # Full or empty before and after, each with probability 1/2: -1, 0, 0, or 1.
    before, after = random.random((2, places.size)) < 0.5
    step = after.astype(np.float64) - before
    tile.values[places] += (step * sizes * shot.sensor.read_out.rts_e).astype(np.float32)


def _reset_e(shot: Shot) -> float:
    """Return the electrons in the reset level for one photon a second."""
    return shot.sensor.quantum_efficiency * shot.sensor.read_out.reset_s


def _black_sun(tile: Tile) -> None:
    reset = tile.light * np.float32(_reset_e(tile.shot))
    np.minimum(reset, np.float32(tile.shot.sensor.full_well_e), out=reset)
    np.subtract(tile.values, reset, out=tile.values)


def _black_sun_change(shot: Shot) -> Change:
    most = min(_reset_e(shot) * shot.statistics.most, shot.sensor.full_well_e) * (1 + 1e-5)
    return Change(read_e=most, resets=shot.sensor.read_out.reset_s / shot.time_s)


def _bow_adc(tile: Tile) -> None:
    """Add the ADC's error 4 A u (1 - u), u brightness above black from 0 to 1."""
    sensor, dn = tile.shot.sensor, tile.values
    top = np.float32(2**sensor.bits - sensor.black)
    factor = np.float32(4 * sensor.read_out.nonlinearity_dn) / top
    if tile.noise.kernels is not None:
        tile.noise.kernels.add_bow(dn, top, factor)
        return
    u = np.clip(dn, np.float32(0), top)
    bow = u * (np.float32(1) - u / top)
    np.multiply(bow, factor, out=bow)
    np.add(dn, bow, out=dn)


def _bow_change(shot: Shot) -> Change:
    sensor, bow_dn = shot.sensor, shot.sensor.read_out.nonlinearity_dn
    return Change(dn=bow_dn, slope=4 * bow_dn / (2**sensor.bits - sensor.black))


READ_OUT = (
    Effect(
        "black sun",
        Stage.READING,
        "correlated double sampling: the reset level is taken reset_s after the reset and holds the"
        " charge of that time, at most a full well, which is subtracted",
        present=lambda shot: shot.sensor.read_out.reset_s > 0,
        change=_black_sun_change,
        cost=0.9,
        apply=_black_sun,
    ),
    Effect(
        "DSNU",
        Stage.READING,
        "EMVA 1288: offsets differ from pixel to pixel, normal, electrons",
        present=lambda shot: shot.sensor.pixels.dsnu_e > 0,
        change=lambda shot: Change(read_e=LARGEST_NOISE * shot.sensor.pixels.dsnu_e),
        cost=0.7,
        apply=_dsnu,
    ),
    Effect(
        "read noise",
        Stage.READING,
        "EMVA 1288: temporal dark noise, normal, electrons",
        present=lambda shot: shot.sensor.read_noise_e > 0,
        change=lambda shot: Change(read_e=LARGEST_NOISE * shot.sensor.read_noise_e),
        cost=2.4,
        apply=_read_noise,
    ),
    Effect(
        "ADC noise",
        Stage.READING,
        "noise behind the amplifier, normal: adc_noise_e / gain electrons, so that read noise falls"
        " with gain as sqrt(a^2 + (b / gain)^2)",
        present=lambda shot: shot.sensor.read_out.adc_noise_e > 0,
        change=lambda shot: Change(read_e=LARGEST_NOISE * _adc_noise_e(shot)),
        cost=2.7,
        apply=_adc_noise,
    ),
    Effect(
        "RTS pixels",
        Stage.READING,
        "random telegraph signal: in a share of the pixels a trap is full or empty at each of the"
        " two samples of a reading, which adds -A, 0, 0 or A electrons, A from 0 to rts_e",
        present=lambda s: s.sensor.read_out.rts_share > 0 and s.sensor.read_out.rts_e > 0,
        change=lambda shot: Change(read_e=shot.sensor.read_out.rts_e),
        cost=0.8,
        apply=_rts,
    ),
    Effect(
        "row noise",
        Stage.READING,
        "EMVA 1288 row-temporal noise: an offset of each row, new in every frame, electrons; the"
        " share pink_share of its variance is 1/f",
        present=lambda shot: shot.sensor.read_out.row_noise_e > 0,
        change=lambda shot: Change(read_e=LARGEST_NOISE * shot.sensor.read_out.row_noise_e),
        cost=0.7,
        lines=_row_noise_lines,
    ),
    Effect(
        "column noise",
        Stage.READING,
        "EMVA 1288 column DSNU: an offset of each column amplifier, always the same, electrons; the"
        " share pink_share of its variance is 1/f",
        present=lambda shot: shot.sensor.read_out.column_noise_e > 0,
        change=lambda shot: Change(read_e=LARGEST_NOISE * shot.sensor.read_out.column_noise_e),
        cost=0.4,
        lines=_column_noise_lines,
    ),
    Effect(
        "ADC non-linearity",
        Stage.ADC,
        "EMVA 1288 linearity error: a bow of nonlinearity_dn in the middle of the range, DN",
        present=lambda shot: shot.sensor.read_out.nonlinearity_dn > 0,
        change=_bow_change,
        cost=1.8,
        apply=_bow_adc,
    ),
    Effect(
        "response curve",
        Stage.ADC,
        "the sensor's curve from irradiance to brightness",
        present=lambda shot: shot.sensor.curve != "linear",
        change=lambda _: Change(never=_SETS_BRIGHTNESS),
        cost=0.0,
        lacking=lambda _: Lacking.KIND,
    ),
    Effect(
        "black level",
        Stage.ADC,
        "brightness without light, DN",
        present=lambda shot: shot.sensor.black > 0,
        change=lambda _: Change(never=_SETS_BRIGHTNESS),
        cost=0.0,
        lacking=lambda _: Lacking.KIND,
    ),
    Effect(
        "quantisation",
        Stage.ADC,
        "floor after adding the ADC's phase, clipped to its range",
        present=lambda _: True,
        change=lambda _: Change(never="never left out: pixel values are whole numbers"),
        cost=0.0,
    ),
)
