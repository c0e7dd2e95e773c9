"""Raw photographs of a camera whose colours are known, in DNG files."""

from __future__ import annotations

import io
from fractions import Fraction
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from camctl.interface.colour import BT709_PRIMARIES, D65, rgb_to_xyz

#: From CIE XYZ to R, G and B of a Canon EOS 5D Mark II (Adobe DNG Converter, D65).
XYZ_TO_CAMERA = np.array(
    [[0.4716, 0.0603, -0.0830], [-0.7798, 1.5474, 0.2480], [-0.1496, 0.1937, 0.6651]]
)
#: R, G and B of neutral light, relative to green.
NEUTRAL = np.array([0.48, 1.0, 0.62])
BLACK, WHITE = 512, 15000


def camera_rgb(light: NDArray[Any]) -> NDArray[np.float64]:
    """Return R, G and B of linear BT.709 light, (rows, columns, 3)."""
    matrix = XYZ_TO_CAMERA @ rgb_to_xyz(BT709_PRIMARIES, D65)
    return np.asarray(light @ (matrix / matrix.sum(axis=1, keepdims=True)).T * NEUTRAL)


def mosaic(light: NDArray[Any], time_s: float, seed: int = 0) -> NDArray[np.uint16]:
    """Return an RGGB frame of linear BT.709 light with noise, full scale at irradiance 1 x 1 s."""
    E = camera_rgb(light) * time_s
    frame = E[..., 1].copy()
    frame[::2, ::2], frame[1::2, 1::2] = E[::2, ::2, 0], E[1::2, 1::2, 2]
    noise = np.random.default_rng((seed, int(time_s * 1e6))).normal(0, 3, frame.shape)
    samples = BLACK + np.maximum(frame, 0) * (WHITE - BLACK) + noise
    return np.clip(np.rint(samples), 0, WHITE).astype(np.uint16)


def raw_file(
    samples: NDArray[np.uint16],
    time_s: float,
    model: str = "Canon EOS 5D Mark II",
    *,
    orientation: int = 1,
) -> bytes:
    """Return a DNG file (version 1.4) with the matrix, the white balance and the exposure."""
    time = Fraction(time_s).limit_denominator(1 << 20)
    tags: list[Any] = [
        (271, 2, 0, model.split()[0], True),
        (272, 2, 0, model, True),
        (274, 3, 1, orientation, True),
        (33434, 5, 1, (time.numerator, time.denominator), True),
        (33437, 5, 1, (8, 1), True),
        (34855, 3, 1, 100, True),
        (50706, "B", 4, (1, 4, 0, 0), True),
        (50708, "s", 0, model, True),
        (33421, "H", 2, (2, 2), True),
        (33422, "B", 4, (0, 1, 1, 2), True),
        (50713, "H", 2, (2, 2), True),
        (50714, "H", 4, (BLACK,) * 4, True),
        (50717, "H", 1, (WHITE,), True),
        (50721, "2i", 9, [n for x in XYZ_TO_CAMERA.ravel() for n in (round(1e4 * x), 10000)], True),
        (50728, "2I", 3, [n for x in NEUTRAL for n in (round(1e4 * x), 10000)], True),
        (50778, "H", 1, 21, True),
    ]
    buffer = io.BytesIO()
    tifffile.imwrite(buffer, samples, metadata=None, photometric=32803, extratags=tags)
    return buffer.getvalue()
