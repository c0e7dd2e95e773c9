"""Drawings of the built-in scenes, at any size; their brightest diffuse part has irradiance 1.

Each returns some rows, `part`, of a picture of (rows, columns): irradiance, (rows, columns) or, in
colour, (rows, columns, 3).  The numbers in a drawing have no meaning beyond how it looks.
"""

from __future__ import annotations

from collections.abc import Callable, MutableMapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from camctl.model.response.camera import srgb_to_linear
from camctl.sim.scenes.charts import ALL, grey_steps, outdoor_sun, slanted_edge
from camctl.sim.scenes.night import night_street, stars

Light = NDArray[np.float32]

# The 24 patches of the Macbeth ColorChecker in 8-bit sRGB (X-Rite's values of 2005), row by row.
_PATCHES = """
115 82 68   194 150 130  98 122 157   87 108 67    133 128 177  103 189 170
214 126 44  80 91 166    193 90 99    94 60 108    157 188 64   224 163 46
56 61 150   70 148 73    175 54 60    231 199 31   187 86 149   8 133 161
243 243 242 200 200 200  160 160 160  122 122 121  85 85 85     52 52 52
"""
_PATCH_GAP = 0.11  # share of a patch's side
_CHART_FRAME = 0.03  # irradiance


def _grid(rows: int, columns: int, part: slice) -> tuple[Light, Light]:
    """Return x (columns,) and y (rows of `part`, 1) of the pixels' centres, 0 to 1."""
    x = (np.arange(columns, dtype=np.float32) + 0.5) / columns
    y = (np.arange(rows, dtype=np.float32)[part, np.newaxis] + 0.5) / rows
    return x.astype(np.float32), y.astype(np.float32)


def _waves(u: Light, v: Light, seed: int, count: int, low: float, high: float) -> Light:
    """Return smooth noise of about unit variance: `count` plane waves of random direction.

    Their wave numbers are from `low` to `high`, evenly in the logarithm.
    """
    random = np.random.Generator(np.random.PCG64(seed))
    total = np.zeros(np.broadcast_shapes(u.shape, v.shape), dtype=np.float32)
    for _ in range(count):
        angle, phase = random.uniform(0, 2 * np.pi, 2)
        length = low * (high / low) ** random.uniform()
        a, b = np.float32(np.cos(angle) * length), np.float32(np.sin(angle) * length)
        total += np.sin(a * u + b * v + np.float32(phase))
    total *= np.float32(np.sqrt(2 / count))
    return total


def uniform(rows: int, columns: int, part: slice = ALL) -> Light:
    """Return the same light everywhere, like an integrating sphere."""
    return np.ones((len(range(rows)[part]), columns), dtype=np.float32)


def ramp(rows: int, columns: int, part: slice = ALL) -> Light:
    """Return light that grows linearly from 0 at the left to 1 at the right (paper, figure 6)."""
    x, y = _grid(rows, columns, part)
    return np.asarray(x + 0 * y)


