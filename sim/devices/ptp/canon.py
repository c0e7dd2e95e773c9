"""A camera with Canon's EOS extension of PTP, as libgphoto2 describes it.

Properties are set by a vendor operation and read by polling for records of changes.  A record has
size, type and data; a record of type 0 ends the list.
"""

from __future__ import annotations

import math
import struct
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from typing import ClassVar

from camctl.sim.devices.ptp.config import Identity
from camctl.sim.devices.ptp.properties import DeviceProperty, battery
from camctl.sim.devices.ptp.protocol import (
    Event,
    Format,
    Handler,
    Operation,
    Property,
    Reply,
    Response,
    Type,
    pack_list,
    unpack_number,
)
from camctl.sim.devices.ptp.responder import Responder
from camctl.sim.devices.ptp.store import FORMATS, STORE, StoredObject
from camctl.sim.devices.still_body import ImageFile

BULB = 0x0C  # code of a shutter time
CARD, HOST = 2, 4  # capture destinations
_HOST_HANDLE = 0x9000_0001  # of a picture in memory whose destination is the host
_STEPS_A_STOP = 8  # of codes
_ONE_SECOND, _F1, _ISO_100 = 0x38, 0x08, 0x48  # codes
# Thirds of a stop, rounded to eighths as in Canon's codes.
_THIRDS = (0, 3, 5)
SHUTTER_CODES = tuple(code for code in range(0x10, 0xA1) if code % _STEPS_A_STOP in _THIRDS)
_TENTH_OF_SECOND = 0x53
_HALF = 1  # button
_OUTPUT_PC, _NOT_READY = 8, 1  # property D1B0; a result of the release


def stops_of_code(code: int, zero: int) -> float:
    """Return the stops from the code `zero`, a whole stop, to another code.

    Codes count eighths; 3 and 5 stand for one and two thirds, which the cameras expose.
    """
    whole, eighths = divmod(code - zero, _STEPS_A_STOP)
    thirds = _THIRDS.index(eighths) / 3 if eighths in _THIRDS else eighths / _STEPS_A_STOP
    return whole + thirds


def _code_of_stops(stops: float, zero: int) -> int:
    """Return the code that is nearest to a number of stops, in thirds, from the code `zero`."""
    whole, thirds = divmod(round(3 * stops), 3)
    return zero + _STEPS_A_STOP * whole + _THIRDS[thirds]


def _time_of_code(code: int) -> float:
    return float(2.0 ** -stops_of_code(code, _ONE_SECOND))


def _f_number_of_code(code: int) -> float:
    return float(2.0 ** (stops_of_code(code, _F1) / 2))


def _code_of_iso(iso: int) -> int:
    return _code_of_stops(math.log2(iso / 100), _ISO_100)


def code_of_f_number(hundredths: int) -> int:
    """Return the code of an f-number, in hundredths."""
    return _code_of_stops(2 * math.log2(hundredths / 100), _F1)


