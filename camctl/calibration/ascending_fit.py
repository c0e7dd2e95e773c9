"""The least squares fit of a curve that must ascend."""

from __future__ import annotations

import numpy as np

from camctl.model.response.camera import FloatArray

#: Least slope of ln E against ln x.
_LEAST_SLOPE = 0.02


def ascending(
    square: FloatArray, product: FloatArray, curve: FloatArray, base: FloatArray
) -> FloatArray:
    """Return c of least c' square c / 2 - product' c, such that curve c + base ascends.

    Steps at which the solution descends become conditions, until there are none.  Hildreth's
    method solves the dual problem: one multiplier >= 0 for each condition.
    """
    inverse = np.linalg.inv(square)
    free = found = np.asarray(inverse @ product)
    rises = np.diff(curve, axis=0)
    least = (_LEAST_SLOPE - 1) * np.diff(base)
    active = np.zeros(least.size, bool)
    for _ in range(least.size):
        descending = rises @ found < least - 1e-9
        if not np.any(descending & ~active):
            break
        active |= descending
        conditions = rises[active]
        effect = inverse @ conditions.T
        gram = conditions @ effect
        lack = least[active] - conditions @ free
        multipliers = np.zeros(lack.size)
        for _ in range(200):
            for k in range(lack.size):
                step = (lack[k] - gram[k] @ multipliers) / gram[k, k]
                multipliers[k] = max(0.0, multipliers[k] + step)
        found = free + effect @ multipliers
    # What the iteration leaves is removed with certainty: h = 0 ascends with slope 1.
    rise, most = rises @ found, (1 - _LEAST_SLOPE / 2) * np.diff(base)
    falls = rise < -most
    return found * float(np.min(most[falls] / -rise[falls], initial=1.0))
