"""Device properties, and those that ISO 15740, clause 13, defines for a still camera."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction

from camctl.sim.devices.ptp.config import COMPRESSIONS, PtpConfig
from camctl.sim.devices.ptp.protocol import Property, Reply, Response, Type, pack_value

UNITS_PER_S = 10_000  # of property 500D
# Times that units of 1e-4 s round: real cameras expose for 1/8000 s at the value 1.
_ROUNDED_TIMES_S = {1: 1 / 8000}
CHARGE, LOW_CHARGE = 87, 3  # per cent
MANUAL, AUTOMATIC = 1, 2  # property 500E
_LONGEST_S = 60  # of a range of shutter times
_RANGE, _ENUMERATION = 1, 2  # forms of a property's description


@dataclass
class DeviceProperty:
    """A device property.

    Attributes:
        code: property code
        kind: data type
        value, default: in the property's own units
        choices: allowed values; empty: see `limits`
        limits: (minimum, maximum, step) of allowed values; None: any value is allowed
        is_writable: a host may set it
    """

    code: int
    kind: Type
    value: int | str
    choices: tuple[int, ...] = ()
    limits: tuple[int, int, int] | None = None
    is_writable: bool = True
    default: int | str = field(init=False)

    def __post_init__(self) -> None:
        self.default = self.value

    def allows(self, value: int) -> bool:
        if self.choices:
            return value in self.choices
        if self.limits is not None:
            least, most, step = self.limits
            return least <= value <= most and (value - least) % step == 0
        return True

    def packed(self) -> bytes:
        return pack_value(self.kind, self.value)

    def description(self) -> bytes:
        head = struct.pack("<HHB", self.code, self.kind, self.is_writable)
        return head + pack_value(self.kind, self.default) + self.packed() + self.form()

    def form(self) -> bytes:
        """Return the form at the end of the description: the allowed values."""
        if self.choices:
            choices = b"".join(pack_value(self.kind, choice) for choice in self.choices)
            return struct.pack("<BH", _ENUMERATION, len(self.choices)) + choices
        if self.limits is not None:
            return bytes([_RANGE]) + b"".join(pack_value(self.kind, v) for v in self.limits)
        return b"\0"


class PropertyTable(dict[int, DeviceProperty]):
    """The properties of a camera by code, and the operations that read them."""

    def __init__(self, properties: Sequence[DeviceProperty]) -> None:
        super().__init__({item.code: item for item in properties})

    def number(self, code: int) -> int:
        value = self[code].value
        assert isinstance(value, int)
        return value

    def requested(self, parameters: Sequence[int]) -> DeviceProperty | None:
        """Return the property that an operation's first parameter names, if there is one."""
        return self.get(parameters[0]) if parameters else None

    def get_description(self, parameters: Sequence[int], data: bytes) -> Reply:
        """GetDevicePropDesc (property)."""
        item = self.requested(parameters)
        return Reply(data=item.description()) if item else Reply(Response.PROPERTY_NOT_SUPPORTED)

    def get_value(self, parameters: Sequence[int], data: bytes) -> Reply:
        """GetDevicePropValue (property)."""
        item = self.requested(parameters)
        return Reply(data=item.packed()) if item else Reply(Response.PROPERTY_NOT_SUPPORTED)


def to_units(time_s: Fraction) -> int:
    """Return a time as the value of property 500D."""
    return max(1, round(time_s * UNITS_PER_S))


def true_time_s(units: int) -> float:
    """Return the exposure time of a value of property 500D."""
    return _ROUNDED_TIMES_S.get(units, units / UNITS_PER_S)


def longest_within(item: DeviceProperty, limit_s: float, times: dict[int, float | None]) -> int:
    """Return the value for the longest shutter time up to `limit_s`.

    `times` are the shutter times of the property's choices; None: the choice is no time.
    """
    if item.limits is not None:
        return max(item.limits[0], int(limit_s * UNITS_PER_S))
    within = {value: time_s for value, time_s in times.items() if time_s and time_s <= limit_s}
    return max(within, key=lambda value: within[value]) if within else item.choices[0]


def battery() -> DeviceProperty:
    """Return the battery level, per cent."""
    code, limits = Property.BATTERY_LEVEL, (0, 100, 1)
    return DeviceProperty(code, Type.UINT8, CHARGE, limits=limits, is_writable=False)


def program(config: PtpConfig) -> DeviceProperty:
    """Return the exposure program: the mode dial, which a host cannot set."""
    mode = MANUAL if config.mode != "auto" else AUTOMATIC
    choices = (MANUAL, AUTOMATIC)
    return DeviceProperty(Property.EXPOSURE_PROGRAM, Type.UINT16, mode, choices, is_writable=False)


def shutter(config: PtpConfig) -> DeviceProperty:
    """Return the exposure time (500D), as an enumeration or a range."""
    is_manual = config.mode != "auto"
    code, tenth = Property.EXPOSURE_TIME, UNITS_PER_S // 10
    if config.time_form == "range":
        limits = (1, _LONGEST_S * UNITS_PER_S, 1)
        return DeviceProperty(code, Type.UINT32, tenth, limits=limits, is_writable=is_manual)
    choices = tuple(dict.fromkeys(to_units(time_s) for time_s in config.times))
    value = min(choices, key=lambda units: abs(units - tenth))
    return DeviceProperty(code, Type.UINT32, value, choices, is_writable=is_manual)


def sensitivity(config: PtpConfig) -> list[DeviceProperty]:
    """Return the exposure index (500F), if the camera has one."""
    if not config.isos:
        return []
    return [DeviceProperty(Property.EXPOSURE_INDEX, Type.UINT16, config.isos[0], config.isos)]


def aperture(config: PtpConfig) -> list[DeviceProperty]:
    """Return the f-number (5007), initially the widest, if the camera has one."""
    if not config.f_numbers:
        return []
    widest = min(config.f_numbers)
    return [DeviceProperty(Property.F_NUMBER, Type.UINT16, widest, config.f_numbers)]


def compression(
    config: PtpConfig, codes: Mapping[str, int], *, is_always_there: bool = False
) -> list[DeviceProperty]:
    """Return the compression setting (5004), if there is more than one or `is_always_there`.

    `codes` are the maker's numbers for the entries of `PtpConfig.files`.
    """
    if len(config.files) < 2 and not is_always_there:
        return []
    choices = tuple(codes[choice] for choice in config.files)
    return [DeviceProperty(Property.COMPRESSION, Type.UINT8, choices[0], choices)]


def standard_properties(config: PtpConfig) -> list[DeviceProperty]:
    """Return the properties of a camera without a maker's extension."""
    clock = DeviceProperty(Property.DATE_TIME, Type.STRING, "20240101T120000", is_writable=False)
    return [
        battery(),
        *compression(config, COMPRESSIONS),
        *aperture(config),
        shutter(config),
        program(config),
        *sensitivity(config),
        clock,
    ]
