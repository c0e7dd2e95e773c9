"""A camera with Sony's extension of PTP, as libgphoto2 describes it.

A handshake is required; all properties are read at once; control codes press and release the
shutter button; a picture is read from memory under one fixed handle.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import ClassVar

from camctl.sim.devices.ptp.config import SONY_COMPRESSIONS, Identity
from camctl.sim.devices.ptp.properties import (
    DeviceProperty,
    aperture,
    battery,
    compression,
    program,
)
from camctl.sim.devices.ptp.protocol import (
    Event,
    Handler,
    Operation,
    Property,
    Reply,
    Response,
    Type,
    pack_list,
    pack_value,
    unpack_number,
)
from camctl.sim.devices.ptp.responder import Responder
from camctl.sim.devices.ptp.store import ALL, StoredObject
from camctl.sim.devices.still_body import ImageFile

BULB = 0  # shutter number
IN_MEMORY = 0xFFFF_C001  # handle of the oldest picture in memory
_READY = 0x8000  # added to the number of files in memory, in property D215
_PRESSED, _RELEASED = 2, 1  # states of a button
# Properties that set another one, on newer cameras.
_SET_BY: dict[int, int] = {
    Property.SONY_SHUTTER_SET: Property.SONY_SHUTTER,
    Property.SONY_ISO_SET: Property.SONY_ISO,
}
_BY_DIALS, _BY_HOST = 0, 1  # property D25A: what sets the exposure
_FULL_ISO_DIAL = 3  # fewer choices were recorded while the camera chose the sensitivity
_HANDSHAKE = (1, 2, 3)  # parameters of SONY_CONNECT


class SonyResponder(Responder):
    """A camera with shutter times as numerator << 16 | denominator, which are set or stepped."""

    identity: ClassVar[Identity] = Identity(
        0x054C, 0x094E, "Sony Corporation", "ILCE-6000 (virtual)", 0x11, 100
    )
    missing: ClassVar[frozenset[int]] = frozenset(
        {
            Operation.INITIATE_CAPTURE,
            Operation.INITIATE_OPEN_CAPTURE,
            Operation.TERMINATE_OPEN_CAPTURE,
        }
    )
    takes_data: ClassVar[frozenset[int]] = Responder.takes_data | {
        Operation.SONY_SET_PROPERTY,
        Operation.SONY_CONTROL,
    }
    shutter_codes: ClassVar[tuple[int, ...]] = (Property.SONY_SHUTTER,)
    iso_code: ClassVar[int] = Property.SONY_ISO
    automatic_iso: ClassVar[int] = 0xFF_FFFF
    compressions: ClassVar[Mapping[str, int]] = SONY_COMPRESSIONS
    events: ClassVar[tuple[int, ...]] = (Event.SONY_OBJECT_ADDED, Event.SONY_PROPERTY_CHANGED)

    def make_properties(self) -> list[DeviceProperty]:
        config = self.config
        # Bulb, then the longest first: a step up the dial is the next shorter time.
        longest_first = sorted(config.times, reverse=True)
        times = [time_s.numerator << 16 | time_s.denominator for time_s in longest_first]
        start = min(times, key=lambda value: abs(_seconds(value) - 0.1))
        shutter = DeviceProperty(
            Property.SONY_SHUTTER,
            Type.UINT32,
            start,
            (*([BULB] if config.bulb else []), *times),
            is_writable=config.mode != "auto",
        )
        self._dial_numbers = {Property.SONY_SHUTTER: self._within_limits(times)}
        items = [
            battery(),
            *compression(config, self.compressions, is_always_there=True),
            *aperture(config),
            DeviceProperty(Property.FOCUS_MODE, Type.UINT16, 1, is_writable=False),
            program(config),
            shutter,
            DeviceProperty(Property.SONY_PRIORITY, Type.INT8, _BY_DIALS, (_BY_DIALS, _BY_HOST)),
            DeviceProperty(Property.SONY_OBJECT_IN_MEMORY, Type.UINT16, 0, is_writable=False),
        ]
        if config.isos:
            items.append(
                DeviceProperty(Property.SONY_ISO, Type.UINT32, config.isos[0], config.isos)
            )
        return items

    def all_properties(self) -> list[DeviceProperty]:
        """Return the properties; a dial without a list has the numbers of its setting property.

        Where those were recorded while the camera chose the value itself, they are few: then the
        numbers are the usual ones.
        """
        items = super().all_properties()
        by_code = {item.code: item for item in items}
        full = {Property.SONY_SHUTTER: len(self.config.times), Property.SONY_ISO: _FULL_ISO_DIAL}
        for setter, shown in _SET_BY.items():
            fact = self.facts.properties.get(setter) if self.facts else None
            before = self.facts.properties.get(shown) if self.facts else None
            if fact is None or not fact.writable or before is None or len(before.choices) > 1:
                continue
            item, usual = by_code[shown], self._numbers(by_code[shown])
            numbers = fact.choices if len(fact.choices) >= full[Property(shown)] else usual
            by_code[setter].choices = numbers
            self._dial_numbers[Property(shown)] = numbers
            if item.choices:
                item.choices = numbers
                item.value = numbers[len(numbers) // 2]
        return items

    def _within_limits(self, times: Sequence[int]) -> tuple[int, ...]:
        """Return the shutter numbers within the range that a recorded body gives, by their time."""
        fact = self.facts.properties.get(Property.SONY_SHUTTER) if self.facts else None
        if fact is None or fact.range is None or not fact.range[0]:
            return tuple(times)
        shortest, longest = (_seconds(number) for number in fact.range[:2])
        return tuple(number for number in times if shortest <= _seconds(number) <= longest)

    def listed_properties(self) -> list[int]:
        """Return the battery level only: hosts learn the others after the handshake."""
        return [Property.BATTERY_LEVEL]

    def make_operations(self) -> dict[int, Handler]:
        self._steps: list[int] = []  # of the handshake, that have been done
        self._stepping, self._ready_s = False, 0.0
        self._memory: deque[StoredObject] = deque()
        return {
            **super().make_operations(),
            Operation.GET_OBJECT: self.when_ready(self._get_object),
            Operation.GET_OBJECT_HANDLES: self._get_handles,
            Operation.SONY_CONNECT: self._connect,
            Operation.SONY_GET_INFO: self._get_info,
            Operation.SONY_SET_PROPERTY: self._set_sony_property,
            Operation.SONY_CONTROL: self._control,
            Operation.SONY_GET_PROPERTIES: self._get_properties,
        }

    def close_session(self) -> None:
        super().close_session()
        self._steps = []

    def time_of(self, code: int, value: int) -> float | None:
        return _seconds(value) if code == Property.SONY_SHUTTER and value != BULB else None

    def announce_changed(self, codes: Iterable[int]) -> None:
        for code in codes:
            self.announce(Event.SONY_PROPERTY_CHANGED, code)

    def store(self, files: Sequence[ImageFile]) -> None:
        """Keep files in memory until the host has read them."""
        self._memory.extend(self.card.stored(file, 0) for file in files)
        self._show_oldest()
        self.announce(Event.SONY_OBJECT_ADDED, IN_MEMORY)

    def _show_oldest(self) -> None:
        self.card.memory = {IN_MEMORY: self._memory[0]} if self._memory else {}
        count = len(self._memory)
        self.properties[Property.SONY_OBJECT_IN_MEMORY].value = _READY + count if count else 0
        self.announce_changed([Property.SONY_OBJECT_IN_MEMORY])

    def _get_object(self, parameters: Sequence[int], data: bytes) -> Reply:
        reply = self.card.get_object(parameters, data)
        if tuple(parameters[:1]) != (IN_MEMORY,) or reply.code != Response.OK:
            return reply
        return Reply(data=reply.data, sent=self._fetched)

    def _get_handles(self, parameters: Sequence[int], data: bytes) -> Reply | None:
        """Send no answer for all stores, as the cameras do under remote control."""
        if self._is_connected and tuple(parameters[:1]) == (ALL,):
            return None
        return self.card.get_handles(parameters, data)

    def _fetched(self) -> None:
        self.body.note_download(self._memory.popleft().name)
        self._show_oldest()

    @property
    def _is_connected(self) -> bool:
        return tuple(self._steps) == _HANDSHAKE

    def _connect(self, parameters: Sequence[int], data: bytes) -> Reply:
        """Do a step of the handshake: 1, 2, and after SONY_GET_INFO step 3."""
        step = parameters[0] if parameters else 0
        if step == 1:
            self._steps = []
        if step != len(self._steps) + 1 or step > len(_HANDSHAKE):
            return Reply(Response.INVALID_PARAMETER)
        self._steps.append(step)
        self._ready_s = self.body.now() + self.config.startup_s
        return Reply(data=bytes(8))

    def _get_info(self, parameters: Sequence[int], data: bytes) -> Reply:
        if len(self._steps) < 2:
            return Reply(Response.ACCESS_DENIED)
        controls = [Property.SONY_BUTTON_FOCUS, Property.SONY_BUTTON_SHUTTER]
        lists = pack_list(sorted(self.properties)) + pack_list(controls)
        return Reply(data=struct.pack("<H", 0xC8) + lists)

    def _get_properties(self, parameters: Sequence[int], data: bytes) -> Reply:
        """Return all properties.

        Their number and 0; then for each code, type, access, state, default, value and form.
        """
        if not self._is_connected:
            return Reply(Response.ACCESS_DENIED)
        items = [self.properties[code] for code in sorted(self.properties)]
        return Reply(data=struct.pack("<II", len(items), 0) + b"".join(map(_description, items)))

    def _set_sony_property(self, parameters: Sequence[int], data: bytes) -> Reply:
        if not self._is_connected:
            return Reply(Response.ACCESS_DENIED)
        item = self.properties.requested(parameters)
        if item is None:
            return Reply(Response.PROPERTY_NOT_SUPPORTED)
        value = unpack_number(item.kind, data)
        if value is None:
            return Reply(Response.INVALID_VALUE_FORMAT)
        if item.code == Property.SONY_PRIORITY:
            return Reply(self.set_number(item, value))
        if not self._is_by_host:
            return Reply()  # the dials decide
        if item.code in _SET_BY:
            item = self.properties[_SET_BY[item.code]]
        elif item.code == Property.SONY_SHUTTER and not self._is_absolute:
            return Reply()  # older cameras accept the value and ignore it
        if value not in self._numbers(item):
            return Reply(Response.INVALID_VALUE)
        return Reply(self.set_number(item, value))

    @property
    def _is_by_host(self) -> bool:
        """True if the host may set the exposure: property D25A, where the camera has it."""
        priority = self.properties.get(Property.SONY_PRIORITY)
        return priority is None or priority.value == _BY_HOST

    @property
    def _is_absolute(self) -> bool:
        """True if property D20D can be set; bodies that give a range for it have to be stepped."""
        recorded = self.properties[Property.SONY_SHUTTER].limits is not None
        return self.config.absolute and not recorded

    def _numbers(self, item: DeviceProperty) -> tuple[int, ...]:
        """Return the values that a dial has, in its order."""
        return item.choices or self._dial_numbers.get(Property(item.code), ())

    def _control(self, parameters: Sequence[int], data: bytes) -> Reply | None:
        if not self._is_connected:
            return Reply(Response.ACCESS_DENIED)
        code = parameters[0] if parameters else 0
        if code == Property.SONY_BUTTON_FOCUS:
            return Reply()
        if code == Property.SONY_BUTTON_SHUTTER:
            return self._press(unpack_number(Type.UINT16, data))
        item = self.properties.get(code)
        if item is None or not self._numbers(item):
            return Reply(Response.PROPERTY_NOT_SUPPORTED)
        steps = unpack_number(Type.INT8, data[:1])
        if steps is None:
            return Reply(Response.INVALID_VALUE_FORMAT)
        if self._stepping or not self._is_by_host:
            return Reply()  # a step before the last has taken effect is lost
        numbers, now = self._numbers(item), self.properties.number(code)
        nearest = min(numbers, key=lambda number: abs(_seconds(number) - _seconds(now)))
        place = numbers.index(now if now in numbers else nearest) + steps
        target = numbers[min(max(place, 0), len(numbers) - 1)]
        if not item.is_writable:
            return Reply(Response.ACCESS_DENIED)
        self._stepping = True
        if self.config.step_s:
            self.body.call_later(self.config.step_s, partial(self._step_done, item, target))
        else:
            self._step_done(item, target)
        return Reply()

    def _step_done(self, item: DeviceProperty, target: int) -> None:
        self._stepping = False
        item.value = target
        self.announce_changed([item.code])

    def _press(self, button: int | None) -> Reply | None:
        if button == _RELEASED:
            self.body.end_bulb()
            return Reply()
        if button != _PRESSED:
            return Reply(Response.INVALID_VALUE)
        if len(self._memory) >= 16:
            return Reply(Response.DEVICE_BUSY)
        if self.body.now() < self._ready_s:
            return Reply()  # it accepts the button, and takes no picture
        return self.release(is_bulb=self.exposure_time_s() is None)


def _seconds(value: int) -> float:
    return (value >> 16) / ((value & 0xFFFF) or 1)


def _description(item: DeviceProperty) -> bytes:
    is_enabled = 1
    head = struct.pack("<HHBB", item.code, item.kind, item.is_writable, is_enabled)
    return head + pack_value(item.kind, item.default) + item.packed() + item.form()
