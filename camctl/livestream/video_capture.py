"""`camctl.VideoCapture`: the effective camera for programs that are written for OpenCV's class."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.errors import CamctlError, UsageError
from camctl.exposure.goal import CaptureRequest
from camctl.interface.controls import Layout
from camctl.livestream.display import Display, rgb_of_cells
from camctl.livestream.result import LiveResult
from camctl.livestream.stream import Live, live
from camctl.profiles.calibrated import open_camera
from camctl.system.picture_operations import opencv

#: Numbers of OpenCV's properties (videoio.hpp of 4 and of 5): CAP_PROP_POS_MSEC, FRAME_WIDTH,
#: FRAME_HEIGHT, FPS, POS_FRAMES, FORMAT and CONVERT_RGB.
_POS_MSEC, _WIDTH, _HEIGHT, _FPS, _POS_FRAMES, _FORMAT, _CONVERT_RGB = 0, 3, 4, 5, 1, 8, 16
#: Its apiPreference that leaves the choice of the backend open: CAP_ANY.
_ANY = 0


class VideoCapture:
    """Pictures in the desired response, with the methods of ``cv2.VideoCapture``.

    `read` gives BGR, of a camera without colours after ``set(CAP_PROP_CONVERT_RGB, 0)`` one
    channel, as OpenCV does.  Unlike OpenCV's, the property cannot be changed of a camera with
    colours, no other one can be set, and samples may have 16 bits.  Where OpenCV returns False this
    class does, too; `error` says why.

    Args:
        camera_id: see `camctl.open_camera`; a number, as of OpenCV, opens no camera
        apiPreference: CAP_ANY of OpenCV; with another one it is not opened, as the identifier says
            by which backend
        request: what the pictures are to be
        fps: results a second at least
        bits: of a sample, 8 or 16
        look: tone-mapped for looking, 8 bits, instead of the desired response
        options: of the camera

    Attributes:
        error: why the camera was not opened, or the last `read` failed; None: it did not
        result: of the last `grab` or `read`, with irradiance, standard deviation and mask

    >>> capture = VideoCapture("sim", options={"size": "64x48"})
    >>> ok, picture = capture.read()
    >>> ok, picture.shape, picture.dtype
    (True, (48, 64, 3), dtype('uint8'))
    >>> capture.release()
    """

    def __init__(
        self,
        camera_id: str | int = "sim",
        apiPreference: int = _ANY,
        *,
        request: CaptureRequest | None = None,
        fps: float | None = None,
        bits: int = 8,
        look: bool = False,
        options: Mapping[str, Any] | None = None,
    ) -> None:
        if bits not in (8, 16) or (look and bits != 8):
            raise UsageError(f"invalid bit depth {bits}: expected 8, or 16 without look")
        self._bits, self._display = bits, Display(look=look)
        self.error: CamctlError | None = None
        self.result: LiveResult | None = None
        self._resources = ExitStack()
        self._live: Live | None = None
        self._is_converted = True
        try:
            if not isinstance(camera_id, str):
                raise UsageError(
                    f"a camera has no number here, such as {camera_id}",
                    hint="name one by its identifier, such as v4l2:/dev/video0",
                )
            if apiPreference != _ANY:
                raise UsageError(
                    f"apiPreference {apiPreference!r} is not used here: expected CAP_ANY (0)",
                    hint="leave it out, as the identifier of a camera names its backend, and give "
                    "a request by its name, request=...",
                )
            camera = self._resources.enter_context(open_camera(camera_id, options))
            self._live = self._resources.enter_context(live(camera, request, fps=fps, reuse=True))
            self._shape = camera.controls.shape
        except CamctlError as error:
            self.error = error
            self.release()

    def isOpened(self) -> bool:  # noqa: N802
        """Return whether the camera is open."""
        return self._live is not None

    def grab(self) -> bool:
        """Wait for the next result; return whether there is one."""
        live = self._live
        if live is None:
            return False
        try:
            self.result = next(live)
        except StopIteration:  # another thread has released the camera
            return False
        except CamctlError as error:
            self.error = error
            return False
        return True

    def retrieve(self) -> tuple[bool, NDArray[Any] | None]:
        """Return the picture of the result that was grabbed last."""
        result = self.result
        if result is None or self._live is None:
            return False, None
        if self._bits == 8:
            picture: NDArray[Any] = self._display.picture(result)
        elif result.layout.is_mosaic:
            picture = rgb_of_cells(result.image, result.layout)
        else:
            picture = result.image
        if picture.ndim == 3:
            picture = picture[..., ::-1]
        elif self._is_converted:
            picture = np.broadcast_to(picture[..., None], (*picture.shape, 3))
        return True, np.array(picture, order="C")

    def read(self) -> tuple[bool, NDArray[Any] | None]:
        """Wait for the next result and return its picture; (False, None) at the end."""
        return self.retrieve() if self.grab() else (False, None)

    def get(self, property_id: int) -> float:
        """Return a property by OpenCV's number; 0 where it is not known."""
        live, result = self._live, self.result
        if live is None:
            return 0.0
        half = 2 if live.controls.layout.is_mosaic else 1
        has_colours = self._is_converted or live.controls.layout is not Layout.MONO
        values = {
            _WIDTH: self._shape[1] // half,
            _HEIGHT: self._shape[0] // half,
            _FPS: 0.0 if live.plan is None else live.planner.rate(live.plan.settings),
            _POS_MSEC: 0.0 if result is None else 1000 * result.time_s,
            _POS_FRAMES: 0 if result is None else result.number,
            _FORMAT: _sample_type(self._bits, 3 if has_colours else 1),
            _CONVERT_RGB: self._is_converted,
        }
        return float(values.get(property_id, 0.0))

    def set(self, property_id: int, value: float) -> bool:
        """Set CAP_PROP_CONVERT_RGB; return False for all that is set when opening."""
        live = self._live
        if live is None or property_id != _CONVERT_RGB or live.controls.layout is not Layout.MONO:
            return False
        self._is_converted = value != 0
        return True

    def release(self) -> None:
        """Close the camera; a second call does nothing."""
        self._live = None
        self._resources.close()


def _sample_type(bits: int, channels: int) -> int:
    """Return OpenCV's number of a type of samples: 4 and 5 count the channels in other bits of it.

    Without OpenCV it is that of 4.
    """
    cv2 = opencv()
    if cv2 is not None:
        return int(getattr(cv2, f"CV_{bits}UC{channels}"))
    return (0 if bits == 8 else 2) + 8 * (channels - 1)