def cloth(rows: int, columns: int, part: slice = ALL) -> Light:
    """Return a white cloth in soft folds under light from the upper left (paper, figure 7)."""
    aspect = np.float32(columns / rows)
    # One more pixel on each side, for the slopes.
    first, last, _ = part.indices(rows)
    x, y = _grid(rows + 2, columns + 2, slice(first, last + 2))
    u = (x * np.float32(columns + 2) - 1) / np.float32(columns) * aspect
    v = (y * np.float32(rows + 2) - 1) / np.float32(rows)
    # Nearly vertical folds, slightly bent, deeper towards the bottom.
    sway = np.float32(0.12) * _waves(u, v, 3, 5, 1.5, 5.0)
    along = u + np.float32(0.18) * v + sway
    height = np.float32(0.045) * np.sin(along * 15) + np.float32(0.02) * np.sin(
        along * 33 + 1.3 * v
    )
    height = height * (np.float32(0.45) + v) + np.float32(0.006) * _waves(u, v, 8, 8, 8.0, 25.0)
    slope_u = (height[1:-1, 2:] - height[1:-1, :-2]) * (columns / (2 * float(aspect)))
    slope_v = (height[2:, 1:-1] - height[:-2, 1:-1]) * (rows / 2)
    height, u, v = height[1:-1, 1:-1], u[1:-1], v[1:-1]
    light = np.array([-0.62, -0.45, 0.64])
    shade = (light[2] - light[0] * slope_u - light[1] * slope_v) / np.sqrt(
        1 + slope_u**2 + slope_v**2
    )
    # Ambient light decreases with depth, since valleys see less of the room.
    ambient = 0.10 + 0.5 * np.clip(height + 0.1, 0, 0.2)
    weave = 1 + 0.012 * np.sin(u * 900) * np.sin(v * 900)
    drop = np.exp(-1.1 * ((u - 0.25) ** 2 + (v - 0.15) ** 2))
    picture = (np.maximum(shade, 0) * drop + ambient) * weave
    return np.asarray(picture, dtype=np.float32)


def tile_floor(rows: int, columns: int, part: slice = ALL) -> Light:
    """Return a tile floor with a strong gradient of light (paper, figure 9).

    The light decreases by 1:3,000 from the near left corner to the far right one.
    """
    x, y = _grid(rows, columns, part)
    aspect = np.float32(columns / rows)
    # Seen from a height of one unit, with the horizon just above the picture.
    depth = np.float32(1.55) / (y + np.float32(0.28))
    across = (x - np.float32(0.46)) * aspect * depth
    turn = np.float32(0.35)
    u = (across * np.cos(turn) - depth * np.sin(turn)) * np.float32(2.6) + 40
    v = (across * np.sin(turn) + depth * np.cos(turn)) * np.float32(2.6) + 40
    iu, iv = np.floor(u), np.floor(v)
    fu, fv = u - iu, v - iv
    edge = np.minimum(np.minimum(fu, 1 - fu), np.minimum(fv, 1 - fv))
    # The grout is 3 % of a tile wide; its edge is blurred over the size of a pixel there.
    blur = np.float32(2.6) * depth / (np.float32(1.0) * rows) + np.float32(0.004)
    tile = np.clip((edge - np.float32(0.03)) / blur + np.float32(0.5), 0, 1)
    tone = np.sin(iu * np.float32(12.9898) + iv * np.float32(78.233)) * np.float32(43758.547)
    tone = tone - np.floor(tone)
    marble = _waves(u, v, 11, 14, 2.0, 22.0)
    albedo = np.float32(0.62) + np.float32(0.16) * tone + np.float32(0.035) * marble
    bevel = 1 - np.float32(0.10) * np.exp(-edge * np.float32(22))
    albedo = np.where((iu + iv) % 2 == 0, albedo, albedo * np.float32(0.72)) * bevel
    reflect = np.float32(0.16) + (albedo - np.float32(0.16)) * tile
    away = np.hypot((x - np.float32(0.02)) * aspect, np.float32(1.02) - y)
    away = away / np.hypot(aspect, np.float32(1.02))
    fall = np.exp(-np.float32(np.log(3000.0)) * away)
    return np.asarray(reflect * fall, dtype=np.float32)


