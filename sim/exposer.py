"""A simulated sensor before a scene, exposed on demand: the picture behind all virtual devices."""

from __future__ import annotations

import threading
from collections import OrderedDict

from camctl.camera import Layout, Pixels
from sim.render import Renderer
from sim.scene import Scene
from sim.sensor import Sensor
from sim.view import View

_KEPT_BYTES = 64 * 1024 * 1024


class Exposer:
    """Exposes `sensor` before `scene`; may be used from any thread.

    Args:
        scene: what it looks at; pictures have the scene's size
        sensor: see `sim.sensor.Sensor`; its times and gains are not looked at
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