class CanonResponder(Responder):
    """A camera whose settings are codes in eighths of a stop and whose events are polled."""

    identity: ClassVar[Identity] = Identity(
        0x04A9, 0x323A, "Canon Inc.", "EOS 5D (virtual)", 0x0B, 1
    )
    missing: ClassVar[frozenset[int]] = frozenset(
        {
            Operation.INITIATE_CAPTURE,
            Operation.INITIATE_OPEN_CAPTURE,
            Operation.TERMINATE_OPEN_CAPTURE,
            Operation.EOS_RELEASE_ON,
            Operation.EOS_RELEASE_OFF,
        }
    )
    takes_data: ClassVar[frozenset[int]] = Responder.takes_data | {Operation.EOS_SET_PROPERTY}
    shutter_codes: ClassVar[tuple[int, ...]] = (Property.EOS_SHUTTER,)
    object_formats: ClassVar[Mapping[str, int]] = {**FORMATS, "dng": Format.CANON_RAW}
    refusals: ClassVar[Mapping[str, Response]] = {
        **Responder.refusals,
        "playback": Response.CANON_REFUSED,
        "movie": Response.CANON_REFUSED,
        "lens": Response.CANON_LENS_COVER,
    }
    program_code: ClassVar[int] = Property.EOS_PROGRAM
    manual: ClassVar[int] = 3
    automatic: ClassVar[int] = 0
    events: ClassVar[tuple[int, ...]] = ()

    def make_properties(self) -> list[DeviceProperty]:
        config = self.config
        is_manual = config.mode != "auto"
        codes = (*([BULB] if config.bulb else []), *SHUTTER_CODES)
        items = [
            battery(),
            DeviceProperty(
                Property.EOS_SHUTTER, Type.UINT16, _TENTH_OF_SECOND, codes, is_writable=is_manual
            ),
            DeviceProperty(
                Property.EOS_PROGRAM,
                Type.UINT16,
                self.manual if is_manual else self.automatic,
                (self.automatic, self.manual),
                is_writable=False,
            ),
            DeviceProperty(Property.EOS_AVAILABLE_SHOTS, Type.UINT32, 999, is_writable=False),
            DeviceProperty(Property.EOS_DESTINATION, Type.UINT32, CARD, (CARD, HOST)),
            DeviceProperty(
                Property.EOS_LENS_NAME, Type.STRING, "EF50mm f/1.8 STM", is_writable=False
            ),
        ]
        if config.needs_output:
            items.append(DeviceProperty(Property.EOS_OUTPUT, Type.UINT32, 0, (0, 1, 2, _OUTPUT_PC)))
        if config.isos:
            isos = tuple(dict.fromkeys(_code_of_iso(iso) for iso in config.isos))
            items.append(DeviceProperty(Property.EOS_ISO, Type.UINT16, isos[0], isos))
        if config.f_numbers:
            stops = tuple(dict.fromkeys(code_of_f_number(n) for n in config.f_numbers))
            items.append(DeviceProperty(Property.EOS_APERTURE, Type.UINT16, min(stops), stops))
        return items

    def listed_properties(self) -> list[int]:
        """Return the battery level only: hosts learn Canon's properties from the records."""
        return [Property.BATTERY_LEVEL]

    def make_operations(self) -> dict[int, Handler]:
        self._records: deque[bytes] = deque(maxlen=64)
        self._changed: set[int] = set()
        self._is_remote, self._is_polled = not self.config.remote_mode, False
        self._empty_polls = self.config.empty_polls
        card, when_ready = self.card, self.when_ready
        return {
            **super().make_operations(),
            Operation.EOS_GET_STORAGE_IDS: when_ready(card.get_storage_ids),
            Operation.EOS_GET_STORAGE_INFO: when_ready(self._get_storage_info),
            Operation.EOS_GET_OBJECT: when_ready(card.get_object),
            Operation.EOS_GET_PARTIAL_OBJECT: when_ready(self._get_part),
            Operation.EOS_GET_DEVICE_INFO: self._get_eos_info,
            Operation.EOS_RELEASE: self._release,
            Operation.EOS_RELEASE_ON: self._press,
            Operation.EOS_RELEASE_OFF: self.accept,
            Operation.EOS_SET_PROPERTY: self._set_eos_property,
            Operation.EOS_SET_REMOTE_MODE: self._set_remote_mode,
            Operation.EOS_SET_EVENT_MODE: self._set_event_mode,
            Operation.EOS_GET_EVENTS: self._get_events,
            Operation.EOS_TRANSFER_COMPLETE: self._transfer_complete,
            Operation.EOS_HOST_CAPACITY: self.accept,
            Operation.EOS_KEEP_ON: self.accept,
            Operation.EOS_BULB_START: self._bulb_start,
            Operation.EOS_BULB_END: self._bulb_end,
            Operation.EOS_REQUEST_PROPERTY: self._request_property,
        }

    def close_session(self) -> None:
        super().close_session()
        self._is_remote = not self.config.remote_mode
        self._is_polled = False

    def time_of(self, code: int, value: int) -> float | None:
        return _time_of_code(value) if code == Property.EOS_SHUTTER and value != BULB else None

    def gain(self) -> float:
        if Property.EOS_ISO not in self.properties:
            return 1.0
        return float(2.0 ** stops_of_code(self.properties.number(Property.EOS_ISO), _ISO_100))

    def light(self) -> float:
        aperture, now = self.properties.get(Property.EOS_APERTURE), self.f_number()
        if aperture is None or now is None:
            return 1.0
        return (_f_number_of_code(min(aperture.choices)) / now) ** 2

    def f_number(self) -> float | None:
        if Property.EOS_APERTURE not in self.properties:
            return None
        return _f_number_of_code(self.properties.number(Property.EOS_APERTURE))

    def announce_changed(self, codes: Iterable[int]) -> None:
        self._changed.update(codes)

    def store(self, files: Sequence[ImageFile]) -> None:
        """Put files where the destination property says, and record them for the next poll."""
        if self.properties.number(Property.EOS_DESTINATION) == HOST:
            self.card.memory = {
                _HOST_HANDLE + i: self.card.stored(file, 0) for i, file in enumerate(files)
            }
            kind, items = Event.EOS_REQUEST_TRANSFER, self.card.memory
        else:
            handles = self.card.add(files)
            kind, items = Event.EOS_OBJECT_ADDED, {h: self.card.objects[h] for h in handles}
        if self.sends_events:
            self._records.extend(_object_record(kind, handle, o) for handle, o in items.items())

    def _get_storage_info(self, parameters: Sequence[int], data: bytes) -> Reply:
        return Reply(data=self.card.packed())

    def _get_part(self, parameters: Sequence[int], data: bytes) -> Reply:
        return self.card.get_part(parameters, data, is_whole=True)

    def _get_eos_info(self, parameters: Sequence[int], data: bytes) -> Reply:
        kinds = (
            Event.EOS_OBJECT_ADDED,
            Event.EOS_REQUEST_TRANSFER,
            Event.EOS_PROPERTY_CHANGED,
            Event.EOS_CHOICES_CHANGED,
        )
        lists = pack_list(kinds, Type.UINT32) + pack_list(sorted(self.properties), Type.UINT32)
        lists += pack_list([], Type.UINT32)
        return Reply(data=struct.pack("<I", 4 + len(lists)) + lists)

    def _set_remote_mode(self, parameters: Sequence[int], data: bytes) -> Reply:
        mode = parameters[0] if parameters else 0
        self._is_remote = bool(mode) and mode == self.config.remote_mode
        return Reply()

    def _set_event_mode(self, parameters: Sequence[int], data: bytes) -> Reply:
        self._is_polled = bool(parameters and parameters[0])
        if self._is_polled:
            self._changed.update(self.properties)
        return Reply()

    def _get_events(self, parameters: Sequence[int], data: bytes) -> Reply:
        records = []
        if self._is_polled and self._empty_polls:
            self._empty_polls -= 1
        elif self._is_polled:
            for code in sorted(self._changed):
                records += _property_records(self.properties[code])
            records += self._records
            self._changed.clear()
            self._records.clear()
        return Reply(data=b"".join(records) + struct.pack("<II", 8, 0))

    def _request_property(self, parameters: Sequence[int], data: bytes) -> Reply:
        if not parameters or parameters[0] not in self.properties:
            return Reply(Response.GENERAL_ERROR)
        self._changed.add(parameters[0])
        return Reply()

    def _set_eos_property(self, parameters: Sequence[int], data: bytes) -> Reply:
        """Set a property; the data are size, code and value of 32 bits each."""
        if not self._is_remote:
            return Reply(Response.ACCESS_DENIED)
        if len(data) != 12 or unpack_number(Type.UINT32, data[:4]) != len(data):
            return Reply(Response.INVALID_PARAMETER)
        code, value = struct.unpack("<II", data[4:])
        item = self.properties.get(code)
        return Reply(self.set_number(item, value) if item else Response.PROPERTY_NOT_SUPPORTED)

    def _press(self, parameters: Sequence[int], data: bytes) -> Reply | None:
        """Press the button: 1 half, which focuses; 2 full; 3 both."""
        if tuple(parameters[:1]) == (_HALF,) and self._is_remote:
            return Reply()
        return self._release(parameters, data)

    def _release(self, parameters: Sequence[int], data: bytes) -> Reply | None:
        if not self._is_remote:
            return Reply(Response.ACCESS_DENIED)
        if self.exposure_time_s() is None:
            return Reply(Response.GENERAL_ERROR)  # there are other operations for bulb
        if self.config.needs_output and self.properties[Property.EOS_OUTPUT].value != _OUTPUT_PC:
            return Reply(parameters=(_NOT_READY,))
        return _with_result(self.release())

    def _bulb_start(self, parameters: Sequence[int], data: bytes) -> Reply | None:
        if not self._is_remote or self.exposure_time_s() is not None:
            return Reply(Response.ACCESS_DENIED)
        return _with_result(self.release(is_bulb=True))

    def _bulb_end(self, parameters: Sequence[int], data: bytes) -> Reply:
        if not self.body.is_exposing:
            return Reply(Response.GENERAL_ERROR)
        self.body.end_bulb()
        return Reply(parameters=(0,))

    def _transfer_complete(self, parameters: Sequence[int], data: bytes) -> Reply:
        if parameters:
            self.card.memory.pop(parameters[0], None)
        return Reply()


