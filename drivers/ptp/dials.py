"""Dials: properties that set the exposure, their numbers as SI values and back.

Fractions and decimals are taken as they are.  Many cameras with a mechanical shutter label powers
of two with round numbers: 1/60 is 1/64 s and 30 s is 32 s (P. Debevec and J. Malik, "Recovering
High Dynamic Range Radiance Maps from Photographs", 1997, section 2.1, measured it so); others mean
the number itself.  PTP has no way to ask which, so nothing is corrected here, and the camera's
notes say so.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction

from camctl.controls import Choices, Control, Steps
from camctl.errors import CameraProtocolError
from drivers.ptp.datasets import PropertyDescription

_MAX_NUMBER = 0xFFFFFFFF


@dataclass(frozen=True)
class Scale:
    """The meaning of a property's numbers.

    Attributes:
        code: of the property
        decode: number to SI value (s, linear gain with ISO 100 as 1, f-number); None for numbers
            without one, such as bulb or automatic
        unit: SI value of 1 if numbers are multiples of it, else None
    """

    code: int
    decode: Callable[[int], float | None]
    unit: Fraction | None = None


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


def eos_time(code: int) -> float | None:
    """Return the seconds of Canon's code, 2^((0x38 - code) / 8); 0x0C is bulb, 0x10 the longest.

    >>> eos_time(0x38), eos_time(0x68)
    (1.0, 0.015625)
    """
    return 2.0 ** ((0x38 - code) / 8) if 0x10 <= code <= 0xA8 else None


def eos_f_number(code: int) -> float | None:
    """Return the f-number of Canon's code, 2^((code - 8) / 16).

    >>> eos_f_number(0x08), eos_f_number(0x28)
    (1.0, 4.0)
    """
    return 2.0 ** ((code - 8) / 16) if 1 <= code <= 0x78 else None


def eos_gain(code: int) -> float | None:
    """Return the gain of Canon's ISO code, 2^((code - 0x48) / 8); 0 is automatic.

    >>> eos_gain(0x48), eos_gain(0x58)
    (1.0, 4.0)
    """
    return 2.0 ** ((code - 0x48) / 8) if 0x28 <= code <= 0xB8 else None


def hundredths(number: int) -> float | None:
    """Return the f-number of property 5007.

    >>> hundredths(280)
    2.8
    """
    return number / 100 if 0 < number < 0xFFFE else None


def iso(number: int) -> float | None:
    """Return the gain of an ISO number, 1 for ISO 100; numbers from FF00 on are automatic.

    >>> iso(400)
    4.0
    """
    return number / 100 if 0 < number < 0xFF00 else None


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
        name: field of `camctl.controls.ExposureSetting`
        scale: the meaning of its numbers
        data_type: PTP data type of its numbers
        control: its settings, SI units
        is_stepped: True if the camera accepts steps up and down instead of a number
    """

    name: str
    scale: Scale
    data_type: int
    control: Control
    is_stepped: bool = False
    _numbers: Mapping[float, int] = field(default_factory=dict)

    @property
    def code(self) -> int:
        """The property's code."""
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
    name: str, scale: Scale, description: PropertyDescription, listed: Iterable[int] = ()
) -> Dial | None:
    """Return the dial for a property; None if none of its numbers has an SI value.

    Args:
        name: field of `camctl.controls.ExposureSetting`
        scale: the meaning of its numbers
        description: the camera's description of the property
        listed: numbers that it can be stepped through if the camera lists none

    Raises:
        CameraProtocolError: its range has no number with an SI value
    """
    if not description.is_writable:
        numbers: list[int] = [n for n in (description.current,) if isinstance(n, int)]
    else:
        numbers = [n for n in description.choices if isinstance(n, int)]
    if not numbers and description.span is not None and scale.unit is not None:
        return Dial(name, scale, description.data_type, _steps(scale, description))
    stepped_through = () if numbers else tuple(listed)
    if not numbers and not stepped_through and isinstance(description.current, int):
        numbers = [description.current]  # nothing to choose from: it stays at this setting
    by_value: dict[float, int] = {}
    for number in (*numbers, *stepped_through):
        value = scale.decode(number)
        if value is not None:
            by_value.setdefault(value, number)
    if not by_value:
        return None
    control = Choices(tuple(sorted(by_value)))
    is_stepped = bool(stepped_through)
    return Dial(name, scale, description.data_type, control, is_stepped, by_value)


def _steps(scale: Scale, description: PropertyDescription) -> Steps:
    assert description.span is not None
    assert scale.unit is not None
    low, high, step = description.span
    step = max(step, 1)
    if not 0 <= low <= high <= _MAX_NUMBER:
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
