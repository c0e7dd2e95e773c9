"""Numbers as people read them, the same in texts, pictures and pages: ranges, times, shares."""

from __future__ import annotations

import math
from fractions import Fraction

#: Times of this and longer are written in seconds, shorter ones as a fraction.
_FRACTIONS_BELOW_S = 0.3
#: Exponents of the powers of ten that are written in full.
_FULL_POWERS = range(-3, 5)


def range_text(dynamic_range: float) -> str:
    """Return a dynamic range: in whole numbers, small ones with the digits that matter.

    >>> range_text(4096.0), range_text(131072.0), range_text(1.5), range_text(math.inf)
    ('1:4,096', '1:131,072', '1:1.5', 'unlimited')
    >>> range_text(1.001), range_text(1 + 1e-7)
    ('1:1.001', '1:1.0000001')
    """
    if math.isinf(dynamic_range):
        return "unlimited"
    if 1 < dynamic_range < 1.01:  # three digits of what it is above 1
        digits = min(17, 3 - math.floor(math.log10(dynamic_range - 1)))
        return f"1:{dynamic_range:.{digits}g}"
    number = float(f"{dynamic_range:.9g}")
    return f"1:{number:,.0f}" if number >= 100 else f"1:{number:.3g}"


def time_of(text: str) -> float | Fraction | None:
    """Return the time in s that a text states, a `Fraction` where it is typed as one.

    None where it states no finite time above 0.

    >>> time_of("1/250"), time_of("0.5"), time_of("1/0"), time_of("x")
    (Fraction(1, 250), 0.5, None, None)
    """
    numerator, slash, denominator = text.partition("/")
    try:
        value, divisor = float(numerator), float(denominator) if slash else 1.0
    except ValueError:
        return None
    if not (value > 0 and divisor > 0 and 0 < value / divisor < math.inf):
        return None
    return Fraction(value) / Fraction(divisor) if slash else value


def time_text(seconds: float) -> str:
    """Return a shutter time as photographers write it.

    >>> time_text(0.004), time_text(0.5), time_text(0.15), time_text(3600.0)
    ('1/250 s', '0.5 s', '1/6.7 s', '3600 s')
    """
    if seconds >= _FRACTIONS_BELOW_S:
        return f"{seconds:.3g} s" if seconds < 100 else f"{seconds:.0f} s"
    return f"1/{1 / seconds:.0f} s" if seconds < 1 / 10 else f"1/{1 / seconds:.2g} s"


def percent_text(share: float) -> str:
    """Return a share in per cent; a small one is not shown as none.

    >>> percent_text(0.5), percent_text(0.0), percent_text(1e-6)
    ('50 %', '0 %', '< 0.01 %')
    """
    if 0 < share < 1e-4:
        return "< 0.01 %"
    return f"{100 * share:.3g} %"


def power_texts(first: int, last: int) -> list[str]:
    """Return the powers of ten of an axis, all written alike but for 1.

    >>> power_texts(-2, 1), power_texts(-1, 5)[:3], power_texts(4, 6)
    (['0.01', '0.1', '1', '10'], ['1e-1', '1', '1e1'], ['1e4', '1e5', '1e6'])
    """
    exponents = range(first, last + 1)
    if first in _FULL_POWERS and last in _FULL_POWERS:
        return [f"{10.0**exponent:g}" for exponent in exponents]
    return [f"1e{exponent}" if exponent else "1" for exponent in exponents]
