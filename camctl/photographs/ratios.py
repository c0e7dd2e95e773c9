"""How many times as bright one photograph is as another one, whatever exposures they state.

The brightest patches that neither of the two saturates say it: in dark ones rounding and the
lowest levels of a response make errors.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.patches import LightScale, Patches

#: Patches are compared up to this share of full scale.
_HIGHEST = 0.95
#: Brightness that a patch has at least in the darker photograph, as shares of full scale: the first
#: one that leaves so large a share of the patches as one of the second numbers; and fewest patches.
_BRIGHT, _SHARES, _LEAST = (1 / 8, 1 / 16, 1 / 32, 1 / 64, 1 / 100), (0.1, 0.03, 0.005), 12
#: Error of the mean brightness of a patch, levels of 8 bits: rounding, black level, JPEG.
_ERROR = 0.5
#: Patches agree within this logarithm of a ratio and their error; of those compared so many do.
_ALIKE, _MAJORITY = 0.15, 0.6


class PairRatio(NamedTuple):
    """The ratio of the light in two photographs.

    Attributes:
        log: logarithm of that of the second one over that of the first
        error: largest error of it from rounding and black level
    """

    log: float
    error: float


def pair_ratio(first: Patches, second: Patches, scale: LightScale) -> PairRatio | None:
    """Return the ratio of the light in most patches of two photographs; None: they do not show it.

    Args:
        first: patches of one photograph, see `sample_patches`
        second: those of the other
        scale: irradiance of each brightness
    """
    span = scale.white - scale.black
    dim = np.full(len(first), np.inf)
    logs: NDArray[np.float64] = np.zeros(len(first))
    errors = np.zeros(len(first))
    for patches, sign in ((first, -1), (second, 1)):
        is_whole = patches.max(axis=1) <= scale.black + _HIGHEST * span
        mean = patches.mean(axis=1)
        dim = np.where(is_whole, np.minimum(dim, (mean - scale.black) / span), -1.0)
        light = np.maximum(scale.light[patches].mean(axis=1), scale.level / 1000)
        logs += sign * np.log(light)
        slope = scale.gap[np.rint(mean).astype(np.intp)] * span / 255
        errors += _ERROR * slope / light
    sets = [dim >= least for least in _BRIGHT]
    needed = [max(_LEAST, share * dim.size) for share in _SHARES]
    found = [use for least in needed for use in sets if np.count_nonzero(use) >= least]
    if not found:
        return None
    use = found[0]
    log, error = float(np.median(logs[use])), float(np.median(errors[use]))
    is_one = np.mean(np.abs(logs[use] - log) < _ALIKE + error) >= _MAJORITY
    return PairRatio(log, error) if is_one else None