def ball(rows: int, columns: int, part: slice = ALL) -> Light:
    """Return a matte ball with a highlight on a dark table, RGB (paper, figures 1 and 10)."""
    x, y = _grid(rows, columns, part)
    aspect = np.float32(columns / rows)
    u, v = (x - np.float32(0.5)) * aspect, y - np.float32(0.47)
    radius = np.float32(0.33)
    r2 = (u**2 + v**2) / radius**2
    cover = np.clip((1 - np.sqrt(r2)) * radius * rows + np.float32(0.5), 0, 1)
    nz = np.sqrt(np.clip(1 - r2, 0, 1))
    nx, ny = u / radius, v / radius
    light = np.array([-0.52, -0.62, 0.588], dtype=np.float32)
    lambert = np.maximum(nx * light[0] + ny * light[1] + nz * light[2], 0)
    half = light + np.array([0, 0, 1], dtype=np.float32)
    half /= np.linalg.norm(half)
    # Beside the ball there is no normal, and the product may be above 1.
    highlight = np.clip(nx * half[0] + ny * half[1] + nz * half[2], 0, 1) ** 350
    # Light that the table reflects to the ball.
    bounce = np.float32(0.02) * np.clip(ny + np.float32(0.4), 0, None) + np.float32(0.004)
    speckle = 1 + np.float32(0.03) * _waves(nx * 6, ny * 6, 21, 12, 2.0, 14.0)
    # The table, with a soft spot of light and the shadow of the ball.
    on_table = np.float32(0.62) + np.float32(0.06)
    far = np.clip((v + np.float32(0.22)) * np.float32(1.4), 0, 1)
    pool = np.exp(-np.float32(1.6) * ((u + 0.25) ** 2 + (v - 0.1) ** 2))
    shadow_u, shadow_v = u - np.float32(0.20), (v - np.float32(0.30)) * np.float32(2.6)
    shadow = 1 - np.float32(0.93) * np.exp(-(((shadow_u**2 + shadow_v**2) / np.float32(0.09)) ** 2))
    grain = 1 + np.float32(0.08) * _waves(u * 2, v * 34, 5, 10, 1.0, 9.0)
    table = (np.float32(0.004) + on_table * np.float32(0.16) * far * pool * shadow) * grain
    picture = np.empty((*y.shape[:1], columns, 3), dtype=np.float32)
    colours = ((0.80, 0.46, 1.0), (0.36, 0.40, 1.0), (0.20, 0.34, 0.95))
    for channel, (matte, wood, lamp) in enumerate(colours):
        shaded = (lambert * np.float32(matte * 0.85) + bounce * np.float32(matte)) * speckle
        shaded = shaded + np.float32(12 * lamp) * highlight
        floor = table * np.float32(wood)
        picture[..., channel] = (floor + (shaded - floor) * cover) * np.float32(lamp)
    return picture


