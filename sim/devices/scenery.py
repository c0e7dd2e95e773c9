"""What a virtual camera sees, out of its configuration."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from camctl.errors import UsageError
from sim.exposer import Exposer
from sim.road import parse_size
from sim.scene import DEFAULT_SCENE, load_scene
from sim.sensor import DEFAULT_SENSOR, load_sensor

_Model = TypeVar("_Model", bound=BaseModel)


class Scenery(BaseModel):
    """The part of a virtual camera's configuration that says what it sees.

    Attributes:
        scene, sensor: names or files
        size: of the picture, "WIDTHxHEIGHT"; None: the scene's or the sensor's own
        seed: of all noise
        repeat_noise: every picture draws the same noise
    """

    model_config = ConfigDict(frozen=True)

    scene: str = DEFAULT_SCENE
    sensor: str = DEFAULT_SENSOR
    size: str | None = None
    seed: int = Field(default=0, ge=0, lt=2**64)
    repeat_noise: bool = False


# Of the whole configuration, what belongs to the process that holds the devices.
_OF_THE_HUB = ("name", "kind", "transport")


def checked(model: type[_Model], values: Mapping[str, Any]) -> _Model:
    """Return a configuration as its model (UsageError, one line, where it does not fit)."""
    try:
        return model.model_validate(dict(values))
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"][:1])
        raise UsageError(f"{place} of a virtual camera: {first['msg']}") from error


def split_config(config: Mapping[str, Any]) -> tuple[Exposer, dict[str, Any]]:
    """Return what a camera sees, and the rest of its configuration.

    Raises:
        UsageError, DataError: no such scene or sensor
    """
    seen = checked(Scenery, {k: v for k, v in config.items() if k in Scenery.model_fields})
    sensor = load_sensor(seen.sensor)
    shape = parse_size(seen.size) if seen.size is not None else None
    scene = load_scene(seen.scene, shape, usual=sensor.shape)
    exposer = Exposer(scene, sensor, seed=seen.seed, repeat_noise=seen.repeat_noise)
    taken = (*Scenery.model_fields, *_OF_THE_HUB)
    return exposer, {key: value for key, value in config.items() if key not in taken}
