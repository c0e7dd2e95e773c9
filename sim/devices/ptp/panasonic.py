"""A Panasonic camera under control by a computer, as libgphoto2 describes the GH5.

Properties have codes of 32 bits: each is described and read under one code, and set under the next.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import ClassVar

from camctl.sim.devices.ptp.config import Identity
from camctl.sim.devices.ptp.properties import DeviceProperty, battery
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
from camctl.sim.devices.still_body import ImageFile

ISO, SHUTTER, APERTURE = 0x0200_0020, 0x0200_0030, 0x0200_0040  # codes of properties
_STORAGE, _RELEASE = 0x0001_0001, 0x0300_0011  # parameters of opening and of capturing
_LONG = 0x8000_0000  # thousandths of a second; without it thousandths of 1/s
_HEADER_WORDS = 20  # of a description, before the data type


class PanasonicResponder(Responder):
    """A camera that needs a session of the maker's, and lists no shutter times."""

    identity: ClassVar[Identity] = Identity(0x04DA, 0x2382, "Panasonic", "DC-GH5 (virtual)", 0x1C)
    takes_data: ClassVar[frozenset[int]] = Responder.takes_data | {Operation.PANASONIC_SET}
    events: ClassVar[tuple[int, ...]] = (Event.PANASONIC_OBJECT_ADDED,)

    def make_properties(self) -> list[DeviceProperty]:
        """Return the battery level; the others have codes of their own."""
        return (
            [battery()] if self.facts is None or self._is_remote_body else super().make_properties()
        )

    @property
    def _is_remote_body(self) -> bool:
        """True for bodies with the maker's operations; others have the standard's properties."""
        assert self.facts is not None
        return Operation.PANASONIC_CAPTURE in self.facts.all_operations

    def make_operations(self) -> dict[int, Handler]:
        isos, stops = self.config.isos or (200,), self.config.f_numbers or (280,)
        self._dials = {
            ISO: DeviceProperty(ISO, Type.UINT32, isos[0], isos),
            SHUTTER: DeviceProperty(SHUTTER, Type.UINT32, 8_000_000),
            APERTURE: DeviceProperty(
                APERTURE, Type.UINT16, min(stops) // 10, tuple(number // 10 for number in stops)
            ),
        }
        self._is_open = False
        return {
            **super().make_operations(),
            Operation.PANASONIC_OPEN: self._open,
            Operation.PANASONIC_CLOSE: self._close,
            Operation.PANASONIC_DESCRIPTION: self._describe,
            Operation.PANASONIC_GET: self._get,
            Operation.PANASONIC_SET: self._set,
            Operation.PANASONIC_CAPTURE: self._capture,
        }

    def exposure_time_s(self) -> float | None:
        if Property.EXPOSURE_TIME in self.properties:
            return super().exposure_time_s()
        number = int(self._dials[SHUTTER].value)
        return (number - _LONG) / 1000 if number >= _LONG else 1000 / number

    def gain(self) -> float:
        if Property.EXPOSURE_INDEX in self.properties:
            return super().gain()
        return int(self._dials[ISO].value) / 100

    def light(self) -> float:
        if Property.F_NUMBER in self.properties:
            return super().light()
        aperture = self._dials[APERTURE]
        return float((min(aperture.choices) / int(aperture.value)) ** 2)

    def f_number(self) -> float | None:
        if Property.F_NUMBER in self.properties:
            return super().f_number()
        return int(self._dials[APERTURE].value) / 10

    def store(self, files: Sequence[ImageFile]) -> None:
        """Announce files by Panasonic's event where the body has it."""
        if Operation.PANASONIC_CAPTURE not in self.operations:
            super().store(files)
            return
        for handle in self.card.add(files):
            self.announce(Event.PANASONIC_OBJECT_ADDED, handle)

    def _open(self, parameters: Sequence[int], data: bytes) -> Reply:
        if tuple(parameters[:1]) != (_STORAGE,):
            return Reply(Response.INVALID_PARAMETER)
        self._is_open = True
        return Reply()

    def _close(self, parameters: Sequence[int], data: bytes) -> Reply:
        self._is_open = False
        return Reply()

    def _dial(self, parameters: Sequence[int], offset: int = 0) -> DeviceProperty | None:
        return self._dials.get(parameters[0] - offset) if parameters and self._is_open else None

    def _describe(self, parameters: Sequence[int], data: bytes) -> Reply:
        item = self._dial(parameters)
        if item is None:
            return Reply(Response.PROPERTY_NOT_SUPPORTED)
        head = struct.pack("<II", item.code, _HEADER_WORDS).ljust(4 * _HEADER_WORDS, b"\0")
        body = struct.pack("<II", item.kind, 2) + item.packed() + pack_list(item.choices, item.kind)
        return Reply(data=head + body)

    def _get(self, parameters: Sequence[int], data: bytes) -> Reply:
        item = self._dial(parameters)
        if item is None:
            return Reply(Response.PROPERTY_NOT_SUPPORTED)
        value = item.packed()
        return Reply(data=struct.pack("<II", item.code + 1, len(value)) + value)

    def _set(self, parameters: Sequence[int], data: bytes) -> Reply:
        item = self._dial(parameters, offset=1)
        if item is None:
            return Reply(Response.PROPERTY_NOT_SUPPORTED)
        size = len(pack_value(item.kind, 0))
        if data[:8] != struct.pack("<II", item.code + 1, size):
            return Reply(Response.INVALID_PARAMETER)
        value = unpack_number(item.kind, data[8:])
        return Reply(Response.INVALID_VALUE if not value else self.set_number(item, value))

    def _capture(self, parameters: Sequence[int], data: bytes) -> Reply | None:
        if not self._is_open or tuple(parameters[:1]) != (_RELEASE,):
            return Reply(Response.INVALID_PARAMETER)
        return self.release()
