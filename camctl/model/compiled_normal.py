"""Exponentials and normal probabilities in float32, compiled (extra `fast`).

Without branches and calls of C, so that loops over them are done side by side.
"""

from __future__ import annotations

import math

import numpy as np

from camctl.system.compiled_functions import compiler

_compiled = compiler(are_joined=True) or (lambda function: function)

_ZERO, _ONE, _HALF, _ROOT_HALF = (np.float32(x) for x in (0, 1, 0.5, math.sqrt(0.5)))
#: Whole powers of 2 are in the last bits of a number to which this is added; from there to the
#: bits of an exponent, which is larger by 127.
_SHIFT, _FRACTION = np.float32(3 << 22), np.uint32(23)
_BIAS = np.uint32((127 - int(_SHIFT.view(np.uint32))) % (1 << 32))
#: Logarithms: log2(e), and ln(2) in two parts, whose first one times a whole power is exact.
_LOG2_E, _LN2, _LN2_REST = (np.float32(x) for x in (math.log2(math.e), 0.693359375, -2.12194440e-4))
#: exp(-87) is nearly the least float32 of full precision.
_LEAST = np.float32(-87)

#: Coefficients of exp(x) for |x| < ln(2) / 2, from the 7th power (S. Moshier, Cephes, `expf`).
_EXPONENTIAL = (
    "1.98756915e-4 1.3981999507e-3 8.3334519073e-3 4.1665795894e-2 "
    "1.6666665459e-1 5.0000001201e-1 1 1"
)
#: Coefficients of ln(erfc(x) / t) + x^2 by t = 1 / (1 + x / 2), from the 9th power (W. Press et
#: al., Numerical Recipes in C, 1992, 6.2).
_ERROR_FUNCTION = (
    "0.17087277 -0.82215223 1.48851587 -1.13520398 0.27886807 "
    "-0.18628806 0.09678418 0.37409196 1.00002368 -1.26551223"
)
_OF_EXPONENTIAL, _OF_ERROR_FUNCTION = (
    tuple(map(np.float32, each.split())) for each in (_EXPONENTIAL, _ERROR_FUNCTION)
)


@_compiled
def exponential(x: np.float32) -> np.float32:
    """Return exp(x), x up to 80, to 2e-7 of it; 1e-38 stands for what is less."""
    x = max(x, _LEAST)
    shifted, found = np.float32(x * _LOG2_E + _SHIFT), _ZERO
    whole, power = shifted - _SHIFT, (shifted.view(np.uint32) + _BIAS) << _FRACTION
    x = (x - whole * _LN2) - whole * _LN2_REST
    for factor in _OF_EXPONENTIAL:
        found = found * x + factor
    return np.float32(found * np.uint32(power).view(np.float32))


@_compiled
def probability(x: np.float32) -> np.float32:
    """Return the normal distribution function, to 2e-5 of it where that is above 1e-32."""
    far = abs(x) * _ROOT_HALF
    t, found = _ONE / (_ONE + _HALF * far), _ZERO
    for factor in _OF_ERROR_FUNCTION:
        found = found * t + factor
    beyond = _HALF * t * exponential(found - far * far)
    return np.float32(_ONE - beyond if x > _ZERO else beyond)
