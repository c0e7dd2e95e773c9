"""What a virtual camera sees, out of its configuration."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from camctl.backends import FrameShape
from camctl.camera import Pixels
from camctl.controls import Layout
from camctl.errors import UsageError
from sim.render import Renderer
from sim.scenes.scene import DEFAULT_SCENE, Scene, load_scene
from sim.scenes.view import View
from sim.sensors.sensor import DEFAULT_SENSOR, Sensor, load_sensor

_KEPT_BYTES = 64 * 1024 * 1024


class Exposer:
    """Exposes `sensor` before `scene`; may be used from any thread.

    Args:
        scene: what it looks at; pictures have the scene's size
        sensor: see `sim.sensors.sensor.Sensor`; its times and gains are not looked at
        seed: of all noise
        repeat_noise: every picture draws the noise of frame 0, so that it depends on its exposure
            alone; the last ones are then kept instead of being rendered again

    Attributes:
        scene, sensor: as given
        layout: how colour lies in a picture
        shape: (rows, columns)
        black, white: see `Sensor`, DN

    Raises:
        UsageError: a seed out of range
    """

    def __init__(
        self, scene: Scene, sensor: Sensor, *, seed: int = 0, repeat_noise: bool = False
    ) -> None:
        self.scene = scene
        self.sensor = sensor
        self.shape = scene.shape
        self.layout: Layout = sensor.layout_for(scene.is_coloured)
        self.black, self.white = sensor.black, sensor.white
        self._renderer = Renderer(View.of(scene, sensor), sensor, seed=seed)
        self._repeat_noise = repeat_noise
        self._lock = threading.Lock()
        self._kept: OrderedDict[tuple[float, float], Pixels] = OrderedDict()

    def expose(self, time_s: float, gain: float = 1.0, number: int = 0) -> Pixels:
        """Return a picture exposed for `time_s` at linear `gain`; frame `number` draws its noise.

        (rows, columns), or (rows, columns, 3) as RGB; uint8 up to 8 bits, else uint16.  Not to be
        written to.  With `repeat_noise` it is bit for bit that of a `SimulatedCamera` with
        `repeat_noise`, the same scene, sensor and seed.
        """
        with self._lock:
            if not self._repeat_noise:
                return self._renderer.frame(time_s, gain, number)
            pixels = self._kept.get((time_s, gain))
            if pixels is None:
                pixels = self._kept[time_s, gain] = self._renderer.frame(time_s, gain, 0)
                pixels.flags.writeable = False
                while len(self._kept) > max(1, _KEPT_BYTES // pixels.nbytes):
                    self._kept.popitem(last=False)
            self._kept.move_to_end((time_s, gain))
            return pixels


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
    size: FrameShape | None = None
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
    scene = load_scene(seen.scene, seen.size, usual=sensor.shape)
    exposer = Exposer(scene, sensor, seed=seen.seed, repeat_noise=seen.repeat_noise)
    taken = (*Scenery.model_fields, *_OF_THE_HUB)
    return exposer, {key: value for key, value in config.items() if key not in taken}
