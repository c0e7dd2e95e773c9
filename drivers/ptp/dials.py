"""Dials: properties that set the exposure, their numbers as SI values and back.

Fractions and decimals are taken as they are.  Many cameras with a mechanical shutter label powers
of two with round numbers: 1/60 is 1/64 s and 30 s is 32 s (P. Debevec and J. Malik, "Recovering
High Dynamic Range Radiance Maps from Photographs", 1997, section 2.1, measured it so); others mean
the number itself.  PTP has no way to ask which, so nothing is corrected here, and the camera's
notes say so.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction

from camctl.drivers.ptp.datasets import PropertyDescription
from camctl.errors import CameraProtocolError
from camctl.interface.controls import Choices, Control, Steps

# Some cameras state all numbers of the data type as the range: no setting follows from it.
_ANY_NUMBER = ((0, 0xFFFF, 1), (0, 0xFFFFFFFF, 1))


@dataclass(frozen=True)
class Scale:
    """The meaning of a property's numbers.

    Attributes:
        code: of the property
        decode: number to SI value (s, linear gain with ISO 100 as 1, f-number); None for numbers
            without one, such as bulb or automatic
        unit: SI value of 1 if numbers are multiples of it, else None
        set_by: another property through which some bodies set this one
    """

    code: int
    decode: Callable[[int], float | None]
    unit: Fraction | None = None
    set_by: int | None = None


# ---- numbers to SI values

# Numbers from here on mean bulb, T and X-sync.
_FIRST_SPECIAL = 0xFFFFFFF0
# Below 5 units of 1e-4 s, rounding to the unit is more than 10 % of the time.
_MIN_TEN_THOUSANDTHS = 5


def ten_thousandths(number: int) -> float | None:
    """Return the seconds of property 500D, in units of 1e-4 s.

    >>> ten_thousandths(166)
    0.0166
    """
    if not _MIN_TEN_THOUSANDTHS <= number < _FIRST_SPECIAL:
        return None
    return number / 10_000


def ratio(number: int) -> float | None:
    """Return the seconds of a fraction, numerator in the upper 16 bits (Nikon D100, Sony D20D).

    >>> ratio(1 << 16 | 60) == 1 / 60
    True
    """
    if number >= _FIRST_SPECIAL or not (number >> 16 and number & 0xFFFF):
        return None
    return float(Fraction(number >> 16, number & 0xFFFF))


# Canon rounds thirds of a stop to eighths: 3 and 5 mean exactly 1/3 and 2/3.
_EOS_THIRDS = {3: 1 / 3, 5: 2 / 3}


def _eos_stops(steps: int) -> float:
    """Return stops from the difference of a Canon code to the code of a whole stop."""
    whole, eighths = divmod(steps, 8)
    return whole + _EOS_THIRDS.get(eighths, eighths / 8)


def eos_time(code: int) -> float | None:
    """Return the seconds of Canon's code, eighths of a stop from 1 s at 0x38; 0x0C is bulb.

    >>> eos_time(0x38), eos_time(0x68)
    (1.0, 0.015625)
    >>> round(eos_time(0x3B), 4)  # a third of a stop less than 1 s, and not 3/8
    0.7937
    """
    return float(2.0 ** -_eos_stops(code - 0x38)) if 0x10 <= code <= 0xA8 else None


def eos_f_number(code: int) -> float | None:
    """Return the f-number of Canon's code, eighths of a stop of light from f/1 at 0x08.

    >>> eos_f_number(0x08), eos_f_number(0x28)
    (1.0, 4.0)
    """
    return float(2.0 ** (_eos_stops(code - 0x08) / 2)) if 1 <= code <= 0x78 else None


def eos_gain(code: int) -> float | None:
    """Return the gain of Canon's ISO code, eighths of a stop from ISO 100 at 0x48; 0: automatic.

    >>> eos_gain(0x48), eos_gain(0x58)
    (1.0, 4.0)
    """
    return float(2.0 ** _eos_stops(code - 0x48)) if 0x28 <= code <= 0xB8 else None


# Fuji's numbers from 64 s on count minutes in their last digits; numbers of 2 to 60 minutes are
# labels whose true times are not known.
_FUJI_LONGEST = 64_000_000


def fuji_time(number: int) -> float | None:
    """Return the seconds of Fuji's property 500D: microseconds, cut off, of a third of a stop.

    >>> fuji_time(15625), fuji_time(32_000_000)  # labelled 1/60 and 30"
    (0.015625, 32.0)
    >>> fuji_time(122) == 2**-13  # labelled 1/8000
    True
    """
    if not 1 <= number <= _FUJI_LONGEST:
        return None
    stops = round(3 * math.log2(number / 1e6)) / 3
    exact = 2.0**stops
    # Numbers are within 2 microseconds, or 0.1 %, of their third of a stop.
    is_third = abs(number - 1e6 * exact) <= max(2.0, 1e-3 * number)
    return exact if is_third else number / 1e6


def panasonic_time(number: int) -> float | None:
    """Return the seconds of Panasonic's number: thousandths, of 1/s without the top bit.

    >>> panasonic_time(125_000), panasonic_time(0x8000_0000 | 2500)
    (0.008, 2.5)
    """
    thousandths = number & 0x7FFF_FFFF
    if number >= _FIRST_SPECIAL or not thousandths:
        return None
    return thousandths / 1000 if number >> 31 else 1000 / thousandths


def tenths(number: int) -> float | None:
    """Return the f-number of Olympus and Panasonic.

    >>> tenths(28)
    2.8
    """
    return number / 10 if 0 < number < 0xFFF0 else None


def hundredths(number: int) -> float | None:
    """Return the f-number of property 5007.

    >>> hundredths(280)
    2.8
    """
    return number / 100 if 0 < number < 0xFFFE else None


# ISO numbers above 1,000 are multiples of 50; others, and numbers from FF00 to FFFF and from
# F0000000 on, are automatic or the maker's own.
_ISO_STEP = 50


def iso(number: int) -> float | None:
    """Return the gain of an ISO number, 1 for ISO 100; None for automatic and makers' numbers.

    >>> iso(400), iso(102_400)
    (4.0, 1024.0)
    >>> iso(0xFFFF), iso(-1), iso(0xD001)  # automatic; Fuji; intelligent ISO of Panasonic
    (None, None, None)
    """
    is_special = number <= 0 or 0xFF00 <= number <= 0xFFFF or number >= 0xF000_0000
    if is_special or (number > 1000 and number % _ISO_STEP):
        return None
    return number / 100


def sony_iso(number: int) -> float | None:
    """Return the gain of Sony's ISO number; FFFFFF is automatic.

    Numbers with a value in the upper byte are rejected: the camera then averages exposures.
    """
    return number / 100 if 0 < number < 0xFFFFFF else None


# ---- dials


@dataclass(frozen=True)
class Dial:
    """A property that sets the exposure.

    Attributes:
        name: field of `camctl.ExposureSetting`
        scale: the meaning of its numbers
        control: its settings, SI units
        is_stepped: True if the camera accepts steps up and down instead of a number
    """

    name: str
    scale: Scale
    control: Control
    is_stepped: bool = False
    _numbers: Mapping[float, int] = field(default_factory=dict)

    @property
    def code(self) -> int:
        return self.scale.code

    def number(self, value: float) -> int:
        """Return the number of the setting nearest to `value`."""
        nearest = self.control.nearest(value)
        if nearest in self._numbers:
            return self._numbers[nearest]
        assert self.scale.unit is not None  # a dial without a list has a unit
        return round(nearest / self.scale.unit)

    def value(self, number: int) -> float | None:
        """Return the SI value of a number; None if it has none, such as bulb or automatic."""
        return self.scale.decode(number)


def make_dial(
    name: str,
    scale: Scale,
    description: PropertyDescription,
    listed: Iterable[int] = (),
    *,
    is_stepped: bool = True,
) -> Dial | None:
    """Return the dial for a property; None if none of its numbers has an SI value.

    Args:
        name: field of `camctl.ExposureSetting`
        scale: the meaning of its numbers
        description: the camera's description of the property
        listed: numbers that it can be set to if the camera lists none
        is_stepped: True if it reaches those by steps up and down only

    Raises:
        CameraProtocolError: its range has no number with an SI value
    """
    if not description.is_writable:
        numbers: list[int] = [n for n in (description.current,) if isinstance(n, int)]
    else:
        numbers = [n for n in description.choices if isinstance(n, int)]
    span = description.span if description.span not in _ANY_NUMBER else None
    if not numbers and span is not None and scale.unit is not None:
        return Dial(name, scale, _steps(scale, description))
    others = () if numbers or not description.is_writable else _within(scale, span, listed)
    if not numbers and not others and isinstance(description.current, int):
        numbers = [description.current]  # nothing to choose from: it stays at this setting
    by_value: dict[float, int] = {}
    for number in (*numbers, *others):
        value = scale.decode(number)
        if value is not None:
            by_value.setdefault(value, number)
    if not by_value:
        return None
    control = Choices(tuple(sorted(by_value)))
    return Dial(name, scale, control, bool(others) and is_stepped, by_value)


def _within(
    scale: Scale, span: tuple[int, int, int] | None, listed: Iterable[int]
) -> tuple[int, ...]:
    """Return the numbers whose values are in a range, whose ends may be in any order."""
    ends = [scale.decode(number) for number in span[:2]] if span is not None else []
    known = [end for end in ends if end is not None]
    if len(known) < 2:
        return tuple(listed)
    values = ((number, scale.decode(number)) for number in listed)
    return tuple(
        n for n, value in values if value is not None and min(known) <= value <= max(known)
    )


def _steps(scale: Scale, description: PropertyDescription) -> Steps:
    assert description.span is not None
    assert scale.unit is not None
    low, high, step = description.span
    step = max(step, 1)
    if not 0 <= low <= high <= 0xFFFFFFFF:
        raise CameraProtocolError(
            f"the camera gave property {description.code:04X} the invalid range {low} to {high}",
            hint="switch it off and on again",
        )
    # The lowest number with an SI value: below it rounding to the unit is too coarse.
    while low <= high and scale.decode(low) is None and low < 100 * step:
        low += step
    if scale.decode(low) is None or low > high:
        raise CameraProtocolError(
            f"the camera offers no usable value of property {description.code:04X}",
            hint="switch it off and on again",
        )
    return Steps(float(low * scale.unit), float(high * scale.unit), float(step * scale.unit))
