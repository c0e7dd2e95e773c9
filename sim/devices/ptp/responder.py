"""A PTP still camera without its cable: sessions, properties, captures, after ISO 15740.

The words are the standard's: the camera is the responder, the host the initiator.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import ClassVar

from sim.devices.ptp.codes import Event, Format, Operation, Property, Response
from sim.devices.ptp.config import COMPRESSIONS, Identity, PtpConfig, kinds_of
from sim.devices.ptp.datasets import (
    DeviceInfo,
    DeviceProperty,
    Handler,
    Reply,
    unpack_number,
)
from sim.devices.ptp.properties import (
    AUTOMATIC,
    CHARGE,
    LOW_CHARGE,
    MANUAL,
    longest_within,
    standard_properties,
    true_time_s,
)
from sim.devices.ptp.store import FORMATS, PICTURE_FOLDER, STORE, Card
from sim.devices.still_body import Exposure, Picture, StillBody

_LOG = 256  # entries that are kept, and operations that are counted: a host may go on for ever


class Responder:
    """The standard's camera; makers' cameras derive from it.

    Args:
        body: shutter and sensor; its lock is held in every call from outside
        config: what the camera is like
        announce: sends an event, with its parameters
        answer: sends the reply of the operation that was answered None
    """

    identity: ClassVar[Identity] = Identity(0x1209, 0x0001, "camctl", "Virtual PTP camera")
    # Operations of the standard that a maker's cameras do not have.
    missing: ClassVar[frozenset[int]] = frozenset()
    # Operations whose data the host sends.
    takes_data: ClassVar[frozenset[int]] = frozenset({Operation.SET_PROPERTY_VALUE})
    # The properties that are the shutter time.
    shutter_codes: ClassVar[tuple[int, ...]] = (Property.EXPOSURE_TIME,)
    program_code: ClassVar[int] = Property.EXPOSURE_PROGRAM
    compressions: ClassVar[Mapping[str, int]] = COMPRESSIONS
    battery_code: ClassVar[int] = Property.BATTERY_LEVEL
    events: ClassVar[tuple[int, ...]] = (
        Event.OBJECT_ADDED,
        Event.OBJECT_REMOVED,
        Event.PROPERTY_CHANGED,
        Event.STORE_FULL,
        Event.CAPTURE_COMPLETE,
    )

    def __init__(
        self,
        body: StillBody,
        config: PtpConfig,
        announce: Callable[[int, Sequence[int]], None],
        answer: Callable[[Reply], None],
    ) -> None:
        self.body = body
        self.config = config
        self.card = Card(config.card_bytes, body.note_download)
        self.session = 0
        self.is_silent = config.event_order == "never"
        self.operations_seen: Counter[str] = Counter()
        self.log: deque[dict[str, object]] = deque(maxlen=_LOG)
        self.properties = {item.code: item for item in self.make_properties()}
        self.operations: dict[int, Handler] = {
            code: handler
            for code, handler in self.make_operations().items()
            if code not in self.missing
        }
        self._announce = announce
        self._answer = answer
        self._transaction = 0
        self._captured_by = 0
        self._open_capture = 0

    def execute(
        self, code: int, transaction: int, parameters: Sequence[int], data: bytes
    ) -> Reply | None:
        """Do an operation; None: it is answered later."""
        if len(self.operations_seen) < _LOG:
            self.operations_seen[f"{code:04X}"] += 1
        self.log.append(
            {"operation": f"{code:04X}", "parameters": list(parameters), "data": data[:64].hex()}
        )
        self._transaction = transaction
        handler = self.operations.get(code)
        if handler is None:
            return Reply(Response.OPERATION_NOT_SUPPORTED)
        if not self.session and code not in (Operation.GET_DEVICE_INFO, Operation.OPEN_SESSION):
            return Reply(Response.SESSION_NOT_OPEN)
        self.properties[self.battery_code].value = (
            LOW_CHARGE if self.body.faults.is_battery_low else CHARGE
        )
        return handler(parameters, data)

    def close_session(self) -> None:
        """Forget the session, as when the cable is pulled."""
        self.session = 0

    def turn_dial(self, mode: str) -> None:
        """Turn the mode dial to "manual" or "auto"."""
        is_manual = mode == "manual"
        self.properties[self.program_code].value = MANUAL if is_manual else AUTOMATIC
        for code in self.shutter_codes:
            self.properties[code].is_writable = is_manual
        self.tell_changed((self.program_code, *self.shutter_codes))

    # What makers do in their own way.

    def make_properties(self) -> list[DeviceProperty]:
        """Return the properties that it has, as they are after switching on."""
        return standard_properties(self.config)

    def make_operations(self) -> dict[int, Handler]:
        """Return what it can do."""
        card, when_ready = self.card, self.when_ready
        operations: dict[int, Handler] = {
            Operation.GET_DEVICE_INFO: self._get_device_info,
            Operation.OPEN_SESSION: self._open_session,
            Operation.CLOSE_SESSION: self._close_session,
            Operation.RESET_DEVICE: self._close_session,
            Operation.GET_STORAGE_IDS: when_ready(card.get_storage_ids),
            Operation.GET_STORAGE_INFO: when_ready(card.get_storage_info),
            Operation.GET_NUM_OBJECTS: when_ready(card.get_number),
            Operation.GET_OBJECT_HANDLES: when_ready(card.get_handles),
            Operation.GET_OBJECT_INFO: when_ready(card.get_info),
            Operation.GET_OBJECT: when_ready(card.get_object),
            Operation.GET_PARTIAL_OBJECT: when_ready(card.get_part),
            Operation.GET_THUMB: when_ready(card.get_thumb),
            Operation.DELETE_OBJECT: when_ready(card.delete),
            Operation.INITIATE_CAPTURE: self._initiate_capture,
            Operation.GET_PROPERTY_DESCRIPTION: self._describe_property,
            Operation.GET_PROPERTY_VALUE: self._get_property,
            Operation.SET_PROPERTY_VALUE: self._set_property,
        }
        if self.config.bulb:
            operations[Operation.INITIATE_OPEN_CAPTURE] = self._initiate_open_capture
            operations[Operation.TERMINATE_OPEN_CAPTURE] = self._terminate_open_capture
        return operations

    def time_of(self, code: int, value: int) -> float | None:
        """Return what a value of a property means as a shutter time, s; None where it is none."""
        return true_time_s(value) if code == Property.EXPOSURE_TIME else None

    def exposure_time_s(self) -> float | None:
        """Return the shutter time that is set; None: bulb."""
        return self.time_of(Property.EXPOSURE_TIME, self.number(Property.EXPOSURE_TIME))

    def gain(self) -> float:
        """Return the linear gain of the sensitivity that is set."""
        code = Property.EXPOSURE_INDEX
        return self.number(code) / 100 if code in self.properties else 1.0

    def light(self) -> float:
        """Return the light that the aperture lets through, 1 for the widest."""
        if Property.F_NUMBER not in self.properties:
            return 1.0
        return float((min(self.config.f_numbers) / self.number(Property.F_NUMBER)) ** 2)

    def after_set(self, code: int) -> tuple[int, ...]:
        """Bring others in line with a property that was set; return all that changed."""
        return (code,)

    def tell_changed(self, codes: Iterable[int]) -> None:
        """Tell the host of properties that have changed."""
        for code in codes:
            self.tell(Event.PROPERTY_CHANGED, code)

    def added(self, pictures: Sequence[Picture]) -> None:
        """Put pictures on the card and tell the host of them."""
        if self.config.folder_event:
            self.tell(Event.OBJECT_ADDED, PICTURE_FOLDER)
        for handle in [self.card.add(picture) for picture in pictures]:
            self.tell(Event.OBJECT_ADDED, handle)
        self.tell(Event.CAPTURE_COMPLETE, self._captured_by)

    # Tools for makers.

    def number(self, code: int) -> int:
        """Return the value of a property that is a number."""
        value = self.properties[code].value
        assert isinstance(value, int)
        return value

    def when_ready(self, handler: Handler) -> Handler:
        """Return `handler`, which a camera without overlap does not do while it exposes."""

        def handle(parameters: Sequence[int], data: bytes) -> Reply | None:
            if self.body.is_exposing and not self.config.overlap:
                return Reply(Response.DEVICE_BUSY)
            return handler(parameters, data)

        return handle

    def tell(self, event: int, *parameters: int) -> None:
        """Send an event, unless this camera never does."""
        if not self.is_silent:
            self._announce(event, parameters)

    def set_number(self, item: DeviceProperty, value: int) -> Response:
        """Set a property as a host wants it."""
        if not item.is_writable:
            return Response.ACCESS_DENIED
        if self.body.is_exposing and not self.config.overlap:
            return Response.DEVICE_BUSY
        if not item.allows(value):
            return Response.INVALID_VALUE
        limit_s, time_s = self.body.faults.clamp_s, self.time_of(item.code, value)
        if limit_s is not None and time_s is not None and time_s > limit_s:
            times = {choice: self.time_of(item.code, choice) for choice in item.choices}
            value = longest_within(item, limit_s, times)
        if value != item.value:
            item.value = value
            self.tell_changed(self.after_set(item.code))
        return Response.OK

    def release(
        self,
        *,
        is_bulb: bool = False,
        kinds: tuple[str, ...] = (),
        added: Callable[[Sequence[Picture]], None] | None = None,
    ) -> Reply | None:
        """Take a picture with what is set: files of `kinds`, handed to `added`."""
        body, faults = self.body, self.body.faults
        kinds = kinds or self._kinds()
        if body.is_exposing:
            return Reply(Response.DEVICE_BUSY)
        if faults.is_battery_low:
            return Reply(Response.GENERAL_ERROR)
        if faults.is_card_full or self.card.free_bytes < body.largest_file * len(kinds):
            self.tell(Event.STORE_FULL, STORE)
            return Reply(Response.STORE_FULL)
        time_s = None if is_bulb else self.exposure_time_s()
        exposure = Exposure(time_s, self.gain(), self.light(), kinds, self.config.quality)
        self._captured_by = self._transaction
        deliver = added or self.added
        if self.config.event_order != "before" or time_s is None:
            body.release(exposure, deliver)
            return Reply()

        def deliver_and_answer(pictures: Sequence[Picture]) -> None:
            deliver(pictures)
            self._answer(Reply())

        body.release(exposure, deliver_and_answer)
        return None

    def _kinds(self) -> tuple[str, ...]:
        if Property.COMPRESSION not in self.properties:
            return kinds_of(self.config.files[0])
        wanted = self.number(Property.COMPRESSION)
        return next(
            kinds_of(choice) for choice in self.config.files if self.compressions[choice] == wanted
        )

    # The standard's operations.

    def _get_device_info(self, parameters: Sequence[int], data: bytes) -> Reply:
        who = self.identity
        formats = sorted({FORMATS[k] for choice in self.config.files for k in kinds_of(choice)})
        info = DeviceInfo(
            vendor_extension=who.extension,
            vendor_version=who.extension_version,
            operations=sorted(self.operations),
            events=self.events,
            properties=self.listed_properties(),
            capture_formats=formats,
            image_formats=[Format.FOLDER, *formats],
            make=who.make,
            model=who.model,
            version="1.0",
            serial=self.config.serial,
        )
        return Reply(data=info.packed())

    def listed_properties(self) -> list[int]:
        """Return the properties that the device info names."""
        return sorted(self.properties)

    def _open_session(self, parameters: Sequence[int], data: bytes) -> Reply:
        if self.session:
            return Reply(Response.SESSION_ALREADY_OPEN, (self.session,))
        if not parameters or not parameters[0]:
            return Reply(Response.INVALID_PARAMETER)
        self.session = parameters[0]
        return Reply()

    def _close_session(self, parameters: Sequence[int], data: bytes) -> Reply:
        self.close_session()
        return Reply()

    def _describe_property(self, parameters: Sequence[int], data: bytes) -> Reply:
        item = self.properties.get(parameters[0]) if parameters else None
        if item is None:
            return Reply(Response.PROPERTY_NOT_SUPPORTED)
        return Reply(data=item.description())

    def _get_property(self, parameters: Sequence[int], data: bytes) -> Reply:
        item = self.properties.get(parameters[0]) if parameters else None
        return Reply(data=item.packed()) if item else Reply(Response.PROPERTY_NOT_SUPPORTED)

    def _set_property(self, parameters: Sequence[int], data: bytes) -> Reply:
        item = self.properties.get(parameters[0]) if parameters else None
        if item is None:
            return Reply(Response.PROPERTY_NOT_SUPPORTED)
        value = unpack_number(item.kind, data)
        if value is None:
            return Reply(
                Response.INVALID_VALUE_FORMAT if item.is_writable else Response.ACCESS_DENIED
            )
        return Reply(self.set_number(item, value))

    def _initiate_capture(self, parameters: Sequence[int], data: bytes) -> Reply | None:
        # Real cameras fail in odd ways without their two parameters; this one says so.
        if len(parameters) < 2:
            return Reply(Response.INVALID_PARAMETER)
        storage, form = parameters[:2]
        if storage not in (0, STORE):
            return Reply(Response.INVALID_STORAGE)
        if not form:
            return self.release()
        wanted = tuple(kind for kind in ("jpeg", "tiff", "dng") if FORMATS[kind] == form)
        offered = {kind for choice in self.config.files for kind in kinds_of(choice)}
        if not wanted or wanted[0] not in offered:
            return Reply(Response.INVALID_FORMAT)
        return self.release(kinds=wanted)

    def _initiate_open_capture(self, parameters: Sequence[int], data: bytes) -> Reply | None:
        if len(parameters) < 2:
            return Reply(Response.INVALID_PARAMETER)
        reply = self.release(is_bulb=True)
        if reply is not None and reply.code == Response.OK:
            self._open_capture = self._transaction
        return reply

    def _terminate_open_capture(self, parameters: Sequence[int], data: bytes) -> Reply:
        if not self.body.is_exposing or tuple(parameters[:1]) != (self._open_capture,):
            return Reply(Response.INVALID_TRANSACTION)
        self.body.end_bulb()
        return Reply()
