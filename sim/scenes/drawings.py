"""All drawn pictures by name; their brightest diffuse part has irradiance 1."""

from __future__ import annotations

from collections.abc import Callable, MutableMapping

import numpy as np
from numpy.typing import NDArray

from sim.scenes.daylight import ball, cloth, ramp, room, tile_floor, uniform
from sim.scenes.night import night_street, stars

Light = NDArray[np.float32]

# The 24 patches of the Macbeth ColorChecker in 8-bit sRGB (X-Rite's values of 2005), row by row.
_PATCHES = """
115 82 68   194 150 130  98 122 157   87 108 67    133 128 177  103 189 170
214 126 44  80 91 166    193 90 99    94 60 108    157 188 64   224 163 46
56 61 150   70 148 73    175 54 60    231 199 31   187 86 149   8 133 161
243 243 242 200 200 200  160 160 160  122 122 121  85 85 85     52 52 52
"""
_GAP = 0.11  # of a patch's side
_FRAME = 0.03


def patches() -> Light:
    """Return (4, 6, 3) linear irradiance of the chart's patches; a perfect white is 1."""
    code = np.array(_PATCHES.split(), dtype=np.float64).reshape(4, 6, 3) / 255
    linear = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)
    return linear.astype(np.float32)


def colour_chart(rows: int, columns: int) -> Light:
    """Return a colour chart under even light, RGB; its black frame has irradiance 0.03."""
    y = (np.arange(rows) + 0.5) / rows * 4
    x = (np.arange(columns) + 0.5) / columns * 6
    inside_y = np.abs(y % 1 - 0.5) < 0.5 - _GAP / 2
    inside_x = np.abs(x % 1 - 0.5) < 0.5 - _GAP / 2
    picture = patches()[y.astype(int)[:, None], x.astype(int)[None, :]]
    inside = inside_y[:, None, None] & inside_x[None, :, None]
    return np.where(inside, picture, np.float32(_FRAME))


def wall(rows: int, columns: int) -> Light:
    """Return a wall of bricks in soft light from the left."""
    x = (np.arange(columns, dtype=np.float32) + 0.5) / columns
    y = (np.arange(rows, dtype=np.float32)[:, None] + 0.5) / rows
    course = np.floor(y * 16)
    along = x * 9 * columns / rows / 1.33 + 0.5 * (course % 2)
    brick = np.floor(along)
    edge = np.minimum(along - brick, brick + 1 - along) * 2
    edge = np.minimum(edge, np.minimum(y * 16 - course, course + 1 - y * 16))
    tone = np.sin(brick * 12.9898 + course * 78.233) * 43758.547
    tone = 0.26 + 0.10 * (tone - np.floor(tone))
    mortar = np.clip((edge - 0.05) / 0.06, 0, 1)
    picture = (0.5 + (tone - 0.5) * mortar) * (1.1 - 0.6 * x)
    return np.asarray(picture, dtype=np.float32)


def wheel(height: int) -> tuple[Light, Light]:
    """Return light and cover (both height x height) of a wheel of black and white sectors."""
    at = (np.arange(height, dtype=np.float32) + 0.5) / height * 2 - 1
    radius = np.hypot(at, at[:, None])
    angle = np.arctan2(at[:, None], at)
    cover = np.clip((1 - radius) * height / 4, 0, 1)
    sectors = np.clip(np.sin(12 * angle) * radius * height / 24 + 0.5, 0, 1)
    light = 0.04 + 0.86 * sectors
    light = np.where(radius > 0.86, 0.9, light)
    light = np.where(radius < 0.14, 0.02, light)
    return light.astype(np.float32), cover.astype(np.float32)


DRAWINGS: MutableMapping[str, Callable[[int, int], Light]] = {
    "ball": ball,
    "cloth": cloth,
    "colour-chart": colour_chart,
    "night-street": night_street,
    "ramp": ramp,
    "room": room,
    "stars": stars,
    "tile-floor": tile_floor,
    "uniform": uniform,
    "wall": wall,
}
