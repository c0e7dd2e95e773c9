"""A camera with Nikon's extension of PTP, as libgphoto2 describes it."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import ClassVar

from camctl.sim.devices.ptp.config import Identity
from camctl.sim.devices.ptp.picture_settings import AUTOMATIC_GAIN
from camctl.sim.devices.ptp.properties import UNITS_PER_S, DeviceProperty, to_units, true_time_s
from camctl.sim.devices.ptp.protocol import (
    Event,
    Handler,
    Operation,
    Property,
    Reply,
    Response,
    Type,
    pack_list,
)
from camctl.sim.devices.ptp.responder import Responder
from camctl.sim.devices.still_body import ImageFile

BULB = 0xFFFF_FFFF  # shutter number
IN_MEMORY = 0xFFFF_0001  # handle of the first picture in memory
_TO_CARD, _TO_MEMORY = 0, 1  # second parameter of 9207
_WITHOUT_FOCUSING = 0xFFFF_FFFF  # first one
_SPECIAL = 0xFFFF_FFF0  # values from here on are no times

_LENS = (
    (Property.NIKON_FOCAL_LENGTH_MIN, Type.UINT32, 1800),
    (Property.NIKON_FOCAL_LENGTH_MAX, Type.UINT32, 5500),
    (Property.NIKON_MAX_APERTURE_AT_MIN, Type.UINT16, 350),
    (Property.NIKON_MAX_APERTURE_AT_MAX, Type.UINT16, 560),
)
"""A zoom of 18 to 55 mm, f/3.5 to f/5.6, in hundredths."""


class NikonResponder(Responder):
    """A camera with exact fractions as shutter times, captures into memory, and polled events."""

    identity: ClassVar[Identity] = Identity(
        0x04B0, 0x0428, "Nikon Corporation", "D7000 (virtual)", 0x0A, 100
    )
    shutter_codes: ClassVar[tuple[int, ...]] = (
        Property.EXPOSURE_TIME,
        Property.NIKON_EXPOSURE_TIME,
    )
    events: ClassVar[tuple[int, ...]] = (*Responder.events, Event.NIKON_OBJECT_IN_MEMORY)

    def make_properties(self) -> list[DeviceProperty]:
        """Return the standard properties, and the shutter time as a fraction.

        The fraction is numerator << 16 | denominator.
        """
        items = super().make_properties()
        standard = next(item for item in items if item.code == Property.EXPOSURE_TIME)
        fractions = [
            (time_s.numerator << 16 | time_s.denominator, to_units(time_s))
            for time_s in self.config.times
        ]
        if self.config.bulb:
            fractions.append((BULB, BULB))
        self._pair(fractions)
        standard.choices, standard.limits = tuple(sorted(self._fraction_of)), None
        exact = DeviceProperty(
            Property.NIKON_EXPOSURE_TIME,
            Type.UINT32,
            self._fraction_of[self._start(standard)],
            tuple(self._units_of),
            is_writable=standard.is_writable,
        )
        automatic = DeviceProperty(Property.NIKON_AUTO_ISO, Type.UINT8, 1, (0, 1))
        warning = DeviceProperty(
            Property.NIKON_RETRACTABLE_LENS, Type.UINT8, 0, limits=(0, 1, 1), is_writable=False
        )
        lens = [DeviceProperty(code, kind, value, is_writable=False) for code, kind, value in _LENS]
        return [*items, exact, warning, *lens, *([automatic] if self.config.auto_iso else [])]

    def execute(
        self, code: int, transaction: int, parameters: Sequence[int], data: bytes
    ) -> Reply | None:
        """Execute an operation; a property says that a retractable lens is not extended."""
        if (warning := self.properties.get(Property.NIKON_RETRACTABLE_LENS)) is not None:
            warning.value = int(self.body.faults.state == "retracted lens")
        return super().execute(code, transaction, parameters, data)

    def _pair(self, fractions: Sequence[tuple[int, int]]) -> None:
        """Note which fraction stands for which value of 500D.

        Several fractions may round to one value, which then stands for the first.
        """
        self._units_of = dict(fractions)
        self._fraction_of = {units: fraction for fraction, units in reversed(fractions)}

    refusals: ClassVar[Mapping[str, Response]] = {
        **Responder.refusals,
        "playback": Response.NIKON_INVALID_STATUS,
        "movie": Response.NIKON_INVALID_STATUS,
        "lens": Response.NIKON_LENS_RING,
    }

    def all_properties(self) -> list[DeviceProperty]:
        items = super().all_properties()
        found = {item.code: item for item in items}
        standard = found.get(Property.EXPOSURE_TIME)
        exact = found.get(Property.NIKON_EXPOSURE_TIME)
        if self.facts is not None and exact is not None:
            units = standard.choices if standard is not None else ()
            self._pair([(number, _nearest_units(number, units)) for number in exact.choices])
            if standard is not None and isinstance(exact.value, int):
                standard.value = self._units_of.get(exact.value, standard.value)
        return items

    def make_operations(self) -> dict[int, Handler]:
        self._polled: deque[tuple[int, int]] = deque(maxlen=64)
        return {
            **super().make_operations(),
            Operation.NIKON_CAPTURE: self._capture,
            Operation.NIKON_DRIVE_FOCUS: self.accept,
            Operation.NIKON_SET_CONTROL_MODE: self._set_control_mode,
            Operation.NIKON_CHECK_EVENTS: self._check_events,
            Operation.NIKON_DEVICE_READY: self._device_ready,
            Operation.NIKON_GET_VENDOR_CODES: self._vendor_codes,
            Operation.NIKON_CAPTURE_TO: self._capture_to,
            Operation.NIKON_TERMINATE_CAPTURE: self._terminate,
        }

    def time_of(self, code: int, value: int) -> float | None:
        if code == Property.EXPOSURE_TIME and Property.NIKON_EXPOSURE_TIME in self.properties:
            value = self._fraction_of.get(value, BULB)
        elif code == Property.EXPOSURE_TIME:
            return None if value == BULB else true_time_s(value)
        elif code != Property.NIKON_EXPOSURE_TIME:
            return None
        return None if value >= _SPECIAL or not value & 0xFFFF else (value >> 16) / (value & 0xFFFF)

    def gain(self) -> float:
        """Return the gain: the one that is set, unless the camera chooses it itself."""
        automatic = self.properties.get(Property.NIKON_AUTO_ISO)
        return super().gain() * (AUTOMATIC_GAIN if automatic and automatic.value else 1)

    def listed_properties(self) -> list[int]:
        """Return the properties in the device info: without those that 90CA lists."""
        is_hiding = self.facts is not None or self.config.hides_properties
        hidden = self._vendor_properties() if is_hiding else ()
        return [code for code in super().listed_properties() if code not in hidden]

    def _vendor_properties(self) -> list[int]:
        if self.facts is not None:
            return [code for code in self.facts.hidden if code in self.properties]
        hidden = (
            Property.NIKON_AUTO_ISO,
            Property.NIKON_EXPOSURE_TIME,
            Property.NIKON_RETRACTABLE_LENS,
        )
        return [code for code in hidden if code in self.properties]

    def after_set(self, code: int) -> tuple[int, ...]:
        exact = self.properties.get(Property.NIKON_EXPOSURE_TIME)
        standard = self.properties.get(Property.EXPOSURE_TIME)
        if exact is None or standard is None:
            return (code,)
        if code == Property.EXPOSURE_TIME:
            exact.value = self._fraction_of[self.properties.number(code)]
        elif code == Property.NIKON_EXPOSURE_TIME:
            standard.value = self._units_of[self.properties.number(code)]
        else:
            return (code,)
        return self.shutter_codes

    def announce(self, event: int, *parameters: int) -> None:
        super().announce(event, *parameters)
        if self.sends_events:
            self._polled.append((event, parameters[0] if parameters else 0))

    def _start(self, standard: DeviceProperty) -> int:
        assert isinstance(standard.value, int)
        if standard.value not in self._fraction_of:
            standard.value = standard.default = standard.choices[0]
        return int(standard.value)

    def _set_control_mode(self, parameters: Sequence[int], data: bytes) -> Reply:
        """Let the host set the shutter time, where it could not before."""
        if self.config.needs_control:
            for code in self.shutter_codes:
                if code in self.properties:
                    self.properties[code].is_writable = tuple(parameters[:1]) == (1,)
        return Reply()

    def _capture(self, parameters: Sequence[int], data: bytes) -> Reply | None:
        return self.release(is_bulb=self.exposure_time_s() is None, store=self._keep_in_memory)

    def _capture_to(self, parameters: Sequence[int], data: bytes) -> Reply | None:
        config, target = self.config, parameters[1] if len(parameters) > 1 else _TO_CARD
        if len(parameters) != config.parameters_9207:
            too_many = len(parameters) > config.parameters_9207
            return Reply(
                Response.PARAMETER_NOT_SUPPORTED if too_many else Response.INVALID_PARAMETER
            )
        if target not in (_TO_CARD, _TO_MEMORY):
            return Reply(Response.INVALID_PARAMETER)
        if config.needs_focus and parameters[0] == _WITHOUT_FOCUSING:
            return Reply(Response.NIKON_INVALID_STATUS)
        store = self._keep_in_memory if target == _TO_MEMORY else self.store
        return self.release(is_bulb=self.exposure_time_s() is None, store=store)

    def _keep_in_memory(self, files: Sequence[ImageFile]) -> None:
        self.card.memory = {
            IN_MEMORY + i: self.card.stored(file, 0) for i, file in enumerate(files)
        }
        for handle in self.card.memory:
            self.announce(Event.NIKON_OBJECT_IN_MEMORY, handle)
        self.announce(Event.CAPTURE_COMPLETE, 0)

    def _terminate(self, parameters: Sequence[int], data: bytes) -> Reply:
        if not self.body.is_exposing:
            return Reply(Response.INVALID_TRANSACTION)
        self.body.abort()
        return Reply()

    def _device_ready(self, parameters: Sequence[int], data: bytes) -> Reply:
        return Reply(Response.DEVICE_BUSY if self.body.is_exposing else Response.OK)

    def _check_events(self, parameters: Sequence[int], data: bytes) -> Reply:
        if self.body.is_exposing and not self.config.overlap:
            return Reply(Response.DEVICE_BUSY)
        events = list(self._polled)
        self._polled.clear()
        listed = b"".join(struct.pack("<HI", *event) for event in events)
        return Reply(data=struct.pack("<H", len(events)) + listed)

    def _vendor_codes(self, parameters: Sequence[int], data: bytes) -> Reply:
        return Reply(data=pack_list(self._vendor_properties()))


def _nearest_units(fraction: int, units: Sequence[int]) -> int:
    """Return the value of 500D that is nearest to a fraction."""
    if fraction >= _SPECIAL or not fraction & 0xFFFF:
        return BULB
    time_s = Fraction(fraction >> 16, fraction & 0xFFFF)
    if not units:
        return to_units(time_s)
    return min(units, key=lambda number: abs(number - time_s * UNITS_PER_S))
