"""The properties that ISO 15740 gives a still camera, clause 13."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction

from sim.devices.ptp.codes import Property, Type
from sim.devices.ptp.config import COMPRESSIONS, PtpConfig
from sim.devices.ptp.datasets import DeviceProperty

UNITS_PER_S = 10_000  # of property 500D
# What a unit of 1e-4 s cannot say: a real camera that says 1 exposes for 1/8000 s.
TRUE_TIME_S = {1: 1 / 8000}
CHARGE, LOW_CHARGE = 87, 3  # per cent
MANUAL, AUTOMATIC = 1, 2  # property 500E
_RANGE_S = 60


def to_units(time_s: Fraction) -> int:
    """Return a time as property 500D says it."""
    return max(1, round(time_s * UNITS_PER_S))


def true_time_s(units: int) -> float:
    """Return how long a camera exposes whose property 500D is `units`."""
    return TRUE_TIME_S.get(units, units / UNITS_PER_S)


def longest_within(item: DeviceProperty, limit_s: float, times: dict[int, float | None]) -> int:
    """Return the value for the longest shutter time up to `limit_s`; `times` of its choices."""
    if item.limits is not None:
        return max(item.limits[0], int(limit_s * UNITS_PER_S))
    within = {value: time_s for value, time_s in times.items() if time_s and time_s <= limit_s}
    return max(within, key=lambda value: within[value]) if within else item.choices[0]


def battery(code: int = Property.BATTERY_LEVEL) -> DeviceProperty:
    """Return the charge in per cent."""
    return DeviceProperty(code, Type.UINT8, CHARGE, limits=(0, 100, 1), is_writable=False)


def program(config: PtpConfig) -> DeviceProperty:
    """Return the mode dial, which a host cannot turn."""
    mode = MANUAL if config.mode == "manual" else AUTOMATIC
    choices = (MANUAL, AUTOMATIC)
    return DeviceProperty(Property.EXPOSURE_PROGRAM, Type.UINT16, mode, choices, is_writable=False)


def shutter(config: PtpConfig) -> DeviceProperty:
    """Return property 500D, with a list or a range."""
    is_manual = config.mode == "manual"
    code, tenth = Property.EXPOSURE_TIME, UNITS_PER_S // 10
    if config.time_form == "range":
        limits = (1, _RANGE_S * UNITS_PER_S, 1)
        return DeviceProperty(code, Type.UINT32, tenth, limits=limits, is_writable=is_manual)
    choices = tuple(dict.fromkeys(to_units(time_s) for time_s in config.times))
    value = min(choices, key=lambda units: abs(units - tenth))
    return DeviceProperty(code, Type.UINT32, value, choices, is_writable=is_manual)


def sensitivity(config: PtpConfig) -> list[DeviceProperty]:
    """Return property 500F, where there is one."""
    if not config.isos:
        return []
    return [DeviceProperty(Property.EXPOSURE_INDEX, Type.UINT16, config.isos[0], config.isos)]


def aperture(config: PtpConfig) -> list[DeviceProperty]:
    """Return property 5007, wide open at first, where there is one."""
    if not config.f_numbers:
        return []
    widest = min(config.f_numbers)
    return [DeviceProperty(Property.F_NUMBER, Type.UINT16, widest, config.f_numbers)]


def compression(
    config: PtpConfig, codes: Mapping[str, int], *, is_always_there: bool = False
) -> list[DeviceProperty]:
    """Return property 5004, where there is a choice; `codes` are what the maker calls each."""
    if len(config.files) < 2 and not is_always_there:
        return []
    choices = tuple(codes[choice] for choice in config.files)
    return [DeviceProperty(Property.COMPRESSION, Type.UINT8, choices[0], choices)]


def standard_properties(config: PtpConfig) -> list[DeviceProperty]:
    """Return what a camera without a maker's own properties has."""
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
