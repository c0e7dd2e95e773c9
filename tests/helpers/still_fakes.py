"""A still camera for tests: a dial of third stops, no preview, its own files, slow downloads."""

from __future__ import annotations

from collections.abc import Generator, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from camctl.camera import CameraInfo, Closing, Frame, FrameStream, OriginalFile
from camctl.clock import VirtualClock
from camctl.controls import Choices, ExposureControls, ExposureSetting, Layout
from camctl.errors import CameraDisconnectedError
from camctl.response.camera import standard_response

DOWNLOAD_S = 0.75
THIRDS = Choices(tuple(2.0 ** (k / 3) for k in range(-36, 16)))
APERTURES = Choices(tuple(2.0 ** (k / 6) for k in range(9, 25)))
SPEEDS = Choices(tuple(2.0 ** (k / 3) for k in range(13)))


class StillCamera(Closing):
    """Counts its actuations; `response` "srgb" makes 8-bit files, "linear" raw ones of `bits`.

    `light` is irradiance, (rows, columns), full scales a second at gain 1 and, with an aperture,
    f/1.
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
        serial: str = "77",
    ) -> None:
        self._light, self._response = light, response
        self.info = CameraInfo(f"ptp:{serial}", "Make", "Still 5", serial, "ptp")
        self.clock = VirtualClock()
        white = (1 << bits) - 1
        self.controls = ExposureControls(
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
        )
        self.actuations = 0
        self._is_open = True

    def shoot(self, settings: Sequence[ExposureSetting]) -> FrameStream:
        """Expose and download one after another."""
        if not self._is_open:
            raise CameraDisconnectedError("the still camera is closed", hint="open it again")
        for setting in settings:
            self.controls.check(setting)
        return self._frames(tuple(settings))

    def _frames(self, settings: tuple[ExposureSetting, ...]) -> Generator[Frame, None, None]:
        for index, setting in enumerate(settings):
            self.actuations += 1
            self.clock.sleep_until(self.clock.now() + setting.time_s)
            ended = self.clock.now()
            self.clock.sleep_until(ended + DOWNLOAD_S)
            pixels = self._expose(setting.exposure)
            data = cv2.imencode(".png", pixels)[1].tobytes()
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

    def _expose(self, exposure: float) -> NDArray[np.uint8] | NDArray[np.uint16]:
        controls = self.controls
        levels = controls.levels.levels
        brightness = np.searchsorted(levels, self._light * exposure, side="right")
        kind = np.uint8 if controls.bits <= 8 else np.uint16
        return (brightness + controls.black).astype(kind)

    def close(self) -> None:
        """Let go of it."""
        self._is_open = False


def ramp(brightest: float = 1.0, span: float = 1000.0) -> NDArray[np.float64]:
    """Return light that falls from `brightest` to 1 / `span` of it, evenly in its logarithm."""
    return np.geomspace(brightest, brightest / span, 48 * 64).reshape(48, 64)
