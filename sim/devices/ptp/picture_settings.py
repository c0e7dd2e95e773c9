"""What the properties of a camera set for a picture, and the properties of a recorded body."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

from camctl.sim.devices.ptp.body_facts import DIALS, BodyFacts
from camctl.sim.devices.ptp.config import COMPRESSIONS, PtpConfig, file_formats
from camctl.sim.devices.ptp.properties import (
    AUTOMATIC,
    MANUAL,
    DeviceProperty,
    PropertyTable,
    standard_properties,
    true_time_s,
)
from camctl.sim.devices.ptp.protocol import Property, Type
from camctl.sim.devices.ptp.store import FORMATS

_AUTOMATIC_S = 1 / 60  # exposures of a camera without a shutter property
AUTOMATIC_GAIN = 4.0  # of a camera that chooses its sensitivity itself

# A dial with fewer choices was recorded while the camera chose the value itself; of sensitivities
# simple bodies have a few.
_FULL_DIAL, _FULL_ISO_DIAL = 12, 3
_ISO_DIALS = frozenset({0x500F, 0xD103, 0xD21E, 0xD007})


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
            full = _FULL_ISO_DIAL if item.code in _ISO_DIALS else _FULL_DIAL
            if len(recorded.choices) < full and not recorded.limits:
                recorded.kind, recorded.choices = item.kind, item.choices
            if recorded.choices and recorded.value not in recorded.choices:
                recorded.value = recorded.choices[len(recorded.choices) // 2]
    return list(found.values())


class PictureSettings:
    """Exposure and files by the properties of a camera; the makers' cameras override what differs.

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
    automatic: ClassVar[int] = AUTOMATIC
    # Properties that hold the shutter time, the most exact one last.
    shutter_codes: ClassVar[tuple[int, ...]] = (Property.EXPOSURE_TIME,)
    # The sensitivity, and the lowest of the numbers that are automatic, with those below 1.
    iso_code: ClassVar[int] = Property.EXPOSURE_INDEX
    automatic_iso: ClassVar[int] = 10**8
    # The aperture, and its numbers per unit of the f-number.
    aperture_code: ClassVar[int] = Property.F_NUMBER
    aperture_units: ClassVar[int] = 100
    # Of the entries of `PtpConfig.files`, in property 5004.
    compressions: ClassVar[Mapping[str, int]] = COMPRESSIONS
    # Of the objects.
    object_formats: ClassVar[Mapping[str, int]] = FORMATS

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
        for code in reversed(self.shutter_codes):
            if code in self.properties:
                return self.time_of(code, self.properties.number(code))
        return _AUTOMATIC_S

    def gain(self) -> float:
        """Return the linear gain of the sensitivity that is set."""
        code = self.iso_code
        number = self.properties.number(code) if code in self.properties else 100
        return number / 100 if 0 < number < self.automatic_iso else AUTOMATIC_GAIN

    def light(self) -> float:
        """Return the share of the light that the aperture lets through, 1 for the widest."""
        item, now = self.properties.get(self.aperture_code), self.f_number()
        choices = [number for number in item.choices if number] if item is not None else []
        if not now or not choices:
            return 1.0
        return float((min(choices) / self.aperture_units / now) ** 2)

    def f_number(self) -> float | None:
        """Return the f-number that is set; None: the host cannot set one, or there is no lens."""
        code = self.aperture_code
        number = self.properties.number(code) if code in self.properties else 0
        return number / self.aperture_units if number else None

    def selected_formats(self) -> tuple[str, ...]:
        """Return the formats of the files that an exposure gives, by the compression setting."""
        if Property.COMPRESSION not in self.properties:
            return file_formats(self.config.files[0])
        value = self.properties.number(Property.COMPRESSION)
        return next(file_formats(c) for c in self.config.files if self.compressions[c] == value)

    def listed_formats(self) -> list[int]:
        """Return the object formats in the device info."""
        forms = {form for each in self.config.files for form in file_formats(each)}
        return sorted(self.object_formats[form] for form in forms)
