"""Levels from the curves of OpenCV's calibrations."""

from __future__ import annotations

import numpy as np

from camctl.model.response.camera import FloatArray


def levels_of(curve: FloatArray) -> FloatArray:
    """Return levels from OpenCV's irradiance of each brightness: between two of them."""
    return np.asarray(np.sqrt(np.maximum(curve[1:] * curve[:-1], 1e-12)))
