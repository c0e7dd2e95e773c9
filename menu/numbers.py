"""Numbers as short words for a small panel."""

from __future__ import annotations

_UNITS = ((1.0, "s"), (1e-3, "ms"), (1e-6, "us"))


def exact_time(time_s: float) -> str:
    """Return a time to seven digits, the accuracy to which a camera's settings are met.

    >>> exact_time(0.29166531)
    '291.6653 ms'
    """
    factor, unit = _unit(time_s)
    return f"{_digits(time_s / factor, 7)} {unit}"


def short_time(time_s: float) -> str:
    """Return a time to three digits, in at most seven characters up to a year.

    >>> short_time(0.32747)
    '327 ms'
    """
    if time_s >= 9999.5:
        return f"{_digits(time_s / 3600, 3)} h"
    factor, unit = _unit(time_s)
    return f"{_digits(time_s / factor, 3)} {unit}"


def multiple(ratio: float) -> str:
    """Return how many times something is to four digits, whole from a thousand on.

    >>> multiple(9.9099)
    '9.91'
    """
    return _digits(ratio, 4)


def times(ratio: float) -> str:
    """Return how many times something is to three digits, whole from a hundred on.

    >>> times(1460.2), times(2.5e6)
    ('1460', '2500k')
    """
    if ratio >= 99999.5:
        return f"{ratio / 1e3:.0f}k"
    return _digits(ratio, 3)


def count_of(levels: float) -> str:
    """Return a number of levels in at most five characters up to 99 million.

    >>> count_of(6.53), count_of(391.7), count_of(393210.0)
    ('6.5', '392', '393k')
    """
    if levels < 9.95:
        return f"{levels:.1f}"
    if levels < 99999.5:
        return f"{levels:.0f}"
    return f"{levels / 1e3:.0f}k" if levels < 9.9995e6 else f"{levels / 1e6:.1f}M"


def share(part: float) -> str:
    """Return a share as a percentage; a little is never shown as nothing.

    >>> share(0.0), share(0.00001), share(0.0312)
    ('0 %', '<0.01 %', '3.12 %')
    """
    if 0 < part < 1e-4:
        return "<0.01 %"
    return f"{_digits(100 * part, 3)} %"


def _unit(time_s: float) -> tuple[float, str]:
    # Rounding to three digits must not carry 999.6 us over into "1000 us".
    return next((unit for unit in _UNITS if time_s >= 0.9995 * unit[0]), _UNITS[-1])


def _digits(value: float, digits: int) -> str:
    """Return `value` to so many digits, never with an exponent and never cutting whole ones."""
    whole = len(f"{abs(value):.0f}")
    text = f"{value:.{max(0, digits - whole)}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text
