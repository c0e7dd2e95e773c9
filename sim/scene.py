"""What a simulated sensor looks at: an array of irradiance, built in or from a file."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from camctl.errors import DataError, UsageError, unknown_name
from sim.moving import Lamps, Target
from sim.procedural import BUILT_IN
from sim.radiance import SUFFIXES, read_map, read_shape

DEFAULT_SCENE = "tile-floor"
PHOTONS = "photons per pixel per second"
RELATIVE = "arbitrary units"
LUMINANCE = "candela per square metre"

HIGHLIGHT_PHOTONS_S = 1e6
"""Photons a pixel a second that a relative map's highlight is looked at with, and that the
brightest diffuse part of a built-in scene has: about 20 ms to fill the standard sensor."""

_HIGHLIGHT_SHARE = 0.999
_DRAWING_BYTES = 112  # a pixel, scene and working arrays together, in the most costly one
_READING_BYTES = 48


@dataclass(frozen=True, eq=False)
class Scene:
    """Irradiance on the sensor plane, one value a pixel and channel.

    Attributes:
        name: what a person calls it
        irradiance: (rows, columns) or (rows, columns, 3) linear RGB, float32, finite, >= 0
        unit: `PHOTONS` or `LUMINANCE` for an absolute scene, `RELATIVE` for a radiance map
        photons_per_unit: photons a pixel a second for one unit of irradiance; for `LUMINANCE`
            times what lens and pixel make of one candela (`Sensor.photons_per_candela`)
        notes: what had to be repaired in a file, one line each
        lamps: what lights it, where that flickers
        target: what moves before it

    Raises:
        DataError: NaN, infinite or negative irradiance, wrong dimensions, or nothing in it
    """

    name: str
    irradiance: NDArray[np.float32]
    unit: str = PHOTONS
    photons_per_unit: float = 1.0
    notes: tuple[str, ...] = ()
    lamps: Lamps | None = None
    target: Target | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "irradiance", _checked(self.name, np.asarray(self.irradiance)))
        if not (math.isfinite(self.photons_per_unit) and self.photons_per_unit > 0):
            raise DataError(
                f"{self.name}: {self.photons_per_unit} photons for a unit of irradiance"
            )

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self.irradiance.shape[0], self.irradiance.shape[1]

    @property
    def is_coloured(self) -> bool:
        """Whether it has three channels."""
        return self.irradiance.ndim == 3

    @cached_property
    def dynamic_range(self) -> float:
        """Largest over smallest positive irradiance."""
        positive = self.irradiance[self.irradiance > 0]
        return float(positive.max()) / float(positive.min())


def _checked(name: str, values: NDArray[np.generic]) -> NDArray[np.float32]:
    if values.ndim == 3 and values.shape[2] == 1:
        values = values[..., 0]
    if values.ndim not in (2, 3) or (values.ndim == 3 and values.shape[2] != 3):
        size = " x ".join(map(str, values.shape)) or "a single number"
        raise DataError(
            f"scene {name}: its array is {size}",
            hint="a scene is (rows, columns) or (rows, columns, 3)",
        )
    if values.dtype.kind not in "fiub":
        raise DataError(f"scene {name}: holds {values.dtype}, not numbers")
    if values.size == 0:
        raise DataError(f"scene {name}: there is nothing in it", hint="it has no pixels")
    with np.errstate(over="ignore"):
        light = np.ascontiguousarray(values, dtype=np.float32)
    # One pass each over the extremes decides; counting is only for the message.
    least, most = float(light.min()), float(light.max())
    if not (math.isfinite(least) and math.isfinite(most)):
        bad = ~np.isfinite(light)
        kinds = "NaN" if np.isnan(light).any() else "infinite"
        raise DataError(
            f"scene {name}: {_pixels(bad)} {kinds} or beyond float32"
            if kinds == "infinite"
            else f"scene {name}: {_pixels(bad)} NaN or infinite",
            hint="replace them, for instance with numpy.nan_to_num",
        )
    if least < 0:
        raise DataError(
            f"scene {name}: {_pixels(light < 0)} negative (down to {least:.3g})",
            hint="light is never negative: clip the map at 0 or check its black level",
        )
    if most == 0:
        raise DataError(f"scene {name}: there is nothing in it", hint="all its pixels are 0")
    return light


def _pixels(bad: NDArray[np.bool_]) -> str:
    flags = bad.any(axis=2) if bad.ndim == 3 else bad
    count = int(flags.sum())
    return f"{count} of {flags.size} pixels {'is' if count == 1 else 'are'}"


def scene_names() -> tuple[str, ...]:
    """Return the names of the built-in scenes."""
    return tuple(sorted(BUILT_IN))


def is_file(name_or_path: str | Path) -> bool:
    """Return whether that names a radiance map rather than a built-in scene."""
    return Path(name_or_path).suffix.lower() in SUFFIXES


def load_scene(name_or_path: str | Path, shape: tuple[int, int] | None = None) -> Scene:
    """Return a built-in scene drawn at `shape` (rows, columns), or a radiance map from a file.

    Raises:
        UsageError: no scene of that name; a size is asked of a file
        DataError: a file that is missing, unreadable, or no light (see `Scene`); too large
    """
    name = str(name_or_path)
    path = Path(name)
    if is_file(path):
        if shape is not None:
            raise UsageError(f"{path}: a file has a size of its own", hint="leave the size out")
        return _from_file(path)
    if name not in BUILT_IN:
        if path.suffix and path.exists():
            raise DataError(
                f"{path}: not a kind of radiance map", hint=f"known: {', '.join(SUFFIXES)}"
            )
        raise unknown_name("scene", name, BUILT_IN)
    rows, columns = shape or (480, 640)
    if rows < 1 or columns < 1:
        raise UsageError(f"a scene of {columns}x{rows} pixels", hint="both must be 1 or more")
    _check_memory(name, (rows, columns), _DRAWING_BYTES)
    # The drawings' brightest diffuse part is 1.
    light = BUILT_IN[name](rows, columns)
    light *= np.float32(HIGHLIGHT_PHOTONS_S)
    return Scene(name, light)


def _from_file(path: Path) -> Scene:
    _check_memory(str(path), read_shape(path), _READING_BYTES)
    values, notes = read_map(path)
    light = _checked(str(path), values)
    channel = light if light.ndim == 2 else light.max(axis=2)
    positive = channel[channel > 0]
    highlight = float(np.quantile(positive, _HIGHLIGHT_SHARE))
    return Scene(path.name, light, RELATIVE, HIGHLIGHT_PHOTONS_S / highlight, notes)


def _check_memory(name: str, shape: tuple[int, ...], bytes_a_pixel: int) -> None:
    needed = math.prod(shape[:2]) * bytes_a_pixel
    available = _memory_there()
    if needed > available:
        size = " x ".join(str(n) for n in reversed(shape[:2]))
        raise DataError(
            f"scene {name}: {size} pixels need about {needed / 2**30:.1f} GiB,"
            f" {available / 2**30:.1f} GiB are there",
            hint="ask for a smaller size",
        )


def _memory_there() -> float:
    """Return bytes of memory that can be had; infinite where the system does not say."""
    try:
        page = os.sysconf("SC_PAGE_SIZE")
        free, total = os.sysconf("SC_AVPHYS_PAGES"), os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return math.inf
    # Free pages leave out what the system would give back from its file cache.
    return float(page * max(free, total // 2))
