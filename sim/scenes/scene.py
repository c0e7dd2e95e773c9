"""What a simulated sensor looks at: an array of irradiance, built in or from a file."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from camctl.errors import DataError, UsageError, unknown_name
from sim.scenes.drawings import DRAWINGS
from sim.scenes.motion import Lamps, Target
from sim.scenes.radiance_map import SUFFIXES, read_map, read_shape
from sim.scenes.scene_file import SceneFile, open_scene_file, read_scene_file

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


def _built_in() -> dict[str, str]:
    folder = resources.files("sim") / "scenes"
    return {
        item.name.removesuffix(".json"): item.read_text(encoding="utf-8")
        for item in folder.iterdir()
        if item.name.endswith(".json")
    }


def scene_names() -> tuple[str, ...]:
    """Return the names of the built-in scenes."""
    return tuple(sorted(_built_in()))


def is_map(name_or_path: str | Path) -> bool:
    """Return whether that names a radiance map rather than a scene."""
    return Path(name_or_path).suffix.lower() in SUFFIXES


def load_scene(
    name_or_path: str | Path,
    shape: tuple[int, int] | None = None,
    *,
    usual: tuple[int, int] = (480, 640),
) -> Scene:
    """Return a built-in scene, one from a scene file (.json), or a radiance map.

    `shape` is the size (rows, columns) that a drawn scene is drawn at; without it, the file's own
    size or else `usual`.  What is read from a radiance map has a size of its own.

    Raises:
        UsageError: no scene of that name; a size is asked of a radiance map
        DataError: a file that is missing, unreadable, or no light (see `Scene`); too large
    """
    name = str(name_or_path)
    path = Path(name)
    if is_map(path):
        return _from_map(path, shape)
    if path.suffix.lower() == ".json":
        return _described(open_scene_file(path), path.parent, shape, usual, source=name)
    built_in = _built_in()
    if name not in built_in:
        if path.suffix and path.exists():
            known = ", ".join((*SUFFIXES, ".json"))
            raise DataError(f"{path}: not a kind of radiance map", hint=f"known: {known}")
        raise unknown_name("scene", name, built_in)
    return _described(read_scene_file(built_in[name], source=name), None, shape, usual, source=name)


def _described(
    file: SceneFile,
    folder: Path | None,
    shape: tuple[int, int] | None,
    usual: tuple[int, int],
    *,
    source: str,
) -> Scene:
    """Return the scene of a scene file; maps are looked for in `folder`."""
    unit = PHOTONS if file.luminance_cd_m2 is None else LUMINANCE
    brightest = file.photons_s or file.luminance_cd_m2 or 1.0
    notes: tuple[str, ...] = ()
    if folder is not None and is_map(file.picture):
        map_ = _from_map(folder / file.picture, shape)
        light, notes = map_.irradiance, map_.notes
        light = light * np.float32(map_.photons_per_unit / HIGHLIGHT_PHOTONS_S)
    elif file.picture in DRAWINGS:
        rows, columns = shape or file.shape or usual
        if rows < 1 or columns < 1:
            raise UsageError(f"a scene of {columns}x{rows} pixels", hint="both must be 1 or more")
        _check_memory(source, (rows, columns), _DRAWING_BYTES)
        light = DRAWINGS[file.picture](rows, columns)
    else:
        near = str(unknown_name("picture", file.picture, DRAWINGS))
        raise DataError(f"{source}: picture: {near}")
    light *= np.float32(brightest)
    target = None
    if file.target is not None:
        target = file.target.target(*light.shape[:2])
        target = target.scaled(target.light * np.float32(brightest))
    lamps = None if file.lamps is None else file.lamps.lamps()
    return Scene(file.name, light, unit, notes=notes, lamps=lamps, target=target)


def _from_map(path: Path, shape: tuple[int, int] | None) -> Scene:
    if shape is not None:
        raise UsageError(f"{path}: a file has a size of its own", hint="leave the size out")
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
