"""picture.avif: the light of the preview for HDR displays, in PQ.

AVIF with ten bits, the primaries of BT.709 and the transfer of SMPTE ST 2084 (PQ), which codes
absolute luminance up to 10,000 cd/m2: the white of a preview has 203 (ITU-R BT.2408).  A step of
the code is 0.9 to 3 % of the light between 0.2 and 10,000 cd/m2.
"""

from __future__ import annotations

from functools import lru_cache
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from camctl.system.picture_operations import as_halves, looked_up

#: Luminance of PQ's full scale, and of the white of a preview, cd/m2.
_FULL, _WHITE = 10_000.0, 203.0
#: m1, m2, c1, c2, c3 of SMPTE ST 2084.
_M1, _M2 = 2610 / 16384, 2523 / 4096 * 128
_C1, _C2, _C3 = 3424 / 4096, 2413 / 4096 * 32, 2392 / 4096 * 32
_BITS = 10
#: CICP (ITU-T H.273): primaries and matrix of BT.709, transfer of PQ.
_BT709, _PQ = 1, 16
#: Quality of 100, and speed of 10: with 99, compression changes the light of the photographs of a
#: street by 1.0 % (median) and less than 3 % (90 % of the samples), with 95 by twice as much; a
#: slower encoder makes the file 0.3 % smaller.
_QUALITY, _SPEED = 99, 10


def avif_library() -> ModuleType | None:
    """Return imagecodecs, where it is installed and writes AVIF."""
    try:
        import imagecodecs
    except ImportError:
        return None
    return imagecodecs if imagecodecs.AVIF.available else None


def picture_in_pq(light: NDArray[np.float32], imagecodecs: ModuleType) -> bytes:
    """Return the content of picture.avif.

    Args:
        light: linear, 1 = white of a preview, (rows, columns, 1 or 3)
        imagecodecs: the library
    """
    # float16 has eleven bits of each light, which is exact to a fifth of a step; its bits are the
    # place in the table.
    with np.errstate(over="ignore"):
        halves = as_halves(light.reshape(len(light), -1))
    codes = looked_up(_codes(), halves.view(np.uint16)).reshape(light.shape)
    coded: bytes = imagecodecs.avif_encode(
        np.dstack((codes,) * (3 // light.shape[2])),
        level=_QUALITY,
        speed=_SPEED,
        bitspersample=_BITS,
        # Of a picture without colours only the luma is stored: a third of the time and memory less.
        pixelformat="400" if light.shape[2] == 1 else "444",
        primaries=_BT709,
        transfer=_PQ,
        matrix=_BT709,
    )
    return coded


@lru_cache(maxsize=1)
def _codes() -> NDArray[np.uint16]:
    """Return the code of each float16 by its bits; light below 0 is black."""
    light = np.arange(1 << 16, dtype=np.uint16).view(np.float16).astype(np.float64)
    share = np.clip(np.nan_to_num(light, nan=0.0) * (_WHITE / _FULL), 0, 1) ** _M1
    coded = ((_C1 + _C2 * share) / (1 + _C3 * share)) ** _M2
    return np.rint(coded * ((1 << _BITS) - 1)).astype(np.uint16)