def room(rows: int, columns: int, part: slice = ALL) -> Light:
    """Return a dim room with a bright window, RGB; its dynamic range is above 1:20,000."""
    x, y = _grid(rows, columns, part)
    aspect = np.float32(columns / rows)
    u, v = x * aspect, y + 0 * x
    u = u + 0 * y
    # A box seen from its middle: the back wall, and four walls towards the vanishing point.
    cu, cv = np.float32(0.56) * aspect, np.float32(0.46)
    left, right, top, bottom = 0.30 * aspect, 0.86 * aspect, 0.20, 0.70
    scale = np.maximum.reduce(
        [
            (u - cu) / (right - cu),
            (cu - u) / (cu - left),
            (v - cv) / (bottom - cv),
            (cv - v) / (cv - top),
        ]
    )
    depth = 1 / np.maximum(scale, 1).astype(np.float32)  # 1 at the back wall, less in front
    is_floor = (v - cv) / (bottom - cv) >= scale - 1e-6
    is_ceiling = (cv - v) / (cv - top) >= scale - 1e-6
    is_back = scale < 1
    # A window in the back wall lights the room, and makes a patch of sunlight on the floor.
    wl, wr, wt, wb = 0.44 * aspect, 0.66 * aspect, 0.27, 0.54
    wu, wv = (wl + wr) / 2, (wt + wb) / 2
    near = (u - wu) ** 2 + (v - wv) ** 2
    glow = np.float32(3.6e-3) * depth**3 / (1 + 9 * near) + np.float32(9e-5)
    patch_u = cu + (u - cu) * depth
    plank = np.abs(np.modf(patch_u / aspect * 34)[0])
    lane = np.clip(1 - np.abs((patch_u - wu - 0.05 * (1 - depth)) / (0.115 * aspect)), 0, 1)
    sun = (
        np.clip(lane * 12, 0, 1)
        * np.clip((depth - 0.62) * 30, 0, 1)
        * np.clip((0.86 - depth) * 30, 0, 1)
    )
    floor = np.float32(0.55) + 0.2 * np.sin(np.floor(patch_u / aspect * 34) * 5.3)
    floor = floor * np.where(plank > 0.05, np.float32(1), np.float32(0.2))
    picture = np.empty((*y.shape[:1], columns, 3), dtype=np.float32)
    hues = ((0.86, 0.52, 1.0), (0.80, 0.33, 0.98), (0.68, 0.20, 1.05))
    for channel, (wall, wood, sky) in enumerate(hues):
        surface = np.where(is_floor, floor * wood, np.where(is_ceiling, wall * 0.9, wall * 0.6))
        surface = np.where(is_back, wall * 0.35, surface)
        light = surface * (glow + np.where(is_floor & ~is_back, 0.02 * sun, 0))
        picture[..., channel] = light
        _draw_furniture(picture[..., channel], u, v, aspect, glow, channel)
        outside = _landscape(u / aspect, v, channel) * np.float32(sky)
        bars = (np.abs(u - wu) < 0.006 * aspect) | (np.abs(v - wv) < 0.007)
        inside = (u > wl) & (u < wr) & (v > wt) & (v < wb)
        frame = (u > wl - 0.014) & (u < wr + 0.014) & (v > wt - 0.014) & (v < wb + 0.014)
        view = picture[..., channel]
        view[frame] = 3.0e-4 * wall
        view[inside & ~bars] = outside[inside & ~bars]
    return picture


def _draw_furniture(
    view: Light, u: Light, v: Light, aspect: np.float32, glow: Light, channel: int
) -> None:
    """Draw a picture on the side wall and a chest in the dark corner into one channel."""
    chest = (u > 0.03 * aspect) & (u < 0.25 * aspect) & (v > 0.66 + 0.25 * (0.16 - u / aspect))
    chest &= v < 0.93 + 0.3 * (0.14 - u / aspect)
    drawer = np.abs(np.modf((v + 0.25 * u / aspect) * 12)[0]) < 0.06
    tone = (0.28, 0.15, 0.08)[channel]
    view[chest] = (glow * np.where(drawer, 0.2, 1.0) * tone)[chest]
    hung = (u > 0.91 * aspect) & (u < 0.98 * aspect) & (v > 0.30) & (v < 0.52)
    motif = 0.3 + 0.25 * np.sin(u / aspect * 120 + channel) * np.sin(v * 55)
    view[hung] = (glow * motif)[hung]


def _landscape(x: Light, v: Light, channel: int) -> Light:
    """Return one channel of the view through the window: sky, hills and a sunlit lawn."""
    sky = (0.62, 0.78, 1.0)[channel] * (0.75 + 0.5 * (0.45 - v))
    hills = (0.16, 0.26, 0.15)[channel]
    lawn = (0.30, 0.46, 0.12)[channel]
    ridge = 0.425 + 0.018 * np.sin(x * 40) + 0.010 * np.sin(x * 97 + 1)
    sunlit = np.where(v < ridge, sky, np.where(v < 0.475, hills, lawn))
    return np.asarray(sunlit, dtype=np.float32)


def _patches() -> Light:
    """Return (4, 6, 3) linear irradiance of the chart's patches; perfect white is 1."""
    code = np.array(_PATCHES.split(), dtype=np.float64).reshape(4, 6, 3) / 255
    return srgb_to_linear(code).astype(np.float32)


