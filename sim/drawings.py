"""All drawn pictures by name; their brightest diffuse part has irradiance 1."""

from __future__ import annotations

from collections.abc import Callable, MutableMapping

from sim.charts import colour_chart, wall
from sim.nights import night_street, stars
from sim.procedural import Light, ball, cloth, ramp, room, tile_floor, uniform

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
