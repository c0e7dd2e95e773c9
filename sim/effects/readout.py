"""Effects of reading: noise, patterns, and the ADC."""

from __future__ import annotations

import numpy as np

from sim.effects.record import LARGEST, Change, Effect, Light, Shot, Stage, Tile
from sim.noise import PATTERN, Stream, line_noise


def _read(tile: Tile) -> None:
    shot = tile.shot
    sigma = shot.sensor.read_noise_e
    tile.noise.add_read_noise(tile.electrons, sigma, shot.seed, shot.number, tile.index)


def _dsnu(tile: Tile) -> None:
    shot = tile.shot
    z = tile.noise.normal(tile.electrons.size, shot.seed, PATTERN, Stream.DSNU, tile.index)
    np.multiply(z, np.float32(shot.sensor.pixels.dsnu_e), out=z)
    np.add(tile.electrons, z, out=tile.electrons)


def _row_lines(shot: Shot) -> tuple[Light, None]:
    z = line_noise(shot.seed, shot.number, Stream.ROW, shot.rows)
    return z * np.float32(shot.sensor.read_out.row_noise_e), None


def _row(tile: Tile) -> None:
    np.add(tile.electrons, tile.spread(tile.shot.lines["row noise"]), out=tile.electrons)


def _column_lines(shot: Shot) -> tuple[None, Light]:
    z = line_noise(shot.seed, PATTERN, Stream.COLUMN, shot.width)
    return None, z * np.float32(shot.sensor.read_out.column_noise_e)


def _column(tile: Tile) -> None:
    np.add(tile.electrons, tile.spread(tile.shot.lines["column noise"]), out=tile.electrons)


def bend_adc(dn: Light, shot: Shot) -> None:
    """Add the ADC's bow to brightness above black, in place: 4 A u (1 - u), u from 0 to 1."""
    sensor = shot.sensor
    top = np.float32(2**sensor.bits - sensor.black)
    u = np.clip(dn, np.float32(0), top)
    bow = u * (np.float32(1) - u / top)
    np.multiply(bow, np.float32(4 * sensor.read_out.nonlinearity_dn) / top, out=bow)
    np.add(dn, bow, out=dn)


READ_OUT = (
    Effect(
        "DSNU",
        Stage.READING,
        "EMVA 1288: offsets differ from pixel to pixel, normal, electrons",
        present=lambda shot: shot.sensor.pixels.dsnu_e > 0,
        change=lambda shot: Change(read_e=LARGEST * shot.sensor.pixels.dsnu_e),
        cost=1.7,
        apply=_dsnu,
    ),
    Effect(
        "read noise",
        Stage.READING,
        "EMVA 1288: temporal dark noise, normal, electrons",
        present=lambda shot: shot.sensor.read_noise_e > 0,
        change=lambda shot: Change(read_e=LARGEST * shot.sensor.read_noise_e),
        cost=1.6,
        apply=_read,
    ),
    Effect(
        "row noise",
        Stage.READING,
        "EMVA 1288 row-temporal noise: each row's offset, new in every frame, electrons",
        present=lambda shot: shot.sensor.read_out.row_noise_e > 0,
        change=lambda shot: Change(read_e=LARGEST * shot.sensor.read_out.row_noise_e),
        cost=0.3,
        apply=_row,
        lines=_row_lines,
    ),
    Effect(
        "column noise",
        Stage.READING,
        "EMVA 1288 column DSNU: each column amplifier's offset, always the same, electrons",
        present=lambda shot: shot.sensor.read_out.column_noise_e > 0,
        change=lambda shot: Change(read_e=LARGEST * shot.sensor.read_out.column_noise_e),
        cost=0.3,
        apply=_column,
        lines=_column_lines,
    ),
    Effect(
        "ADC non-linearity",
        Stage.ADC,
        "EMVA 1288 linearity error: a bow of nonlinearity_dn in the middle of the range, DN",
        present=lambda shot: shot.sensor.read_out.nonlinearity_dn > 0,
        change=lambda shot: Change(dn=shot.sensor.read_out.nonlinearity_dn),
        cost=0.8,
    ),
    Effect(
        "response curve",
        Stage.ADC,
        "the sensor's curve from irradiance to brightness",
        present=lambda shot: shot.sensor.curve != "linear",
        change=lambda _: Change(never="it decides what brightness means"),
        cost=0.0,
    ),
    Effect(
        "black level",
        Stage.ADC,
        "brightness without light, DN",
        present=lambda shot: shot.sensor.black > 0,
        change=lambda _: Change(never="it decides what brightness means"),
        cost=0.0,
    ),
    Effect(
        "quantisation",
        Stage.ADC,
        "floor after the ADC's phase, clipped to its range",
        present=lambda _: True,
        change=lambda _: Change(never="a frame is whole numbers"),
        cost=0.0,
    ),
)
