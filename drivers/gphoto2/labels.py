"""True values of the labels on a camera's dials.

libgphoto2 gives the words on the dial: 1/60, 0.3, f/5.6, 400.  Canon and Fujifilm mean exact
fractions of a stop with them (1/60 is 1/64 s, 0.3 is 0.315 s, f/3.5 is f/3.56), as the numbers that
their bodies send over PTP show; other makes are taken as they are labelled.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from typing import TypeAlias

Parse: TypeAlias = Callable[[str], float | None]

#: Makes whose labels stand for exact fractions of a stop.
_EXACT_STOPS = ("canon", "fuji")
#: Labels differ from the value that they stand for by at most this many stops: 1/15 for 1/16.
_ROUNDING_STOPS = 0.1
#: A time with the unit in its label is in units of 0.1 ms (property 500D); below so many of them,
#: rounding to the unit is more than 10 % of the time.
_UNIT_S, _FEWEST_UNITS = 1e-4, 5

_FRACTION = re.compile(r"(\d+(?:\.\d+)?)\s*/\s*(\d+(?:\.\d+)?)\s*s?")
_DECIMAL = re.compile(r"(\d+(?:[.,]\d+)?)\s*(s|sec|\")?")
_F_NUMBER = re.compile(r"(?:f\s*/?\s*)?(\d+(?:[.,]\d+)?)", re.IGNORECASE)
_ISO = re.compile(r"(?:iso\s*)?(\d{1,7})", re.IGNORECASE)


def seconds(label: str) -> float | None:
    """Return the time of a label, s; None for Bulb, Auto and all others without one.

    >>> seconds("1/250"), seconds("2.5"), seconds("0.0100s"), seconds("0.0001s"), seconds("bulb")
    (0.004, 2.5, 0.01, None, None)
    """
    text = label.strip().lower()
    if found := _FRACTION.fullmatch(text):
        return _positive(float(found[1]) / float(found[2]) if float(found[2]) else 0.0)
    if found := _DECIMAL.fullmatch(text):
        time_s = float(found[1].replace(",", "."))
        has_unit = found[2] is not None and len(found[1].partition(".")[2]) == 4
        return None if has_unit and time_s < _FEWEST_UNITS * _UNIT_S else _positive(time_s)
    return None


def gain(label: str) -> float | None:
    """Return the linear gain of a sensitivity, 1 for ISO 100; None for Auto and the like."""
    found = _ISO.fullmatch(label.strip())
    return _positive(float(found[1]) / 100) if found else None


def f_number(label: str) -> float | None:
    """Return the f-number of a label; None for those without one."""
    found = _F_NUMBER.fullmatch(label.strip())
    return _positive(float(found[1].replace(",", "."))) if found else None


def true_values(labels: Iterable[str], parse: Parse, make: str, power: int = 1) -> dict[float, str]:
    """Return the label of each true value, ascending.

    Args:
        labels: of a dial
        parse: `seconds`, `gain` or `f_number`
        make: of the camera
        power: of the value in the exposure: 2 for an f-number
    """
    found = {value: label for label in labels if (value := parse(label)) is not None}
    if make.lower().startswith(_EXACT_STOPS):
        found = _exact_stops(found, power)
    return dict(sorted(found.items()))


def _exact_stops(found: dict[float, str], power: int) -> dict[float, str]:
    """Return the labels of exact thirds or halves of stops, if each is near one of its own."""
    for parts in (3, 2):
        places = {value: power * math.log2(value) * parts for value in found}
        rounded = {value: round(place) for value, place in places.items()}
        near = all(
            abs(place - rounded[value]) <= _ROUNDING_STOPS * parts
            for value, place in places.items()
        )
        if near and len(set(rounded.values())) == len(found):
            return {2 ** (rounded[value] / parts / power): label for value, label in found.items()}
    return found


def _positive(value: float) -> float | None:
    return value if 0 < value < math.inf else None
