"""A camera with Nikon's extension of PTP, as libgphoto2 describes it."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Sequence
from typing import ClassVar

from sim.devices.ptp.config import Identity
from sim.devices.ptp.properties import DeviceProperty, to_units
from sim.devices.ptp.protocol import (
    Event,
    Handler,
    Operation,
    Property,
    Reply,
    Response,
    Type,
    pack_list,
)
from sim.devices.ptp.responder import Responder
from sim.devices.ptp.store import stored
from sim.devices.still_body import ImageFile

BULB = 0xFFFF_FFFF
IN_MEMORY = 0xFFFF_0001  # handle of the first picture in memory
_WAITING_EVENTS = 64
_TO_CARD, _TO_MEMORY = 0, 1


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
        # Several fractions may round to one value of 500D, which then stands for the first.
        self._units_of = dict(fractions)
        self._fraction_of = {units: fraction for fraction, units in reversed(fractions)}
        standard.choices, standard.limits = tuple(sorted(self._fraction_of)), None
        exact = DeviceProperty(
            Property.NIKON_EXPOSURE_TIME,
            Type.UINT32,
            self._fraction_of[self._start(standard)],
            tuple(self._units_of),
            is_writable=standard.is_writable,
        )
        return [*items, exact]

    def make_operations(self) -> dict[int, Handler]:
        """Return the standard operations and Nikon's."""
        self._polled: deque[tuple[int, int]] = deque(maxlen=_WAITING_EVENTS)
        return {
            **super().make_operations(),
            Operation.NIKON_CAPTURE: self._capture,
            Operation.NIKON_DRIVE_FOCUS: self._accept,
            Operation.NIKON_SET_CONTROL_MODE: self._accept,
            Operation.NIKON_CHECK_EVENTS: self._check_events,
            Operation.NIKON_DEVICE_READY: self._device_ready,
            Operation.NIKON_GET_VENDOR_CODES: self._vendor_codes,
            Operation.NIKON_CAPTURE_TO: self._capture_to,
            Operation.NIKON_TERMINATE_CAPTURE: self._terminate,
        }

    def time_of(self, code: int, value: int) -> float | None:
        """Return the time of a value of either shutter property."""
        if code == Property.EXPOSURE_TIME:
            value = self._fraction_of.get(value, BULB)
        elif code != Property.NIKON_EXPOSURE_TIME:
            return None
        return None if value == BULB else (value >> 16) / (value & 0xFFFF)

    def exposure_time_s(self) -> float | None:
        """Return the shutter time that is set; None: bulb."""
        code = Property.NIKON_EXPOSURE_TIME
        return self.time_of(code, self.properties.number(code))

    def after_set(self, code: int) -> tuple[int, ...]:
        """Update the other shutter property."""
        exact = self.properties[Property.NIKON_EXPOSURE_TIME]
        standard = self.properties[Property.EXPOSURE_TIME]
        if code == Property.EXPOSURE_TIME:
            exact.value = self._fraction_of[self.properties.number(code)]
        elif code == Property.NIKON_EXPOSURE_TIME:
            standard.value = self._units_of[self.properties.number(code)]
        else:
            return (code,)
        return self.shutter_codes

    def announce(self, event: int, *parameters: int) -> None:
        """Send an event, and keep it for the next poll."""
        super().announce(event, *parameters)
        if self.sends_events:
            self._polled.append((event, parameters[0] if parameters else 0))

    def _start(self, standard: DeviceProperty) -> int:
        assert isinstance(standard.value, int)
        if standard.value not in self._fraction_of:
            standard.value = standard.default = standard.choices[0]
        return int(standard.value)

    def _accept(self, parameters: Sequence[int], data: bytes) -> Reply:
        return Reply()

    def _capture(self, parameters: Sequence[int], data: bytes) -> Reply | None:
        return self.release(is_bulb=self.exposure_time_s() is None, store=self._keep_in_memory)

    def _capture_to(self, parameters: Sequence[int], data: bytes) -> Reply | None:
        if len(parameters) < 2 or parameters[1] not in (_TO_CARD, _TO_MEMORY):
            return Reply(Response.INVALID_PARAMETER)
        store = self._keep_in_memory if parameters[1] == _TO_MEMORY else self.store
        return self.release(is_bulb=self.exposure_time_s() is None, store=store)

    def _keep_in_memory(self, files: Sequence[ImageFile]) -> None:
        self.card.memory = {IN_MEMORY + i: stored(file, 0) for i, file in enumerate(files)}
        for handle in self.card.memory:
            self.announce(Event.NIKON_OBJECT_IN_MEMORY, handle)
        self.announce(Event.CAPTURE_COMPLETE, 0)

    def _terminate(self, parameters: Sequence[int], data: bytes) -> Reply:
        if not self.body.is_exposing:
            return Reply(Response.INVALID_TRANSACTION)
        self.body.end_bulb()
        return Reply()

    def _device_ready(self, parameters: Sequence[int], data: bytes) -> Reply:
        return Reply(Response.DEVICE_BUSY if self.body.is_exposing else Response.OK)

    def _check_events(self, parameters: Sequence[int], data: bytes) -> Reply:
        events = list(self._polled)
        self._polled.clear()
        listed = b"".join(struct.pack("<HI", *event) for event in events)
        return Reply(data=struct.pack("<H", len(events)) + listed)

    def _vendor_codes(self, parameters: Sequence[int], data: bytes) -> Reply:
        return Reply(data=pack_list([Property.NIKON_EXPOSURE_TIME]))