def colour_chart(rows: int, columns: int, part: slice = ALL) -> Light:
    """Return a colour chart in a black frame under even light, RGB."""
    y = (np.arange(rows)[part] + 0.5) / rows * 4
    x = (np.arange(columns) + 0.5) / columns * 6
    inside_y = np.abs(y % 1 - 0.5) < 0.5 - _PATCH_GAP / 2
    inside_x = np.abs(x % 1 - 0.5) < 0.5 - _PATCH_GAP / 2
    picture = _patches()[y.astype(int)[:, None], x.astype(int)[None, :]]
    inside = inside_y[:, None, None] & inside_x[None, :, None]
    return np.where(inside, picture, np.float32(_CHART_FRAME))


def wall(rows: int, columns: int, part: slice = ALL) -> Light:
    """Return a brick wall in soft light from the left."""
    x = (np.arange(columns, dtype=np.float32) + 0.5) / columns
    y = (np.arange(rows, dtype=np.float32)[part, None] + 0.5) / rows
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
    """Return a wheel of black and white sectors for `camctl.sim.scenes.motion.Target`.

    Its light and its cover, both (height, height).
    """
    at = (np.arange(height, dtype=np.float32) + 0.5) / height * 2 - 1
    radius = np.hypot(at, at[:, None])
    angle = np.arctan2(at[:, None], at)
    cover = np.clip((1 - radius) * height / 4, 0, 1)
    sectors = np.clip(np.sin(12 * angle) * radius * height / 24 + 0.5, 0, 1)
    light = 0.04 + 0.86 * sectors
    light = np.where(radius > 0.86, 0.9, light)
    light = np.where(radius < 0.14, 0.02, light)
    return light.astype(np.float32), cover.astype(np.float32)


DRAWINGS: MutableMapping[str, Callable[..., Light]] = {
    "ball": ball,
    "cloth": cloth,
    "colour-chart": colour_chart,
    "grey-steps": grey_steps,
    "night-street": night_street,
    "outdoor-sun": outdoor_sun,
    "ramp": ramp,
    "room": room,
    "slanted-edge": slanted_edge,
    "stars": stars,
    "tile-floor": tile_floor,
    "uniform": uniform,
    "wall": wall,
}

_RELATIVE = frozenset(("cloth", "tile-floor"))
"""Drawings in grey whose brightest pixel has irradiance 1: known when all of it is drawn."""

_STRIP_SAMPLES = 1 << 16
"""Pixels of a strip: the arrays from which it is drawn fit into a processor's cache."""


@dataclass(frozen=True)
class Drawing:
    """The picture of a scene, drawn in strips when it is needed.

    Attributes:
        name: in `DRAWINGS`
        rows, columns: its size
        brightest: irradiance of its brightest diffuse part
    """

    name: str
    rows: int
    columns: int
    brightest: float

    @cached_property
    def shape(self) -> tuple[int, ...]:
        """(rows, columns) or (rows, columns, 3)."""
        line = DRAWINGS[self.name](self.rows, self.columns, slice(0, 1))
        return (self.rows, *line.shape[1:])

    def at(self, rows: int, columns: int) -> Drawing:
        """Return the same drawing at another size."""
        return replace(self, rows=rows, columns=columns)

    def drawn(self, convert: Callable[[Light], Light] = lambda strip: strip) -> Light:
        """Return the irradiance in float32, each strip of it as `convert` changes it.

        A strip begins at an even row; what `convert` makes of a grey one is proportional to it.
        """
        height = max(2, _STRIP_SAMPLES // self.columns & ~1)
        factor, is_relative = np.float32(self.brightest), self.name in _RELATIVE
        picture: Light | None = None
        for top in range(0, self.rows, height):
            part = slice(top, min(top + height, self.rows))
            strip = DRAWINGS[self.name](self.rows, self.columns, part)
            if not is_relative:
                strip *= factor
            strip = convert(strip)
            if picture is None:
                picture = np.empty((self.rows, *strip.shape[1:]), np.float32)
            picture[part] = strip
        assert picture is not None  # it has rows
        if is_relative:
            picture /= picture.max()
            picture *= factor
        return picture
