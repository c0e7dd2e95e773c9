"""Drawings of scenes at night: a street with lamps, and stars; see `camctl.sim.scenes.drawings`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from camctl.sim.scenes.charts import ALL

Light = NDArray[np.float32]

# Colours of light, R, G, B, the strongest 1; chosen by eye.
_SODIUM = np.array([1.0, 0.60, 0.20], dtype=np.float32)
_ROOMS = np.array([1.0, 0.78, 0.45], dtype=np.float32)
_SKY = np.array([0.35, 0.45, 0.8], dtype=np.float32)
# Lengths in one unit; irradiance in units of a wall close to a lamp.
_HALF_STREET, _EYE_HEIGHT, _ROOF_HEIGHT = 1.05, 0.42, 1.0
_LAMP_HEIGHT, _LAMP_RADIUS, _LAMP_LIGHT = 0.52, 0.017, 2500.0
_FARTHEST = 60.0
_LAMP_PLACES = [(side * 0.74, z) for z in (1.35, 2.1, 3.3, 5.2, 8.2) for side in (-1, 1)]


def night_street(rows: int, columns: int, part: slice = ALL) -> Light:
    """Return a wet street at night, RGB: a wall close to a lamp has 1, the lamps have 2,500."""
    aspect = columns / rows
    across = ((np.arange(columns) + 0.5) / columns - 0.5) * aspect
    down = (np.arange(rows)[part, None] + 0.5) / rows - 0.52
    x, y = (a.astype(np.float32) for a in np.broadcast_arrays(across, down))
    # The line of sight ends on the ground, on a wall beside the street, or in the sky.
    with np.errstate(divide="ignore"):
        to_wall = _HALF_STREET / np.abs(x)
        to_ground = np.where(y > 0, _EYE_HEIGHT / y, np.inf)
    z = np.minimum(np.minimum(to_wall, to_ground), _FARTHEST).astype(np.float32)
    is_ground = to_ground < to_wall
    at_x, at_y = x * z, y * z
    is_sky = ~is_ground & (
        at_y < -_ROOF_HEIGHT - 0.25 * np.sin(np.floor(z * 0.9) * 5.7 + np.sign(x))
    )
    is_sky |= z >= _FARTHEST
    lit = np.zeros(z.shape, dtype=np.float32)
    for lamp_x, lamp_z in _LAMP_PLACES:
        off = (at_x - lamp_x) ** 2 + (at_y + _LAMP_HEIGHT) ** 2 + (z - lamp_z) ** 2
        lit += 0.10 / (off + 0.06)
    paving = 0.10 + 0.03 * np.sin(at_x * 40) * np.sin(z * 30)
    plaster = 0.28 + 0.05 * np.sin(np.floor(z * 0.9) * 3.1 + np.sign(x))
    matte = np.where(is_ground, paving, plaster).astype(np.float32) * lit + np.float32(4e-4)
    picture = matte[..., None] * _SODIUM
    picture += _windows(at_y, z, np.sign(x), ~is_ground & ~is_sky)[..., None] * _ROOMS
    picture[is_sky] = (0.0012 * (1 + y[is_sky]))[..., None] * _SKY
    for lamp_x, lamp_z in reversed(_LAMP_PLACES):
        _draw_lamp(picture, x, y, lamp_x, lamp_z, rows)
    return np.asarray(picture, dtype=np.float32)


def _windows(at_y: Light, z: Light, side: Light, is_wall: NDArray[np.bool_]) -> Light:
    """Return the light of the windows of the houses, some of which are lit."""
    storey, along = (at_y + 2) * 4, z * 3.2
    in_window = (np.abs(storey % 1 - 0.5) < 0.3) & (np.abs(along % 1 - 0.5) < 0.26)
    chance = np.sin(np.floor(storey) * 7.13 + np.floor(along) * 12.9 + side * 3.7) * 43758.5
    chance = chance - np.floor(chance)
    glow = np.where(chance > 0.62, 0.35 + chance, 0.004)
    seen = in_window & is_wall & (at_y < 0.15) & (at_y > -_ROOF_HEIGHT + 0.1)
    return np.asarray(np.where(seen, glow, 0), dtype=np.float32)


def _draw_lamp(picture: Light, x: Light, y: Light, lamp_x: float, z: float, rows: int) -> None:
    """Draw one lamp, its pole, and its long reflection on the wet ground."""
    sx, sy, radius = lamp_x / z, -_LAMP_HEIGHT / z, max(_LAMP_RADIUS / z, 0.8 / rows)
    foot = _EYE_HEIGHT / z
    pole = (np.abs(x - sx) < max(0.007 / z, 0.5 / rows)) & (y > sy) & (y < foot)
    picture[pole] = picture[pole] * 0.25
    streak = np.exp(-(((x - sx) / (1.6 * radius)) ** 2)) * np.exp(-(((y - foot - 0.1) / 0.16) ** 2))
    streak = streak * (y > foot) * (1 + 0.6 * np.sin(y * 160 + lamp_x * 9)) * 0.5
    picture += streak[..., None] * _SODIUM
    bulb = np.clip((radius - np.hypot(x - sx, y - sy)) * rows + 0.5, 0, 1)
    picture += bulb[..., None] * (np.float32(_LAMP_LIGHT) * _SODIUM)


def stars(rows: int, columns: int, part: slice = ALL) -> Light:
    """Return a starry sky: the dark sky has 0.2, each star is a point of up to 20,000."""
    random = np.random.Generator(np.random.PCG64(7))
    aspect = columns / rows
    x = (np.arange(columns, dtype=np.float32) + 0.5) / columns * np.float32(aspect)
    y = (np.arange(rows, dtype=np.float32)[part, None] + 0.5) / rows
    band = (x * 0.45 + y - 0.75) / 0.16
    lane = (x * 0.45 + y - 0.73 + 0.03 * np.sin(x * 9)) / 0.035
    clouds = 1 + 0.25 * np.sin(x * 13 + 4 * y) * np.sin(y * 17 - 5 * x)
    milky_way = 0.55 * np.exp(-(band**2)) * clouds * (1 - 0.55 * np.exp(-(lane**2)))
    sky = np.asarray(0.2 + milky_way, dtype=np.float32)
    count = 700
    # Stars of a tenth of the light are about four times as many; a third lie in the milky way.
    flux = 3.0 * (1 - random.random(count)) ** -1.6
    at_x, at_y = random.random(count), random.random(count)
    in_band = random.random(count) < 0.35
    spread = random.normal(0, 0.09, count)
    at_y = np.where(in_band, (0.75 + spread - at_x * 4 / 3 * 0.45) % 1, at_y)
    per_pixel = np.minimum(flux, 20_000) * (rows * columns / (480 * 640))
    row, column = at_y * rows - 0.5, at_x * columns - 0.5
    top, left = np.floor(row).astype(int), np.floor(column).astype(int)
    down, right = row - top, column - left
    first, last, _ = part.indices(rows)
    for i, j, share in (
        (0, 0, (1 - down) * (1 - right)),
        (0, 1, (1 - down) * right),
        (1, 0, down * (1 - right)),
        (1, 1, down * right),
    ):
        r, c = np.clip(top + i, 0, rows - 1), np.clip(left + j, 0, columns - 1)
        here = (r >= first) & (r < last)
        light = (share * per_pixel).astype(np.float32)
        np.add.at(sky, (r[here] - first, c[here]), light[here])
    return np.asarray(sky, dtype=np.float32)
