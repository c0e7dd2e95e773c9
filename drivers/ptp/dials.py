"""A camera's dials: property descriptions as controls in SI units, and back."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from camctl.controls import Choices, Control, Steps
from camctl.errors import CameraProtocolError
from drivers.ptp.datasets import PropertyDescription
from drivers.ptp.dialects import Scale

_MOST_NUMBER = 0xFFFFFFFF


@dataclass(frozen=True)
class Dial:
    """One property that sets the exposure.

    Attributes:
        name: field of `camctl.controls.ExposureSetting`
        scale: what its numbers mean
        data_type: PTP data type of its numbers
        control: what it can be set to, SI units
        is_stepped: it is turned by steps, since the camera takes no value
    """

    name: str
    scale: Scale
    data_type: int
    control: Control
    is_stepped: bool = False
    _numbers: Mapping[float, int] = field(default_factory=dict)

    @property
    def code(self) -> int:
        """The property."""
        return self.scale.code

    def number(self, value: float) -> int:
        """Return the number for the setting nearest to `value`."""
        nearest = self.control.nearest(value)
        if nearest in self._numbers:
            return self._numbers[nearest]
        assert self.scale.unit is not None  # a dial without a list has a unit
        return round(nearest / self.scale.unit)

    def value(self, number: int) -> float | None:
        """Return the SI value of a number; None where it is bulb, automatic, or nonsense."""
        return self.scale.decode(number)


def make_dial(
    name: str, scale: Scale, description: PropertyDescription, listed: Iterable[int] = ()
) -> Dial | None:
    """Return the dial that a description describes; None where there is nothing to turn.

    Args:
        name: field of `camctl.controls.ExposureSetting`
        scale: what its numbers mean
        description: as the camera gives it
        listed: numbers it can be stepped through, where it lists none itself

    Raises:
        CameraProtocolError: none of its values makes sense
    """
    if not description.is_writable:
        numbers: list[int] = [n for n in (description.current,) if isinstance(n, int)]
    else:
        numbers = [n for n in description.choices if isinstance(n, int)]
    if not numbers and description.span is not None and scale.unit is not None:
        return Dial(name, scale, description.data_type, _steps(scale, description))
    stepped_through = () if numbers else tuple(listed)
    if not numbers and not stepped_through and isinstance(description.current, int):
        numbers = [description.current]  # it lists nothing: it stays where it is
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
    if not 0 <= low <= high <= _MOST_NUMBER:
        raise CameraProtocolError(
            f"property {description.code:04X} goes from {low} to {high}",
            hint="switch the camera off and on again",
        )
    # The lowest number that has a meaning: below it rounding to the unit is too coarse.
    while low <= high and scale.decode(low) is None and low < 100 * step:
        low += step
    if scale.decode(low) is None or low > high:
        raise CameraProtocolError(
            f"property {description.code:04X} has no usable value",
            hint="switch the camera off and on again",
        )
    return Steps(float(low * scale.unit), float(high * scale.unit), float(step * scale.unit))
