"""A PTP still camera without its transport: sessions, properties and captures (ISO 15740).

In the standard's terms the camera is the responder and the host the initiator.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import ClassVar

from camctl.sim.devices.ptp.config import Identity, PtpConfig
from camctl.sim.devices.ptp.picture_settings import PictureSettings
from camctl.sim.devices.ptp.properties import (
    CHARGE,
    LOW_CHARGE,
    DeviceProperty,
    PropertyTable,
    longest_within,
)
from camctl.sim.devices.ptp.protocol import (
    DeviceInfo,
    Event,
    Format,
    Handler,
    Operation,
    Property,
    Reply,
    Response,
    Type,
    unpack_number,
)
from camctl.sim.devices.ptp.store import PICTURE_FOLDER, READ_ONLY, STORE, Card
from camctl.sim.devices.still_body import Exposure, ImageFile, StillBody

_LOG_LENGTH = 256  # operations in the log, and in the counter: a host may never stop


class Responder(PictureSettings):
    """A camera without a maker's extension; the makers' cameras derive from it.

    Args:
        body: shutter and sensor; its lock is held in every call from outside
        config: options of the camera
        send_event: sends an event with its parameters
        send_reply: sends the reply to an operation for which `execute` returned None
    """

    identity: ClassVar[Identity] = Identity(0x1209, 0x0001, "camctl", "Virtual PTP camera")
    # Operations with a data phase from the host.
    takes_data: ClassVar[frozenset[int]] = frozenset({Operation.SET_PROPERTY_VALUE})
    # Responses in states of the body in which it takes no picture.
    refusals: ClassVar[Mapping[str, Response]] = {
        "playback": Response.ACCESS_DENIED,
        "movie": Response.ACCESS_DENIED,
        "lens": Response.GENERAL_ERROR,
        "retracted lens": Response.GENERAL_ERROR,
        "no card": Response.NO_CARD,
    }
    events: ClassVar[tuple[int, ...]] = (
        Event.OBJECT_ADDED,
        Event.OBJECT_REMOVED,
        Event.PROPERTY_CHANGED,
        Event.STORE_FULL,
        Event.CAPTURE_COMPLETE,
    )
    # The event of a new picture, and whether the end of an exposure has one, too.
    added: ClassVar[int] = Event.OBJECT_ADDED
    is_completion_announced: ClassVar[bool] = True

    def __init__(
        self,
        body: StillBody,
        config: PtpConfig,
        send_event: Callable[[int, Sequence[int]], None],
        send_reply: Callable[[Reply], None],
    ) -> None:
        self.body = body
        self.config = config
        self.facts = config.facts
        recorded = self.facts.access if self.facts is not None else None
        self.card = Card(
            body.note_download,
            formats=self.object_formats,
            access=config.access if recorded is None else recorded,
            reuses=config.reuses_names,
        )
        self.session = 0
        self.sends_events = config.event_order != "never"
        self.operation_counts: Counter[str] = Counter()
        self.log: deque[dict[str, object]] = deque(maxlen=_LOG_LENGTH)
        self.properties = PropertyTable(self.all_properties())
        if config.states_size:
            rows, columns = body.sensor.shape[:2]
            size = DeviceProperty(Property.IMAGE_SIZE, Type.STRING, f"{columns}x{rows}")
            self.properties[size.code] = size
        self.operations: dict[int, Handler] = {
            code: handler
            for code, handler in self.make_operations().items()
            if self.has_operation(code)
        }
        self._send_event = send_event
        self._send_reply = send_reply
        self._transaction = 0
        self._captured_by = 0
        self._open_capture = 0

    def execute(
        self, code: int, transaction: int, parameters: Sequence[int], data: bytes
    ) -> Reply | None:
        """Execute an operation and return its reply; None: the reply is sent later."""
        if len(self.operation_counts) < _LOG_LENGTH:
            self.operation_counts[f"{code:04X}"] += 1
        self.log.append(
            {"operation": f"{code:04X}", "parameters": list(parameters), "data": data[:64].hex()}
        )
        self._transaction = transaction
        handler = self.operations.get(code)
        if handler is None:
            return Reply(Response.OPERATION_NOT_SUPPORTED)
        if not self.session and code not in (Operation.GET_DEVICE_INFO, Operation.OPEN_SESSION):
            return Reply(Response.SESSION_NOT_OPEN)
        if code in self.config.crashes_on:
            self.operations = {}
            return None
        if Property.BATTERY_LEVEL in self.properties:
            charge = LOW_CHARGE if self.body.faults.is_battery_low else CHARGE
            self.properties[Property.BATTERY_LEVEL].value = charge
        return handler(parameters, data)

    def close_session(self) -> None:
        self.session = 0

    def turn_dial(self, mode: str) -> None:
        """Turn the mode dial to "manual" or "auto"."""
        is_manual = mode == "manual"
        self.properties[self.program_code].value = self.manual if is_manual else self.automatic
        for code in self.shutter_codes:
            self.properties[code].is_writable = is_manual
        self.announce_changed((self.program_code, *self.shutter_codes))

    # The makers' cameras override these.

    def make_operations(self) -> dict[int, Handler]:
        """Return the camera's operations by code."""
        card, when_ready = self.card, self.when_ready
        operations: dict[int, Handler] = {
            Operation.GET_DEVICE_INFO: self._get_device_info,
            Operation.OPEN_SESSION: self._open_session,
            Operation.CLOSE_SESSION: self._close_session,
            Operation.RESET_DEVICE: self._close_session,
            Operation.GET_STORAGE_IDS: when_ready(card.get_storage_ids),
            Operation.GET_STORAGE_INFO: when_ready(card.get_storage_info),
            Operation.GET_OBJECT_HANDLES: when_ready(card.get_handles),
            Operation.GET_OBJECT_INFO: when_ready(card.get_info),
            Operation.GET_OBJECT: when_ready(card.get_object),
            Operation.GET_PARTIAL_OBJECT: when_ready(card.get_part),
            Operation.DELETE_OBJECT: when_ready(card.delete),
            Operation.INITIATE_CAPTURE: self._initiate_capture,
            Operation.GET_PROPERTY_DESCRIPTION: self.properties.get_description,
            Operation.GET_PROPERTY_VALUE: self.properties.get_value,
            Operation.SET_PROPERTY_VALUE: self._set_property,
        }
        if self.config.bulb:
            operations[Operation.INITIATE_OPEN_CAPTURE] = self._initiate_open_capture
            operations[Operation.TERMINATE_OPEN_CAPTURE] = self._terminate_open_capture
        return operations

    def after_set(self, code: int) -> tuple[int, ...]:
        """Update properties that depend on one that was set; return all that have changed."""
        return (code,)

    def announce_changed(self, codes: Iterable[int]) -> None:
        """Announce changed properties to the host."""
        for code in codes:
            self.announce(Event.PROPERTY_CHANGED, code)

    def store(self, files: Sequence[ImageFile]) -> None:
        """Put files on the card and announce them to the host."""
        if self.config.folder_event:
            self.announce(Event.OBJECT_ADDED, PICTURE_FOLDER)
        for handle in self.card.add(files):
            self.announce(self.added, handle)
        if self.is_completion_announced:
            self.announce(Event.CAPTURE_COMPLETE, self._captured_by)

    def listed_properties(self) -> list[int]:
        """Return the properties in the device info."""
        return sorted(self.properties)

    def listed_operations(self) -> list[int]:
        """Return the operations in the device info."""
        return sorted(set(self.operations).difference(self.config.unlisted))

    # The makers' cameras call these.

    def accept(self, parameters: Sequence[int], data: bytes) -> Reply:
        """Execute an operation that has no effect here."""
        return Reply()

    def when_ready(self, handler: Handler) -> Handler:
        """Return `handler` for a camera that is busy during exposures unless it has overlap."""

        def handle(parameters: Sequence[int], data: bytes) -> Reply | None:
            if self.body.is_exposing and not self.config.overlap:
                return Reply(Response.DEVICE_BUSY)
            return handler(parameters, data)

        return handle

    def announce(self, event: int, *parameters: int) -> None:
        """Send an event, unless this camera sends none."""
        if self.sends_events:
            self._send_event(event, parameters)

    def set_number(self, item: DeviceProperty, value: int) -> Response:
        """Set a numeric property for the host."""
        if not item.is_writable:
            return Response.ACCESS_DENIED
        if self.body.is_exposing and not self.config.overlap:
            return Response.DEVICE_BUSY
        if self.body.faults.state in ("playback", "movie"):
            return self.refusals[self.body.faults.state]
        if not item.allows(value):
            return Response.INVALID_VALUE
        limit_s, time_s = self.body.faults.longest_s, self.time_of(item.code, value)
        if limit_s is not None and time_s is not None and time_s > limit_s:
            times = {choice: self.time_of(item.code, choice) for choice in item.choices}
            value = longest_within(item, limit_s, times)
        if value != item.value:
            item.value = value
            self.announce_changed(self.after_set(item.code))
        return Response.OK

    def release(
        self,
        *,
        is_bulb: bool = False,
        store: Callable[[Sequence[ImageFile]], None] | None = None,
    ) -> Reply | None:
        """Take a picture with the settings in force.

        Args:
            is_bulb: until the host ends it
            store: called with the files; `self.store` if not given
        """
        body, faults = self.body, self.body.faults
        formats = self.selected_formats()
        if body.is_exposing:
            return Reply(Response.DEVICE_BUSY)
        if faults.state:
            return Reply(self.refusals[faults.state])
        if self.config.access == READ_ONLY:
            return Reply(Response.STORE_READ_ONLY)
        if faults.is_battery_low:
            return Reply(Response.GENERAL_ERROR)
        if faults.is_card_full or self.card.free_bytes < body.largest_file * len(formats):
            self.announce(Event.STORE_FULL, STORE)
            return Reply(Response.STORE_FULL)
        time_s = None if is_bulb else self.exposure_time_s()
        exposure = Exposure(
            time_s, self.gain(), self.light(), formats, self.config.quality, self.f_number()
        )
        self._captured_by = self._transaction
        deliver = store or self.store
        if self.config.event_order != "before" or time_s is None:
            body.release(exposure, deliver)
            return Reply()

        def deliver_and_reply(files: Sequence[ImageFile]) -> None:
            deliver(files)
            self._send_reply(Reply())

        body.release(exposure, deliver_and_reply)
        return None

    # Standard operations.

    def _get_device_info(self, parameters: Sequence[int], data: bytes) -> Reply:
        identity = self.config.identity(type(self).identity)
        formats = self.listed_formats()
        info = DeviceInfo(
            vendor_extension=identity.extension,
            vendor_version=identity.extension_version,
            operations=self.listed_operations(),
            events=self.events,
            properties=self.listed_properties(),
            capture_formats=formats,
            image_formats=[Format.FOLDER, *formats],
            make=identity.make,
            model=identity.model,
            version=self.facts.version if self.facts else "1.0",
            serial=self.config.serial,
        )
        return Reply(data=info.packed())

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

    def _set_property(self, parameters: Sequence[int], data: bytes) -> Reply:
        item = self.properties.requested(parameters)
        if item is None:
            return Reply(Response.PROPERTY_NOT_SUPPORTED)
        value = unpack_number(item.kind, data)
        if value is None:
            return Reply(
                Response.INVALID_VALUE_FORMAT if item.is_writable else Response.ACCESS_DENIED
            )
        return Reply(self.set_number(item, value))

    def _initiate_capture(self, parameters: Sequence[int], data: bytes) -> Reply | None:
        # Real cameras fail in various ways without both parameters; this one reports an error.
        if len(parameters) < 2:
            return Reply(Response.INVALID_PARAMETER)
        if parameters[0] not in (0, STORE):
            return Reply(Response.INVALID_STORAGE)
        return self.release()

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
