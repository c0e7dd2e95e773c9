"""A complete camera driver: it shows a gradient of light, and its shutter times are full stops."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

import camctl

LIGHT = {"bright": 20.0, "dim": 2.0}  # of the brightest column, full scales a second


class ExampleCamera(camctl.CameraBase):
    def __init__(self, address: str, clock: camctl.Clock | None = None) -> None:
        super().__init__(f"example:{address}", clock or camctl.RealClock())
        self._info = camctl.CameraInfo(self._name, "camctl", "Example", address, "example")
        times = camctl.Choices(tuple(2.0**k for k in range(-10, 2)))  # true seconds, not labels
        mono, known = camctl.Layout.MONO, camctl.ResponseOrigin.STATED  # the samples are linear
        self._controls = camctl.ExposureControls(
            times, (48, 64), mono, bits=8, white=255, response_origin=known, delay_frames=0
        )
        self._light = np.geomspace(LIGHT[address], LIGHT[address] / 256, 64)

    def _open(self) -> None: ...  # connect to the device here
    def _close(self) -> None: ...

    def _frames(self, settings: tuple[camctl.ExposureSetting, ...]) -> Iterator[camctl.Frame]:
        for index, setting in enumerate(settings):  # the base class has checked all of them
            self.clock.sleep_until(self.clock.now() + setting.time_s)
            row = np.minimum(256 * self._light * setting.time_s, 255).astype(np.uint8)
            pixels, applied = np.tile(row, (48, 1)), setting  # read both from a real device
            yield camctl.Frame(pixels, setting, applied, self.clock.now(), index, 0, 255)

    def preview(self, setting: camctl.ExposureSetting) -> camctl.Frame:
        (frame,) = self.shoot([setting])
        return frame


class ExampleBackend:
    about = "an example of a driver: a gradient of light"

    def discover(self, *, probe: bool = False) -> list[camctl.CameraInfo]:
        return [ExampleCamera(address).info for address in LIGHT]

    def open(self, address: str, options: Mapping[str, Any]) -> ExampleCamera:
        if address not in LIGHT:
            raise camctl.CameraNotFoundError(f"no camera example:{address}", hint="try bright")
        camctl.BackendOptions.parse(options)  # none yet: options are fields of a subclass
        return ExampleCamera(address).open()
