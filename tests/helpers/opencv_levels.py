"""The response by OpenCV's calibrations, to compare with, and levels from it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from camctl.model.response.camera import FloatArray


def opencv_curves(
    frames: Sequence[NDArray[Any]], exposures: Sequence[float], method: str
) -> FloatArray:
    """Return OpenCV's irradiance of each brightness of 8-bit frames, (256, channels).

    Args:
        frames: (rows, columns) or (rows, columns, 3) uint8
        exposures: of the frames
        method: debevec or robertson
    """
    methods: dict[str, Any] = {
        "debevec": cv2.createCalibrateDebevec,
        "robertson": cv2.createCalibrateRobertson,
    }
    found = methods[method]()
    channels = 1 if frames[0].ndim == 2 else 3
    images = list(frames)
    if method == "robertson" and channels == 1:  # it takes three channels only
        images = [np.repeat(frame[:, :, None], 3, axis=2) for frame in images]
    curves = found.process(images, np.array(exposures, np.float32))
    return np.asarray(curves, np.float64).reshape(256, -1)[:, :channels]


def levels_of(curve: FloatArray) -> FloatArray:
    """Return levels from OpenCV's irradiance of each brightness: between two of them."""
    return np.asarray(np.sqrt(np.maximum(curve[1:] * curve[:-1], 1e-12)))
