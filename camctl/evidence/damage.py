"""Parts of a frame that were damaged on their way from the camera: their samples are any codes.

Optics spread the light of each point, so that neighbouring samples of a scene depend on each other.
Where the samples of a patch depend neither on their neighbours nor on the same samples of the other
frames, and all codes being as probable explains them better than any normal distribution does, they
are not of a picture.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.patch_errors import LEAST_PATCHES
from camctl.evidence.patches import Patches
from camctl.evidence.ratio_check import SIGNIFICANCE

#: Standard deviation, as a share of the number of codes, at which a normal distribution of that
#: width has the entropy of a uniform one.
_UNIFORM = 1 / math.sqrt(2 * math.pi * math.e)

_Floats = NDArray[np.float64]


def damaged_share(frame: Patches, others: Sequence[Patches], codes: int) -> float:
    """Return which share of a frame, by its patches, shows no scene; 0.0 where it is no part.

    Args:
        frame: patches of the frame
        others: of the frames beside it
        codes: number of the codes that a sample has
    """
    side = math.isqrt(frame.shape[1])
    wide = np.flatnonzero(frame.std(axis=1) > _UNIFORM * codes)
    if wide.size < LEAST_PATCHES or side < 2:
        return 0.0
    rest = _without_mean(frame[wide])
    squares = rest.reshape(-1, side, side)
    product = (squares[:, :, 1:] * squares[:, :, :-1]).sum(axis=(1, 2))
    product += (squares[:, 1:] * squares[:, :-1]).sum(axis=(1, 2))
    variance = np.square(rest).mean(axis=1)
    random = _is_chance(product / variance, 2 * side * (side - 1))
    for other in others:
        same = _without_mean(other[wide])
        spread = np.maximum(np.sqrt(np.square(same).mean(axis=1)), 1e-9)  # 0 where it is flat
        random &= _is_chance((rest * same).sum(axis=1) / np.sqrt(variance) / spread, side**2)
    found = np.count_nonzero(random)
    return found / len(frame) if found >= LEAST_PATCHES else 0.0


def _without_mean(patches: Patches) -> _Floats:
    return np.asarray(patches - patches.mean(axis=1, keepdims=True))


def _is_chance(products: _Floats, pairs: int) -> NDArray[np.bool_]:
    """Return which sums of so many products of independent variables of variance 1 are by chance.

    Their standard deviation is the root of the number.
    """
    limit = -NormalDist().inv_cdf(SIGNIFICANCE / 2) * math.sqrt(pairs)
    return np.abs(products) <= limit
