"""The effective camera live, as the menu shows it while it waits: picture, histogram and rate.

The stream goes on between two looks, so that the next one is there at once.  It ends by itself
where nobody looks any more, and before anything else is done with the camera.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from camctl.exposure.goal import AUTO, CaptureRequest
from camctl.exposure.light import Metering, counts_in_stops
from camctl.interface.camera import Camera, Frame
from camctl.interface.clock import VirtualClock
from camctl.interface.controls import ExposureControls
from camctl.interface.cycle import CyclingCamera
from camctl.menu.data import Picture, Reading
from camctl.menu.thumbnails import BINS, COLUMNS, ROWS, focus_value

if TYPE_CHECKING:  # a camera that does not stream does not load it
    from camctl.livestream.planning import Look
    from camctl.livestream.result import LiveResult
    from camctl.livestream.stream import Live

#: Time without a look after which the stream ends, s: some rests of the menu between two of them.
_UNSEEN_S = 10.0
#: Pictures whose rate is stated.
_RATED = 8
#: Range of the histogram, stops below the saturation of the shortest exposure.
_STOPS = 16


class Sight(Protocol):
    """Shows what the camera sees in all its size.

    Arrays of a result are overwritten by the next one; those of a frame are not.
    """

    def show_frame(self, frame: Frame, controls: ExposureControls, metered: Metering) -> None:
        """Take a metering frame."""

    def show_result(self, result: LiveResult, seen: Look, controls: ExposureControls) -> None:
        """Take a picture of the effective camera, and the light that it shows."""


class LiveView:
    """Shows one camera after the other; any thread may end it.

    Args:
        sight: gets each picture, too
    """

    def __init__(self, sight: Sight | None = None) -> None:
        self._sight = sight
        self._lock = threading.RLock()
        self._live: Live | None = None
        self._timer: threading.Timer | None = None
        self._times: deque[float] = deque(maxlen=_RATED)

    @staticmethod
    def suits(camera: Camera, request: CaptureRequest) -> bool:
        """Return whether a camera streams, in real time."""
        return (
            isinstance(camera, CyclingCamera)
            and not isinstance(camera.clock, VirtualClock)
            and request.response != AUTO
        )

    def reading(self, camera: Camera, request: CaptureRequest, reading: Reading) -> Reading:
        """Return `reading` with what the camera shows now.

        Raises:
            CaptureError: the light cannot be measured
            UsageError: the camera has no exposures for the request
            CameraError: as the camera raises
        """
        from camctl.livestream.planning import Look
        from camctl.livestream.stream import live

        with self._lock:
            self._cancel_timer()
            if self._live is None:
                self._times.clear()
                # A camera that is gone is opened again by the menu.
                self._live = live(camera, request, reuse=True, patience_s=0.0)
            try:
                result = next(self._live)
            except BaseException:
                self.end()
                raise
            self._times.append(time.monotonic())
            self._timer = threading.Timer(_UNSEEN_S, self.end)
            self._timer.daemon = True
            self._timer.start()
            seen = Look.at(result.sum, result.layout, result.tables)
            if self._sight is not None:
                self._sight.show_result(result, seen, camera.controls)
            edges = np.linspace(-_STOPS, 0, BINS + 1)
            counts = counts_in_stops(seen.irradiance, seen.shares, edges)
            return replace(
                reading,
                time_s=min(each.time_s for each in result.plan.settings),
                clipped=seen.clipped,
                histogram=tuple(counts.tolist()),
                picture=_picture(result),
                rate=self._rate(),
                focus=focus_value(result.layout.planes(result.sum)[0]),
            )

    def end(self) -> None:
        """End the stream; the camera can shoot."""
        with self._lock:
            self._cancel_timer()
            live, self._live = self._live, None
            if live is not None:
                live.close()

    def _cancel_timer(self) -> None:
        timer, self._timer = self._timer, None
        if timer is not None:
            timer.cancel()

    def _rate(self) -> float:
        """Return pictures a second; 0 for the first."""
        span_s = self._times[-1] - self._times[0]
        return (len(self._times) - 1) / span_s if span_s > 0 else 0.0


def _picture(result: LiveResult) -> Picture:
    """Return the picture of a result in the desired response, small."""
    from camctl.livestream.display import Display

    rows, columns = result.sum.shape[:2]
    most = max(1, min(COLUMNS, ROWS * columns // rows))
    shown = Display(most=most).picture(result)
    rgb = shown if shown.ndim == 3 else np.repeat(shown[..., np.newaxis], 3, axis=2)
    return Picture(rgb.shape[1], rgb.shape[0], np.ascontiguousarray(rgb).tobytes())
