"""A scene in front of a simulated sensor: built in, from a scene file, or from a radiance map."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from camctl.errors import DataError, UsageError, unknown_name
from camctl.sim.data_files import (
    FileModel,
    PictureShape,
    Positive,
    Share,
    built_in_files,
    read_file,
    read_text,
)
from camctl.sim.scenes.drawings import DRAWINGS, Drawing, wheel
from camctl.sim.scenes.motion import Lamps, PwmLamps, Target
from camctl.system.input_files import exists

DEFAULT_SCENE = "tile-floor"
PHOTONS = "photons per pixel per second"
RELATIVE = "arbitrary units"
LUMINANCE = "candela per square metre"

HIGHLIGHT_CD_M2 = 464.8576
"""Luminance that the highlight of a radiance map gets, and that the brightest diffuse part of six
built-in scenes has, about as white paper in 1,500 lux: the standard sensor, at f/4 and
3.45 um, sees a million photons a pixel a second, and is filled by them in 20 ms."""

_HIGHLIGHT_QUANTILE = 0.999  # of a map's positive irradiance
_DRAWING_BYTES_PER_PIXEL = 40  # a drawing in colour, in front of a mosaic and on it, in float32
_CHECKED_SHAPE = (48, 64)  # of a drawing whose brightness is checked
_READING_BYTES_PER_PIXEL = 48  # likewise, for a map that is read


@dataclass(frozen=True, eq=False)
class Scene:
    """Irradiance on the sensor plane, one value for each pixel and channel.

    Attributes:
        name: of the scene
        picture: irradiance, (rows, columns) or (rows, columns, 3) linear RGB, float32, finite,
            >= 0; or a drawing of it
        unit: `PHOTONS` or `LUMINANCE` for an absolute scene, `RELATIVE` for a radiance map
        photons_per_unit: photons a pixel a second for one unit of irradiance; unless the unit is
            `PHOTONS`, it is in cd/m^2, and `Sensor.photons_per_candela` multiplies it
        notes: about the file that it was read from, one line each
        lamps: lamps that are not steady, if any
        target: a moving target, if any

    Raises:
        DataError: irradiance that is NaN, infinite, negative, zero everywhere or empty, or has a
            wrong shape; an invalid `photons_per_unit`
    """

    name: str
    picture: NDArray[np.float32] | Drawing
    unit: str = PHOTONS
    photons_per_unit: float = 1.0
    notes: tuple[str, ...] = ()
    lamps: Lamps | PwmLamps | None = None
    target: Target | None = None

    def __post_init__(self) -> None:
        if isinstance(self.picture, Drawing):
            _checked(self.name, self.picture.at(*_CHECKED_SHAPE).drawn())
        else:
            object.__setattr__(self, "picture", _checked(self.name, np.asarray(self.picture)))
        if not (math.isfinite(self.photons_per_unit) and self.photons_per_unit > 0):
            raise DataError(
                f"scene {self.name}: invalid photons_per_unit {self.photons_per_unit}",
                hint="expected a finite number above 0",
            )

    @property
    def shape(self) -> tuple[int, int]:
        return self.picture.shape[0], self.picture.shape[1]

    @property
    def is_coloured(self) -> bool:
        return len(self.picture.shape) == 3

    @cached_property
    def irradiance(self) -> NDArray[np.float32]:
        """Irradiance, (rows, columns) or (rows, columns, 3); a drawing is drawn and kept."""
        return self.picture.drawn() if isinstance(self.picture, Drawing) else self.picture


def _checked(name: str, values: NDArray[np.generic]) -> NDArray[np.float32]:
    """Return irradiance as `Scene` has it; raises `DataError`."""
    if values.ndim == 3 and values.shape[2] == 1:
        values = values[..., 0]
    if values.ndim not in (2, 3) or (values.ndim == 3 and values.shape[2] != 3):
        raise DataError(
            f"scene {name}: invalid array shape {values.shape}",
            hint="expected (rows, columns) or (rows, columns, 3)",
        )
    if values.dtype.kind not in "fiub":
        raise DataError(
            f"scene {name}: invalid data type {values.dtype}", hint="expected real numbers"
        )
    if values.size == 0:
        raise DataError(f"scene {name}: the picture has no pixels", hint="check the file")
    with np.errstate(over="ignore"):
        light = np.ascontiguousarray(values, dtype=np.float32)
    # The extremes decide; bad pixels are only counted for the message.
    least, most = float(light.min()), float(light.max())
    if not (math.isfinite(least) and math.isfinite(most)):
        kinds = "NaN or infinite" if np.isnan(light).any() else "infinite or beyond float32"
        raise DataError(
            f"scene {name}: {_count(~np.isfinite(light))} {kinds}",
            hint="replace them, for instance with numpy.nan_to_num",
        )
    if least < 0:
        raise DataError(
            f"scene {name}: {_count(light < 0)} negative (down to {least:.3g})",
            hint="irradiance is never negative: clip the map at 0 or check its black level",
        )
    if most == 0:
        raise DataError(f"scene {name}: all pixels are 0", hint="a scene needs some light")
    return light


def _count(bad: NDArray[np.bool_]) -> str:
    """Return "2 of 5 pixels are" for a mask (rows, columns[, 3])."""
    flags = bad.any(axis=2) if bad.ndim == 3 else bad
    count = int(flags.sum())
    return f"{count} of {flags.size} pixels {'is' if count == 1 else 'are'}"


class LampsFile(FileModel):
    """Lamps in a scene file that flicker (`mains_hz`) or are switched (`pwm_hz` and `duty`).

    See `camctl.sim.scenes.motion.Lamps` and `camctl.sim.scenes.motion.PwmLamps`.
    """

    mains_hz: Annotated[float, Field(gt=0, le=1000)] | None = None
    pwm_hz: Annotated[float, Field(ge=1e-3, le=1e6)] | None = None
    duty: Annotated[float, Field(ge=1e-3, le=1)] | None = None
    depth: Share

    @model_validator(mode="after")
    def _check_kind(self) -> Self:
        given = (self.mains_hz is not None, self.pwm_hz is not None, self.duty is not None)
        if given not in ((True, False, False), (False, True, True)):
            raise ValueError("give either mains_hz, or pwm_hz and duty")
        return self

    def lamps(self) -> Lamps | PwmLamps:
        """Return the lamps."""
        if self.pwm_hz is not None and self.duty is not None:
            return PwmLamps(self.pwm_hz, self.duty, self.depth)
        assert self.mains_hz is not None
        return Lamps(self.mains_hz, self.depth)


class TargetFile(FileModel):
    """A moving target in a scene file: a wheel of black and white sectors.

    Attributes:
        size: its diameter, share of the picture's height
        top, left: its position at time 0, shares of height and width
        crossing_s: seconds for one width of the picture; negative moves to the left
        brightness: of its white, in units of the brightest diffuse part of the scene
    """

    size: Annotated[float, Field(gt=0, le=1)] = 0.4
    top: Annotated[float, Field(ge=-1, le=1)] = 0.3
    left: Annotated[float, Field(ge=-1, le=1)] = 0.1
    crossing_s: Annotated[float, Field(allow_inf_nan=False)] = 2.0
    brightness: Positive = 1.0

    @model_validator(mode="after")
    def _check_speed(self) -> Self:
        if abs(self.crossing_s) < 1e-3:
            raise ValueError("crossing_s is less than a millisecond")
        return self

    def target(self, rows: int, columns: int) -> Target:
        """Return the target for a picture of that size."""
        light, cover = wheel(max(2, round(self.size * rows)))
        return Target(
            light * light.dtype.type(self.brightness),
            cover,
            round(self.top * rows),
            self.left * columns,
            columns / self.crossing_s,
        )


class SceneFile(FileModel):
    """A scene file; the built-in scenes are such files.

    Attributes:
        name: of the scene
        what: one line about it
        picture: the name of a drawing, or a radiance map beside this file
        photons_s: photons a pixel a second of the brightest diffuse part (irradiance 1 of a
            drawing, the highlight of a map)
        luminance_cd_m2: the luminance of that part instead; lens and pixel of the sensor determine
            how many photons that is
        shape: (rows, columns) that a drawing has unless a size is requested
        lamps: lamps that are not steady, if any
        target: a moving target, if any
    """

    name: str
    what: str = ""
    picture: str
    photons_s: Positive | None = None
    luminance_cd_m2: Positive | None = None
    shape: PictureShape | None = None
    lamps: LampsFile | None = None
    target: TargetFile | None = None

    @model_validator(mode="after")
    def _check_unit(self) -> Self:
        if (self.photons_s is None) == (self.luminance_cd_m2 is None):
            raise ValueError("give either photons_s or luminance_cd_m2")
        return self


def scene_names() -> tuple[str, ...]:
    """Return the names of the built-in scenes."""
    return tuple(sorted(built_in_files("scenes")))


def load_scene(
    name_or_path: str | Path,
    shape: tuple[int, int] | None = None,
    *,
    usual: tuple[int, int] = (480, 640),
) -> Scene:
    """Return a built-in scene, one from a scene file (.json), or a radiance map.

    Args:
        name_or_path: a name in `scene_names`, or a file
        shape: (rows, columns) of a drawn scene; a radiance map has its own
        usual: (rows, columns) of a drawn scene where neither `shape` nor the scene file sets it

    Raises:
        UsageError: no scene of that name; `shape` is not that of a radiance map, or is not positive
        DataError: a file that is missing, unreadable or too large, or has invalid irradiance
    """
    name = str(name_or_path)
    path = Path(name)
    if _is_map(path):
        return _from_map(path, shape)
    if path.suffix.lower() == ".json":
        file = read_file(SceneFile, path)
        return _from_file(file, path.parent, shape, usual, source=name)
    built_in = built_in_files("scenes")
    if name not in built_in:
        if path.suffix and exists(name):
            from camctl.stills.radiance_map import SUFFIXES

            known = ", ".join((*SUFFIXES, ".json"))
            raise DataError(f"{path}: unknown file type {path.suffix}", hint=f"known: {known}")
        raise unknown_name("scene", name, built_in)
    file = read_text(SceneFile, built_in[name], source=name)
    return _from_file(file, None, shape, usual, source=name)


def _is_map(path: str | Path) -> bool:
    if not (suffix := Path(path).suffix.lower()):
        return False  # what reads maps takes memory that a built-in scene does without
    from camctl.stills.radiance_map import SUFFIXES

    return suffix in SUFFIXES


def _from_file(
    file: SceneFile,
    folder: Path | None,
    shape: tuple[int, int] | None,
    usual: tuple[int, int],
    *,
    source: str,
) -> Scene:
    """Return the scene of a scene file whose radiance map, if it has one, lies in `folder`."""
    unit = PHOTONS if file.luminance_cd_m2 is None else LUMINANCE
    brightest = file.photons_s or file.luminance_cd_m2 or 1.0
    notes: tuple[str, ...] = ()
    picture: NDArray[np.float32] | Drawing
    if folder is not None and _is_map(file.picture):
        map_ = _from_map(folder / file.picture, shape)
        picture, notes = map_.irradiance, map_.notes
        picture = picture * np.float32(map_.photons_per_unit / HIGHLIGHT_CD_M2)
        picture *= np.float32(brightest)
    elif file.picture in DRAWINGS:
        rows, columns = shape or file.shape or usual
        if rows < 1 or columns < 1:
            raise UsageError(f"invalid scene size {columns}x{rows}", hint="both must be 1 or more")
        _check_memory(source, (rows, columns), _DRAWING_BYTES_PER_PIXEL)
        picture = Drawing(file.picture, rows, columns, brightest)
    else:
        raise DataError(f"{source}: picture: {unknown_name('drawing', file.picture, DRAWINGS)}")
    target = None
    if file.target is not None:
        target = file.target.target(*picture.shape[:2])
        target = target.scaled(target.light * np.float32(brightest))
    lamps = None if file.lamps is None else file.lamps.lamps()
    return Scene(file.name, picture, unit, notes=notes, lamps=lamps, target=target)


def _from_map(path: Path, shape: tuple[int, int] | None) -> Scene:
    from camctl.stills.radiance_map import read_map, read_shape

    found = read_shape(path)
    check_shape(str(path), found, shape)
    _check_memory(str(path), found, _READING_BYTES_PER_PIXEL)
    values, notes = read_map(path)
    return replace(scene_of(values, str(path)), name=path.name, notes=notes)


def scene_of(values: ArrayLike, name: str = "array") -> Scene:
    """Return the scene of relative irradiance in an array, as of a radiance map.

    Args:
        values: (rows, columns) or (rows, columns, 3), real numbers >= 0 in any unit; the highlight,
            their 99.9 % quantile, has a luminance of `HIGHLIGHT_CD_M2`
        name: of the scene

    Raises:
        DataError: they are no irradiance
    """
    light = _checked(name, np.asarray(values))
    channel = light if light.ndim == 2 else light.max(axis=2)
    highlight = float(np.quantile(channel[channel > 0], _HIGHLIGHT_QUANTILE))
    return Scene(name, light, RELATIVE, HIGHLIGHT_CD_M2 / highlight)


def check_shape(name: str, found: Sequence[int], requested: tuple[int, int] | None) -> None:
    """Raise `UsageError` where another size, (rows, columns), was requested than a scene has."""
    if requested is not None and requested != tuple(found[:2]):
        raise UsageError(
            f"{name} has its own size, {found[1]}x{found[0]}", hint="leave the size out"
        )


def _check_memory(name: str, shape: tuple[int, ...], bytes_per_pixel: int) -> None:
    needed = math.prod(shape[:2]) * bytes_per_pixel
    available = _available_bytes()
    if needed > available:
        size = " x ".join(str(n) for n in reversed(shape[:2]))
        raise DataError(
            f"scene {name}: {size} pixels need about {needed / 2**30:.1f} GiB of memory,"
            f" but {available / 2**30:.1f} GiB are available",
            hint="request a smaller size",
        )


def _available_bytes() -> float:
    """Return how much memory is available; infinite if the system does not report it."""
    try:
        page = os.sysconf("SC_PAGE_SIZE")
        free, total = os.sysconf("SC_AVPHYS_PAGES"), os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return math.inf
    # Free pages do not count the file cache, which the system would release.
    return float(page * max(free, total // 2))
