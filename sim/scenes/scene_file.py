"""Scenes as small files in real units, which a person can copy and change."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from camctl.errors import DataError
from sim.scenes.drawings import wheel
from sim.scenes.motion import Lamps, Target
from sim.sensors.parts import Positive

Share = Annotated[float, Field(ge=0, le=1)]


class _File(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class LampsFile(_File):
    """Lamps on the mains; see `sim.scenes.motion.Lamps`."""

    mains_hz: Annotated[float, Field(gt=0, le=1000)]
    depth: Share

    def lamps(self) -> Lamps:
        """Return the lamps."""
        return Lamps(self.mains_hz, self.depth)


class TargetFile(_File):
    """A wheel of black and white sectors that crosses the picture.

    Attributes:
        size: its diameter, share of the picture's height
        top, left: where it is at time 0, shares of height and width
        crossing_s: seconds for one width of the picture; negative moves to the left
        brightness: times the brightest diffuse part of the scene, at its white
    """

    size: Annotated[float, Field(gt=0, le=1)] = 0.4
    top: Annotated[float, Field(ge=-1, le=1)] = 0.3
    left: Annotated[float, Field(ge=-1, le=1)] = 0.1
    crossing_s: Annotated[float, Field(allow_inf_nan=False)] = 2.0
    brightness: Positive = 1.0

    @model_validator(mode="after")
    def _moves(self) -> Self:
        if abs(self.crossing_s) < 1e-3:
            raise ValueError("target: crossing_s is less than a millisecond")
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


class SceneFile(_File):
    """One scene; the scenes that come with the program are such files.

    Attributes:
        name: what a person calls it
        what: what it shows, one line
        picture: a drawing's name, or a radiance map beside this file
        photons_s: photons a pixel a second of the brightest diffuse part (a drawing's irradiance
            1, a map's highlight)
        luminance_cd_m2: its luminance instead; lens and pixel then say how much light that is
        shape: (rows, columns) that a drawing has unless a size is asked for
        lamps: what lights it, where that flickers
        target: what moves before it
    """

    name: str
    what: str = ""
    picture: str
    photons_s: Positive | None = None
    luminance_cd_m2: Positive | None = None
    shape: tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(ge=1)]] | None = None
    lamps: LampsFile | None = None
    target: TargetFile | None = None

    @model_validator(mode="after")
    def _has_one_unit(self) -> Self:
        if (self.photons_s is None) == (self.luminance_cd_m2 is None):
            raise ValueError("give either photons_s or luminance_cd_m2")
        return self


def read_scene_file(text: str, *, source: str) -> SceneFile:
    """Return the scene that JSON `text` describes; `source` names it in errors (DataError)."""
    try:
        return SceneFile.model_validate(json.loads(text))
    except json.JSONDecodeError as error:
        raise DataError(f"{source}: not JSON, line {error.lineno}: {error.msg}") from error
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        message = first["msg"].removeprefix("Value error, ")
        raise DataError(f"{source}: {place + ': ' if place else ''}{message}") from error


def open_scene_file(path: Path) -> SceneFile:
    """Return the scene file at `path`; raises `DataError`."""
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise DataError(f"{path}: no such file", hint="give a scene's name or file") from error
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: cannot be read ({error})", hint="give a JSON file") from error
    return read_scene_file(text, source=str(path))
