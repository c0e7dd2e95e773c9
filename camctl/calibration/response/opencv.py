"""The response by OpenCV's calibrations, for comparison: 8-bit frames only.

OpenCV gives the irradiance of each of 256 brightness values; a level lies between two of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.errors import DataError, UsageError
from camctl.interface.controls import Layout
from camctl.model.response.camera import FloatArray
from camctl.profiles.response import ChannelResponse, ResponseRecord
from camctl.system.picture_operations import required_opencv

#: Least relative rise from level to level, where OpenCV's curve does not ascend.
_LEAST_RISE = 1e-6


def opencv_response(
    frames: Sequence[NDArray[Any]], exposures: Sequence[float], layout: Layout, method: str
) -> ResponseRecord:
    """Return the response that OpenCV finds, made ascending where it is not.

    Args:
        frames: (rows, columns) or (rows, columns, 3) uint8, of one size
        exposures: of the frames
        layout: pixel layout, mono or RGB
        method: debevec or robertson

    Raises:
        UsageError: the frames are not 8-bit mono or RGB
        DataError: OpenCV's result is not finite
    """
    if any(frame.dtype != np.uint8 for frame in frames) or layout.is_mosaic:
        raise UsageError(
            f"OpenCV's {method.capitalize()} takes 8-bit mono and RGB frames only",
            hint="use the method camctl",
            remedies={"method": "camctl"},
        )
    curves = opencv_curves(frames, exposures, method)
    if not np.all(np.isfinite(curves)):
        raise DataError(
            f"OpenCV's {method.capitalize()} returned a curve with NaN or infinity",
            hint="use the method camctl, or other frames",
            remedies={"method": "camctl"},
        )
    names = ("Y",) if layout is Layout.MONO else ("R", "G", "B")
    channels = []
    for name, curve in zip(names, curves.T, strict=True):
        between = np.sqrt(np.maximum(curve[1:] * curve[:-1], 1e-12))
        rising = np.maximum.accumulate(between) * (1 + _LEAST_RISE * np.arange(1, 256))
        top = rising[-1] ** 2 / rising[-2]
        channels.append(
            ChannelResponse(
                name=name,
                black=0,
                white=255,
                saturates=any(bool(np.any(frame == 255)) for frame in frames),
                irradiance=(0.0, *(rising / top).tolist(), 1.0),
                brightness=tuple((np.arange(257) / 256).tolist()),
                deviation=None,
                measured=(0.0, 1.0),
            )
        )
    return ResponseRecord(
        channels=tuple(channels),
        phase=0.0,
        frames=len(frames),
        measured_at=datetime.now(UTC).isoformat(timespec="seconds"),
    )


def opencv_curves(
    frames: Sequence[NDArray[Any]], exposures: Sequence[float], method: str
) -> FloatArray:
    """Return OpenCV's irradiance of each brightness, (256, channels)."""
    cv2 = required_opencv(f"the method {method}")

    calibration: Any = (
        cv2.createCalibrateDebevec() if method == "debevec" else cv2.createCalibrateRobertson()
    )
    channels = 1 if frames[0].ndim == 2 else 3
    images = list(frames)
    if method == "robertson" and channels == 1:  # it takes three channels only
        images = [np.repeat(frame[:, :, None], 3, axis=2) for frame in images]
    try:
        found = calibration.process(images, np.array(exposures, np.float32))
    except cv2.error as error:
        raise DataError(
            f"OpenCV's {method.capitalize()} failed: {error.err}",
            hint="use the method camctl",
            remedies={"method": "camctl"},
        ) from None
    return np.asarray(found, np.float64).reshape(256, -1)[:, :channels]
