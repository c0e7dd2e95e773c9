"""Text on a grid of characters: numbers in few characters, and lines of an exact length."""

from __future__ import annotations

import textwrap
import unicodedata

_TIME_UNITS = ((1.0, "s"), (1e-3, "ms"), (1e-6, "us"))

#: Relative difference of two numbers that have seven digits in common.
_SEVEN_DIGITS = 5e-8


def format_exact_time(time_s: float) -> str:
    """Return a time with seven digits, the accuracy of a camera's settings, or as a fraction.

    The fraction is 1 over a whole number, where it is that time and the shorter text.

    >>> format_exact_time(0.29166531), format_exact_time(1 / 13), format_exact_time(0.004)
    ('291.6653 ms', '1/13 s', '4 ms')
    """
    factor, unit = _unit(time_s)
    text = f"{_digits(time_s / factor, 7)} {unit}"
    whole = round(1 / time_s) if time_s < 1 else 1
    is_exact = abs(whole * time_s - 1) < _SEVEN_DIGITS
    return min(text, f"1/{whole} s", key=len) if is_exact and whole > 1 else text


def format_short_time(time_s: float) -> str:
    """Return a time with three digits, in at most seven characters up to a year.

    >>> format_short_time(0.32747)
    '327 ms'
    """
    if time_s >= 9999.5:
        return f"{_digits(time_s / 3600, 3)} h"
    factor, unit = _unit(time_s)
    return f"{_digits(time_s / factor, 3)} {unit}"


def format_ratio(ratio: float) -> str:
    """Return a ratio of exposures with four digits, whole from a thousand on.

    >>> format_ratio(9.9099)
    '9.91'
    """
    return _digits(ratio, 4)


def format_total(ratio: float) -> str:
    """Return a sum of relative exposures with three digits, whole from a hundred on.

    >>> format_total(1460.2), format_total(2.5e6)
    ('1460', '2500k')
    """
    if ratio >= 99999.5:
        return f"{ratio / 1e3:.0f}k"
    return _digits(ratio, 3)


def format_levels(levels: float) -> str:
    """Return a number of levels in at most five characters up to 99 million.

    >>> format_levels(6.53), format_levels(391.7), format_levels(393210.0)
    ('6.5', '392', '393k')
    """
    if levels < 9.95:
        return f"{levels:.1f}"
    if levels < 99999.5:
        return f"{levels:.0f}"
    return f"{levels / 1e3:.0f}k" if levels < 9.9995e6 else f"{levels / 1e6:.1f}M"


def format_bytes(size: int) -> str:
    """Return a size with three digits.

    >>> format_bytes(12_300_000), format_bytes(0)
    ('12.3 MB', '0 kB')
    """
    for factor, unit in ((1e12, "TB"), (1e9, "GB"), (1e6, "MB")):
        if size >= 0.9995 * factor:
            return f"{_digits(size / factor, 3)} {unit}"
    return f"{_digits(size / 1e3, 3)} kB"


def _unit(time_s: float) -> tuple[float, str]:
    # 999.6 us rounded to three digits would be "1000 us": it is 1 ms.
    return next((unit for unit in _TIME_UNITS if time_s >= 0.9995 * unit[0]), _TIME_UNITS[-1])


def _digits(value: float, digits: int) -> str:
    """Return `value` with so many digits, or more where its whole part has more."""
    whole = len(f"{abs(value):.0f}")
    text = f"{value:.{max(0, digits - whole)}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def wrap(paragraphs: list[str], columns: int) -> list[str]:
    """Return the paragraphs as lines of at most `columns` characters, the later ones indented."""
    lines: list[str] = []
    for paragraph in paragraphs:
        lines += textwrap.wrap(paragraph, columns, subsequent_indent=" ") or [""]
    return lines


def fit(line: str, columns: int) -> str:
    """Return `line` as exactly `columns` characters that take one cell each."""
    cells = "".join(character if _is_one_cell(character) else "?" for character in line)
    return cells[:columns].ljust(columns)


def _is_one_cell(character: str) -> bool:
    return (
        character.isprintable()
        and unicodedata.east_asian_width(character) not in "WF"
        and not unicodedata.category(character).startswith("M")
    )


_ORDINALS = (
    *("first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth", "ninth"),
    *("tenth", "eleventh", "twelfth", "thirteenth", "fourteenth", "fifteenth", "sixteenth"),
)


def gain_in_words(count: int, cost: str, levels: float, levels_before: float) -> str:
    """Return what one more exposure costs and brings.

    The error is the root mean square one in the desired response, 1 / (sqrt(12) L).

    Args:
        count: number of exposures with it
        cost: what it costs more, such as 0.8 s
        levels: effective levels with it
        levels_before: effective levels without it

    >>> gain_in_words(4, "0.8 s", 100.0, 69.0)
    'the fourth exposure costs 0.8 s and brings 31 % less error'
    """
    less = 100 * (1 - levels_before / levels)
    error = f"{less:.0f} % less error" if less >= 1 else "no less error"
    return f"the {_ORDINALS[count - 1]} exposure costs {cost} and brings {error}"
