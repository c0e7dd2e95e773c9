"""The exposure that a camera's properties set, and the properties of a recorded body."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from sim.devices.ptp.body_facts import DIALS, BodyFacts
from sim.devices.ptp.config import PtpConfig
from sim.devices.ptp.properties import (
    MANUAL,
    DeviceProperty,
    PropertyTable,
    standard_properties,
    true_time_s,
)
from sim.devices.ptp.protocol import Property, Type

_AUTOMATIC_S = 1 / 60  # exposures of a camera without a shutter property

# A dial with fewer choices was recorded while the camera chose the value itself.
_FULL_DIAL = 12


def recorded_properties(
    facts: BodyFacts, items: Sequence[DeviceProperty], *, is_manual: bool
) -> list[DeviceProperty]:
    """Return the properties of a body as they were recorded.

    Args:
        facts: of the body
        items: properties that a camera of its maker has, with all choices of manual exposure;
            those that were not recorded are kept where the body may have them
        is_manual: True if the mode dial was turned to M since: then all choices are there
    """
    found: dict[int, DeviceProperty] = {}
    for code, fact in facts.properties.items():
        limits = None if fact.choices else fact.range
        kind = Type(fact.type)
        found[code] = DeviceProperty(
            code, kind, fact.value, fact.choices, limits, is_writable=fact.writable
        )
    for item in items:
        recorded, is_dial = found.get(item.code), item.code in DIALS
        if recorded is None:
            if not is_dial or facts.may_have(item.code):
                found[item.code] = item
        elif is_dial and is_manual:
            recorded.is_writable = True
            if len(recorded.choices) < _FULL_DIAL and not recorded.limits:
                recorded.kind, recorded.choices = item.kind, item.choices
            if recorded.choices and recorded.value not in recorded.choices:
                recorded.value = recorded.choices[len(recorded.choices) // 2]
    return list(found.values())


class ExposureProperties:
    """What the properties of a camera mean; the makers' cameras override it.

    Attributes:
        config: options of the camera
        facts: of the recorded body that it is; None: it is none
        properties: by code
    """

    config: PtpConfig
    facts: BodyFacts | None
    properties: PropertyTable
    # Standard operations that the maker's cameras do not have.
    missing: ClassVar[frozenset[int]] = frozenset()
    program_code: ClassVar[int] = Property.EXPOSURE_PROGRAM
    manual: ClassVar[int] = MANUAL

    def make_properties(self) -> list[DeviceProperty]:
        """Return the camera's properties with their values at power-on."""
        return standard_properties(self.config)

    def all_properties(self) -> list[DeviceProperty]:
        """Return the properties with their values at power-on, recorded ones included."""
        items, mode = self.make_properties(), self.config.mode
        if self.facts is None:
            return items
        program = self.facts.properties.get(self.program_code)
        is_turned = mode == "manual" and (program is None or program.value != self.manual)
        items = recorded_properties(self.facts, items, is_manual=is_turned)
        for item in items:
            if item.code == self.program_code and is_turned:
                item.value = self.manual
        return items

    def has_operation(self, code: int) -> bool:
        """Return whether the camera has an operation."""
        if self.facts is None:
            return code not in self.missing
        return code in self.facts.all_operations or code in self.config.unlisted

    def time_of(self, code: int, value: int) -> float | None:
        """Return the shutter time that a value of a property stands for; None: it is no time."""
        return true_time_s(value) if code == Property.EXPOSURE_TIME else None

    def exposure_time_s(self) -> float | None:
        """Return the shutter time that is set; None: bulb."""
        code = Property.EXPOSURE_TIME
        if code not in self.properties:
            return _AUTOMATIC_S
        return self.time_of(code, self.properties.number(code))

    def gain(self) -> float:
        """Return the linear gain of the sensitivity that is set."""
        code = Property.EXPOSURE_INDEX
        return self.properties.number(code) / 100 if code in self.properties else 1.0

    def light(self) -> float:
        """Return the share of the light that the aperture lets through, 1 for the widest."""
        code = Property.F_NUMBER
        if code not in self.properties:
            return 1.0
        item = self.properties[code]
        now = self.properties.number(code)
        widest = min((number for number in item.choices if number), default=now)
        return float((widest / now) ** 2) if now else 1.0

    def f_number(self) -> float | None:
        """Return the f-number that is set; None: the host cannot set one."""
        code = Property.F_NUMBER
        return self.properties.number(code) / 100 if code in self.properties else None
