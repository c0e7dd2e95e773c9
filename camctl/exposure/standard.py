"""Real cameras with responses from standards, as levels in closed form."""

from __future__ import annotations

import math

import numpy as np

from camctl.errors import UsageError, unknown_name
from camctl.exposure.real import (
    FloatArray,
    RealResponse,
    check_quantiser,
    linear_response,
    quantiser_name,
)

STANDARDS: tuple[str, ...] = ("linear", "srgb", "rec709", "power")


def srgb_to_linear(B: FloatArray) -> FloatArray:
    """Return irradiance for sRGB brightness, both 0..1 (IEC 61966-2-1)."""
    return np.where(B <= 0.04045, B / 12.92, ((B + 0.055) / 1.055) ** 2.4)


def rec709_to_linear(B: FloatArray) -> FloatArray:
    """Return irradiance for Rec.709 brightness, both 0..1 (ITU-R BT.709, inverse camera curve)."""
    return np.where(B < 0.081, B / 4.5, ((B + 0.099) / 1.099) ** (1 / 0.45))


def standard_response(
    name: str,
    bits: int = 8,
    *,
    phase: float = 0.0,
    levels: int | None = None,
    gamma: float = 2.2,
) -> RealResponse:
    """Return the camera with a standard's response: E_k = B^-1((k - phase) / (M + 1)).

    `name` is one of `STANDARDS`; "power" is B = E^(1/gamma).  Raises `UsageError`.

    >>> standard_response("power", 2, gamma=2.0).levels.tolist()
    [0.0625, 0.25, 0.5625]
    """
    if name == "linear":
        return linear_response(bits, phase=phase, levels=levels)
    count = check_quantiser(bits, phase, levels)
    B = (np.arange(1, count + 1, dtype=np.float64) - phase) / (count + 1)
    label = name
    if name == "srgb":
        ladder = srgb_to_linear(B)
    elif name == "rec709":
        ladder = rec709_to_linear(B)
    elif name == "power":
        if not (math.isfinite(gamma) and 0.05 <= gamma <= 20):
            raise UsageError(f"power 1/{gamma:g}", hint="gamma lies between 0.05 and 20")
        ladder = B**gamma
        label = f"power 1/{gamma:g}"
    else:
        raise unknown_name("camera response", name, STANDARDS)
    return RealResponse(ladder, quantiser_name(label, bits, phase, count))
