"""What all virtual cameras share: the sensor, the options that select it, and control commands."""

from __future__ import annotations

import threading
from collections import OrderedDict
from typing import Any

from pydantic import Field

from camctl.errors import unknown_name
from camctl.interface.backends import BackendOptions, FrameShape
from camctl.interface.camera import Pixels
from camctl.interface.controls import Layout
from camctl.sim.render import Renderer
from camctl.sim.scenes.scene import DEFAULT_SCENE, Scene, load_scene
from camctl.sim.scenes.view import View
from camctl.sim.sensors.sensor import DEFAULT_SENSOR, Sensor, load_sensor

_CACHE_BYTES = 64 * 1024 * 1024  # of rendered pictures: a bracket of small ones


def as_tuple(value: object) -> object:
    """Return an option that may be one value or several."""
    return value if isinstance(value, list | tuple) else (value,)


class VirtualSensor:
    """A simulated sensor that sees a scene and is exposed on demand, from any thread.

    Args:
        scene: what it sees; pictures have the scene's size
        model: its properties; exposure times and gains are not limited to the model's
        seed: of all noise
        repeat_noise: every picture draws the noise of frame 0, so that it depends on its exposure
            alone; the last ones are then kept instead of being rendered again

    Attributes:
        scene, model: as given
        layout: pixel layout of a picture
        shape: (rows, columns)
        black, white: levels, DN

    Raises:
        UsageError: invalid seed
    """

    def __init__(
        self, scene: Scene, model: Sensor, *, seed: int = 0, repeat_noise: bool = False
    ) -> None:
        self.scene = scene
        self.model = model
        self.shape = scene.shape
        self.layout: Layout = model.layout_for(scene.is_coloured)
        self.black, self.white = model.black, model.white
        self._renderer = Renderer(View.of(scene, model), model, seed=seed)
        self._repeat_noise = repeat_noise
        self._lock = threading.Lock()
        self._cache: OrderedDict[tuple[float, float], Pixels] = OrderedDict()

    def expose(self, time_s: float, gain: float = 1.0, number: int = 0) -> Pixels:
        """Return a picture exposed for `time_s` at linear `gain`, with the noise of frame `number`.

        (rows, columns), or (rows, columns, 3) as RGB; uint8 up to 8 bits, else uint16; read-only
        with `repeat_noise`.  It is then bit for bit the frame of a `SimulatedCamera` with
        `repeat_noise`, the same scene, sensor and seed.
        """
        with self._lock:
            if not self._repeat_noise:
                return self._renderer.frame(time_s, gain, number)
            pixels = self._cache.get((time_s, gain))
            if pixels is None:
                pixels = self._cache[time_s, gain] = self._renderer.frame(time_s, gain, 0)
                pixels.flags.writeable = False
                while len(self._cache) > max(1, _CACHE_BYTES // pixels.nbytes):
                    self._cache.popitem(last=False)
            self._cache.move_to_end((time_s, gain))
            return pixels


class DeviceConfig(BackendOptions):
    """The options that all virtual cameras have; each kind of camera adds its own.

    Attributes:
        name, kind: of the device; for `camctl.sim.devices.hub`
        scene, sensor: names or files
        size: of the picture, WIDTHxHEIGHT; None: the scene's or the sensor's own
        seed: of all noise
        repeat_noise: every picture draws the same noise
    """

    name: str = ""
    kind: str = ""
    scene: str = DEFAULT_SCENE
    sensor: str = DEFAULT_SENSOR
    size: FrameShape | None = None
    seed: int = Field(default=0, ge=0, lt=2**64)
    repeat_noise: bool = False

    def load_sensor(self, size: tuple[int, int] | None = None) -> VirtualSensor:
        """Return the sensor; with pictures of `size`, (rows, columns), if it is given.

        Raises:
            UsageError, DataError: the scene or the sensor does not exist or is invalid
        """
        model = load_sensor(self.sensor)
        scene = load_scene(self.scene, size or self.size, usual=model.shape)
        return VirtualSensor(scene, model, seed=self.seed, repeat_noise=self.repeat_noise)


class Controllable:
    """A device that a test or a person can change from outside its protocol.

    A control command is a method `do_NAME`; its arguments and its result can be written as JSON.
    Faults that a command sets stay until they have happened as often as asked for, or until the
    command ``ok``.  A subclass implements `attach`, `detach` and `state`.
    """

    def attach(self) -> None:
        """Plug the device in."""
        raise NotImplementedError

    def detach(self) -> None:
        """Unplug the device."""
        raise NotImplementedError

    def state(self) -> dict[str, Any]:
        """Return the settings in force and counters, ready for JSON."""
        return {}

    def do(self, command: str, **arguments: Any) -> dict[str, Any]:
        """Execute a control command and return its result.

        Raises:
            UsageError: the device has no such command
            TypeError: the command has no such argument
        """
        method = getattr(self, f"do_{command}", None)
        if method is None:
            commands = [name[3:] for name in dir(self) if name.startswith("do_")]
            raise unknown_name("control command", command, commands)
        result: dict[str, Any] | None = method(**arguments)
        return result or {}

    def do_unplug(self) -> None:
        self.detach()

    def do_plug(self) -> None:
        self.attach()

    def do_state(self) -> dict[str, Any]:
        return self.state()