def _with_result(reply: Reply | None) -> Reply | None:
    """Return a reply with Canon's result code as parameter: 0 for success."""
    return Reply(reply.code, (int(reply.code != Response.OK),)) if reply else None


def _record(kind: int, body: bytes) -> bytes:
    return struct.pack("<II", 8 + len(body), kind) + body


def _property_records(item: DeviceProperty) -> list[bytes]:
    """Return records of the value and, if there is a list, of the allowed values; 32 bits each.

    A text is ASCII with a NUL.
    """
    value = item.value
    packed = value.encode() + b"\0" if isinstance(value, str) else struct.pack("<I", value)
    records = [_record(Event.EOS_PROPERTY_CHANGED, struct.pack("<I", item.code) + packed)]
    if item.choices:
        choices = item.choices if item.is_writable else ()
        numbers = (item.code, 3, len(choices), *choices)  # 3: numbers of 16 or 32 bits
        records.append(
            _record(Event.EOS_CHOICES_CHANGED, struct.pack(f"<{len(numbers)}I", *numbers))
        )
    return records


def _object_record(kind: int, handle: int, item: StoredObject) -> bytes:
    name = item.name.encode("ascii") + bytes(4 - len(item.name) % 4)
    size = len(item.data)
    if kind == Event.EOS_REQUEST_TRANSFER:
        # At 8 handle, 12 format, 20 size, 28 name.
        return _record(kind, struct.pack("<IIIII", handle, item.format, 0, size, 0) + name)
    # At 8 handle, 12 store, 16 format, 28 size, 32 folder, 40 name.
    head = struct.pack("<IIIIIIII", handle, STORE, item.format, 0, 0, size, item.parent, handle)
    return _record(kind, head + name)
