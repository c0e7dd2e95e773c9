"""A still camera for tests: times in third stops, no preview, its own files, slow downloads."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from camctl.interface.camera import CameraBase, CameraInfo, Frame, OriginalFile, Pixels
from camctl.interface.clock import VirtualClock
from camctl.interface.controls import (
    Choices,
    ExposureControls,
    ExposureSetting,
    Layout,
    ResponseOrigin,
)
from camctl.model.response.camera import standard_response
from camctl.system.picture_operations import png

DOWNLOAD_S = 0.75
THIRDS = Choices(tuple(2.0 ** (k / 3) for k in range(-36, 16)))
APERTURES = Choices(tuple(2.0 ** (k / 6) for k in range(9, 25)))
SPEEDS = Choices(tuple(2.0 ** (k / 3) for k in range(13)))


class StillCamera(CameraBase):
    """A noise-free still camera that counts its actuations.

    Args:
        light: irradiance, (rows, columns), full scales a second at gain 1 and, with an aperture,
            f/1
        response: "srgb" for 8-bit files, "linear" for raw files of `bits` bits
        bits: a sample
        black: black level, DN
        times: shutter times
        with_aperture: the aperture can be set
        with_gain: the gain can be set
    """

    def __init__(
        self,
        light: NDArray[np.floating],
        *,
        response: str = "srgb",
        bits: int = 8,
        black: int = 0,
        times: Choices = THIRDS,
        with_aperture: bool = False,
        with_gain: bool = False,
    ) -> None:
        super().__init__("the still camera", VirtualClock())
        self._light = light
        white = (1 << bits) - 1
        self._info = CameraInfo("ptp:77", "Make", "Still 5", "77", "ptp")
        self._controls = ExposureControls(
            time_s=times,
            shape=light.shape,
            layout=Layout.MONO,
            bits=bits,
            gain=SPEEDS if with_gain else Choices((1.0,)),
            f_number=APERTURES if with_aperture else None,
            black=black,
            white=white,
            response=standard_response(response, bits, levels=white - black),
            delay_frames=0,
            frame_interval_s=DOWNLOAD_S,
            response_origin=ResponseOrigin.STATED,
        )
        self.actuations = 0

    def _open(self) -> None:
        pass

    def _close(self) -> None:
        pass

    def _frames(self, settings: tuple[ExposureSetting, ...]) -> Iterator[Frame]:
        """Expose and download one after another."""
        for index, setting in enumerate(settings):
            self.actuations += 1
            self.clock.sleep_until(self.clock.now() + setting.time_s)
            ended = self.clock.now()
            self.clock.sleep_until(ended + DOWNLOAD_S)
            pixels = self._expose(setting.exposure)
            data = png(pixels)
            yield Frame(
                pixels=pixels,
                requested=setting,
                applied=setting,
                timestamp_s=ended,
                index=index,
                black=self.controls.black,
                white=self.controls.white,
                original=OriginalFile(".png", data),
            )

    def _expose(self, exposure: float) -> Pixels:
        controls = self.controls
        brightness = np.searchsorted(controls.levels.levels, self._light * exposure, side="right")
        pixels = (brightness + controls.black).astype(np.uint16)
        return pixels if controls.bits > 8 else pixels.astype(np.uint8)


def ramp(brightest: float = 1.0, span: float = 1000.0) -> NDArray[np.float64]:
    """Return light that falls from `brightest` to 1 / `span` of it, evenly in its logarithm."""
    return np.geomspace(brightest, brightest / span, 48 * 64).reshape(48, 64)
