"""A whole camera driver: it shows a gradient of light, and has full stops on its dial."""

import numpy as np

from camctl.camera import CameraInfo, Frame
from camctl.clock import RealClock
from camctl.controls import Choices, ExposureControls, Layout
from camctl.errors import CameraDisconnectedError, CameraNotFoundError, UsageError

LIGHT = {"bright": 20.0, "dim": 2.0}  # of the brightest column, full scales a second


class ExampleCamera:
    def __init__(self, address):
        self.info = CameraInfo(f"example:{address}", "camctl", "Example", address, "example")
        self.clock, self._is_open = RealClock(), True
        self.controls = ExposureControls(
            time_s=Choices(tuple(2.0**k for k in range(-10, 2))),  # true seconds, no labels
            shape=(48, 64),
            layout=Layout.MONO,
            bits=8,
            white=255,
            delay_frames=0,
        )
        self._light = np.geomspace(LIGHT[address], LIGHT[address] / 256, 64)

    def shoot(self, settings):
        for setting in settings:  # all of them, before anything is shot: refuse, never snap
            self.controls.check(setting)
        return self._frames(tuple(settings))

    def preview(self, setting):
        return next(self.shoot([setting]))

    def _frames(self, settings):
        for index, setting in enumerate(settings):
            if not self._is_open:
                raise CameraDisconnectedError("the example is closed", hint="open it again")
            self.clock.sleep_until(self.clock.now() + setting.time_s)
            row = np.minimum(256 * self._light * setting.time_s, 255).astype(np.uint8)
            # The second `setting` is what was applied: read it back from a real device.
            yield Frame(np.tile(row, (48, 1)), setting, setting, self.clock.now(), index, 0, 255)

    def close(self):
        self._is_open = False

    __enter__, __exit__ = (lambda self: self), (lambda self, *_: self.close())


class ExampleBackend:
    about = "an example of a driver: a gradient of light"

    def discover(self, *, probe=False):
        return [ExampleCamera(address).info for address in LIGHT]

    def open(self, address, options):
        if address not in LIGHT:
            raise CameraNotFoundError(f"no camera example:{address}", hint="try example:bright")
        for name in options:  # nothing that was said is ignored
            raise UsageError(f"the example has no option '{name}'", hint="leave it out")
        return ExampleCamera(address)
