"""CIE 1976 L*a*b* and the colour difference CIEDE2000."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_Floats = NDArray[np.float64]

#: Where the cube root of L*a*b* becomes a straight line, and the line (CIE 15:2004, 8.2.1).
_LINEAR, _SLOPE, _OFFSET = (6 / 29) ** 3, (29 / 6) ** 2 / 3, 4 / 29


def lab_of_xyz(xyz: _Floats, white: _Floats) -> _Floats:
    """Return L*, a*, b* of X, Y, Z, (..., 3); `white` is X, Y, Z of a perfect white.

    >>> lab_of_xyz(np.array([0.2, 0.2, 0.2]), np.ones(3)).round(4).tolist()
    [51.8372, 0.0, 0.0]
    """
    share = xyz / white
    root = np.where(share > _LINEAR, np.cbrt(share), share * _SLOPE + _OFFSET)
    x, y, z = np.moveaxis(root, -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


def xyz_of_lab(lab: _Floats, white: _Floats) -> _Floats:
    """Return X, Y, Z of L*, a*, b*, (..., 3), see `lab_of_xyz`."""
    lightness, a, b = np.moveaxis(lab, -1, 0)
    y = (lightness + 16) / 116
    root = np.stack([y + a / 500, y, y - b / 200], axis=-1)
    share = np.where(root > 6 / 29, root**3, (root - _OFFSET) / _SLOPE)
    return np.asarray(share * white)


def ciede2000(one: _Floats, other: _Floats) -> _Floats:
    """Return the colour difference CIEDE2000 of two colours in L*, a*, b*, (..., 3).

    Sharma, Wu and Dalal, Color Research and Application 30 (2005), equations 2 to 22; the weights
    of lightness, chroma and hue are 1.
    """
    lightness1, a1, b1 = np.moveaxis(np.asarray(one, np.float64), -1, 0)
    lightness2, a2, b2 = np.moveaxis(np.asarray(other, np.float64), -1, 0)
    mean = ((np.hypot(a1, b1) + np.hypot(a2, b2)) / 2) ** 7
    stretch = 1.5 - 0.5 * np.sqrt(mean / (mean + 25.0**7))
    a1, a2 = a1 * stretch, a2 * stretch
    chroma1, chroma2 = np.hypot(a1, b1), np.hypot(a2, b2)
    hue1, hue2 = (np.arctan2(b, a) % (2 * np.pi) for a, b in ((a1, b1), (a2, b2)))
    is_grey = chroma1 * chroma2 == 0
    turn = (hue2 - hue1 + np.pi) % (2 * np.pi) - np.pi
    turn = np.where(np.isclose(np.abs(hue2 - hue1), np.pi, rtol=0, atol=1e-12), hue2 - hue1, turn)
    turn = np.where(is_grey, 0.0, turn)
    hue_step = 2 * np.sqrt(chroma1 * chroma2) * np.sin(turn / 2)
    far = np.abs(hue1 - hue2) > np.pi + 1e-12
    hue = (hue1 + hue2) / 2 + np.where(far, np.where(hue1 + hue2 < 2 * np.pi, np.pi, -np.pi), 0.0)
    hue = np.where(is_grey, hue1 + hue2, hue)
    lightness, chroma = (lightness1 + lightness2) / 2, (chroma1 + chroma2) / 2
    weight = (
        1
        - 0.17 * np.cos(hue - np.radians(30))
        + 0.24 * np.cos(2 * hue)
        + 0.32 * np.cos(3 * hue + np.radians(6))
        - 0.20 * np.cos(4 * hue - np.radians(63))
    )
    off = (lightness - 50) ** 2
    of_lightness = (lightness2 - lightness1) / (1 + 0.015 * off / np.sqrt(20 + off))
    of_chroma = (chroma2 - chroma1) / (1 + 0.045 * chroma)
    of_hue = hue_step / (1 + 0.015 * chroma * weight)
    blue = np.radians(60) * np.exp(-(((np.degrees(hue) - 275) / 25) ** 2))
    rotation = -2 * np.sqrt(chroma**7 / (chroma**7 + 25.0**7)) * np.sin(blue)
    square = of_lightness**2 + of_chroma**2 + of_hue**2 + rotation * of_chroma * of_hue
    return np.asarray(np.sqrt(square))
