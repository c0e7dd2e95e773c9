"""A camera body in its dialect: releases the shutter, reports events, lists its cards.

The dialects are tables (`camctl.drivers.ptp.dialects`); this module performs their operations.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, replace

from camctl.drivers.ptp.codes import DEVICE_BUSY, OK, Event, Op, Prop, response_error
from camctl.drivers.ptp.datasets import Reader, StorageInfo
from camctl.drivers.ptp.dialects import OPENING_TRANSACTION, Hold, Source, Step
from camctl.drivers.ptp.dials import Dial
from camctl.drivers.ptp.maker_datasets import parse_nikon_events
from camctl.drivers.ptp.makers import dialect_of
from camctl.drivers.ptp.properties import Properties, unsupported_ignored
from camctl.drivers.ptp.session import Session
from camctl.drivers.ptp.transport import CAPTURE_S
from camctl.errors import CameraBusyError, CameraError, CameraProtocolError
from camctl.interface.camera import CameraCondition
from camctl.interface.clock import cancelled_by

# Below this charge a camera that takes no picture probably lacks power, per cent.
_LOW_BATTERY_PERCENT = 5
_UNKNOWN_NUMBER = 0xFFFFFFFF  # FreeSpaceInImages that is not stated: ISO 15740, section 5.5.3
# Time-out of further events after the first: those that are already there.
_NEXT_EVENT_S = 0.001
# New objects; makers give one number different meanings.
_ADDED = {
    "standard": (Event.OBJECT_ADDED,),
    "nikon": (Event.OBJECT_ADDED, Event.NIKON_OBJECT_IN_MEMORY),
    "canon": (Event.OBJECT_ADDED,),
    "sony": (Event.OBJECT_ADDED, Event.SONY_OBJECT_ADDED),
    "fuji": (Event.OBJECT_ADDED, Event.FUJI_OBJECT_ADDED),
    "olympus": (Event.OBJECT_ADDED, Event.OLYMPUS_OBJECT_ADDED, Event.OLYMPUS_OBJECT_ADDED_NEW),
    "panasonic": (
        Event.OBJECT_ADDED,
        Event.PANASONIC_OBJECT_ADDED,
        Event.PANASONIC_OBJECT_IN_MEMORY,
    ),
}
# How long a half-pressed button may take to focus, and the pause between two requests.
_FOCUS_S, _FOCUS_POLL_S = 10.0, 0.05
# The message that a camera is in use is sent this often, as libgphoto2 sends it to Canon bodies.
_KEPT_ON_S = 10.0
_NOT_SUPPORTED = 0x2005  # response: the operation is not supported
# Property D215 counts waiting pictures; its top bit is set when the first can be fetched.
_SONY_READY = 0x8000


@dataclass(frozen=True)
class CameraEvents:
    """The events since the last poll.

    Attributes:
        added: handles of new objects, including folders
        is_complete: True if an exposure has ended
        is_full: True if the card is full
        is_busy: True if the camera answered that it is busy
    """

    added: tuple[int, ...] = ()
    is_complete: bool = False
    is_full: bool = False
    is_busy: bool = False


class Body:
    """One camera with an open session.

    Args:
        session: open
        name: name of the camera in error messages

    Raises:
        CameraError: it does not enter the mode that its dialect needs
    """

    def __init__(self, session: Session, name: str) -> None:
        self.session, self._name = session, name
        info = session.info
        self.dialect = dialect_of(info.vendor_extension, info.make, info.operations, info.model)
        session.maker = self.dialect.name
        session.correct_info(self.dialect.unlisted, self.dialect.unreliable, ())
        self.properties = Properties(session, self.dialect, name)
        self._opening_transaction = self._way = 0
        self._has_control = False
        self._kept_on_s = session.clock.now()
        session.after_reopening = self._enter_remote_mode
        self._enter_remote_mode()
        session.correct_info(frozenset(), frozenset(), self._hidden_properties())
        self.properties.read_first()
        self.properties.set_presets()

    def _enter_remote_mode(self) -> None:
        for step in self.dialect.opening:
            self._do(step, "switch to remote control")
        self._ready_s = self.session.clock.now() + self.dialect.startup_s

    def image_size(self) -> tuple[int, int] | None:
        """Return (rows, columns) of the pictures that the camera is set to; None: not stated."""
        current: object = ""
        if Prop.IMAGE_SIZE in self.session.info.properties:
            with unsupported_ignored():
                current = self.session.description(Prop.IMAGE_SIZE).current
        match = re.fullmatch(r"(\d+)\s*x\s*(\d+)", str(current), re.IGNORECASE)
        return (int(match[2]), int(match[1])) if match else None

    def take_control(self, dial: Dial) -> None:
        """Take over what the mode dial decides, if the shutter time cannot be set otherwise."""
        description, control = self.properties.description(dial.code), self.dialect.control
        if control is None or description is None or description.is_writable:
            return
        self._has_control = True
        self._do(control, "give control to the computer")
        self.properties.refresh()

    def _hidden_properties(self) -> list[int]:
        """Return the properties that the maker's operations list."""
        found: list[int] = []
        for operation, parameters, size in self.dialect.hidden:
            if operation in self.session.info.operations:
                with suppress(CameraProtocolError):  # some bodies list it and do not have it
                    answer = self.session.call(operation, *parameters, task="list its properties")
                    found += Reader(answer.data, "list of properties").array(size)
        return found

    def close(self) -> None:
        """Give the control back to the camera's dials and buttons."""
        steps = self.dialect.closing
        if self._has_control and self.dialect.control is not None:
            steps = (*steps, replace(self.dialect.control, parameters=(0,)))
        with suppress(CameraError):
            for step in steps:
                self._do(step, "end remote control")

    # ---- exposures

    def release(self, silence_s: float = CAPTURE_S) -> int:
        """Take a picture; return the response code, which is OK or Device_Busy.

        Raises:
            CameraError: the camera does not take one, with the reason it gives
        """
        clock = self.session.clock
        clock.sleep_until(max(clock.now(), self._ready_s))
        self.wait_ready()
        self._keep_on()
        operations = self.session.info.operations
        ways = [
            steps
            for steps in self.dialect.releases
            if all(step.operation in operations for step in steps)
        ]
        if not ways:
            raise CameraError(
                f"{self._name} cannot take pictures over USB",
                hint="choose remote control or PTP in its USB menu; else it is not supported",
            )
        first_code = code = 0
        for number, steps in enumerate(ways[self._way :], self._way):
            is_other = bool(number) and steps[0].operation != ways[number - 1][0].operation
            if first_code and is_other and code != _NOT_SUPPORTED:
                break
            code = self._run(steps, silence_s)
            if code in (OK, DEVICE_BUSY):
                self._way = number
                return code
            first_code = first_code or code
            if code not in self.dialect.retries | {_NOT_SUPPORTED}:
                break
        raise self._release_error(first_code)

    def open_bulb(self, dial: Dial) -> None:
        """Set the shutter to bulb and open it."""
        bulb = self.dialect.bulb
        description = self.properties.description(dial.code)
        if bulb is not None and description is not None:
            self.properties.write(description, bulb)
        self.wait_ready()
        for step in self.dialect.bulb_opens:
            self._do(step, "open the shutter")
        self._opening_transaction = self.session.last_transaction

    def close_bulb(self) -> None:
        """Close the shutter of a bulb exposure."""
        opening = self._opening_transaction
        for step in self.dialect.bulb_closes:
            parameters = (opening if p == OPENING_TRANSACTION else p for p in step.parameters)
            self._do(replace(step, parameters=tuple(parameters)), "close the shutter")

    def abort(self) -> bool:
        """End the exposure that runs; return whether the camera has ended it."""
        steps, has = self.dialect.aborts, self.session.info.operations
        if not steps or any(step.operation not in has for step in steps):
            return False
        with suppress(CameraError):
            return all(
                self.session.attempt(step.operation, *step.parameters).code == OK for step in steps
            )
        return False

    def has_bulb(self, dial: Dial) -> bool:
        """Return whether the computer can hold the shutter open."""
        steps = (*self.dialect.bulb_opens, *self.dialect.bulb_closes)
        description = self.properties.description(dial.code)
        choices = description.choices if description is not None else ()
        return (self.dialect.bulb is None or self.dialect.bulb in choices) and all(
            step.operation in self.session.info.operations for step in steps
        )

    def wait_ready(self) -> None:
        """Wait until the camera is ready, if its dialect can ask; raises `CameraBusyError`."""
        ready = self.dialect.ready
        if ready is not None:
            self.session.call(ready, task="become ready")

    def _run(self, steps: Iterable[Step], silence_s: float) -> int:
        """Perform steps; return the response code of the first that is not OK, else OK.

        Where one fails, those before it are taken back: no button stays pressed.
        """
        done: list[Step] = []
        code = -1
        try:
            code = self._perform(steps, silence_s, done)
        finally:
            if code != OK:
                with suppress(CameraError), cancelled_by(None):
                    for step in (undo for each in reversed(done) for undo in each.undo):
                        self.session.attempt(step.operation, *step.parameters, data=step.data)
        return code

    def _perform(self, steps: Iterable[Step], silence_s: float, done: list[Step]) -> int:
        """As `_run`, without taking steps back; those that were performed are added to `done`."""
        for step in steps:
            answer = self.session.attempt(
                step.operation, *step.parameters, data=step.data, silence_s=silence_s
            )
            if answer.code != OK:
                return answer.code
            done.append(step)
            # Canon's bodies give a result number here; its meaning differs between models.
            if self.dialect.source is Source.EOS_EVENTS and any(answer.parameters[:1]):
                raise CameraError(
                    f"{self._name} did not take a picture: result {answer.parameters[0]}",
                    hint="set the lens to manual focus (MF), take the lens cap off, check the card",
                )
            if step.busy_at is not None and self._wait_for(*step.busy_at) == step.fails_at:
                raise CameraError(
                    f"{self._name} did not take a picture: it cannot focus",
                    hint="set the lens to manual focus (MF), and take the lens cap off",
                )
            if step.polls:
                self.properties.refresh()
            if step.hold is not None:
                self._hold(step.hold)
        return OK

    def _hold(self, hold: Hold) -> None:
        """Return as soon as the lens has focused, or after `longest_s`."""
        clock, (mode, manual) = self.session.clock, hold.mode
        deadline_s = clock.now() + hold.longest_s
        if self.properties.number(mode) == manual:
            return
        while self.properties.number(hold.code) not in hold.found and clock.now() < deadline_s:
            clock.sleep_until(clock.now() + _FOCUS_POLL_S)

    def _keep_on(self) -> None:
        """Tell the camera that it is in use, so that it does not switch itself off."""
        operation, clock = self.dialect.kept_on, self.session.clock
        if operation is None or clock.now() < self._kept_on_s + _KEPT_ON_S:
            return
        self._kept_on_s = clock.now()
        if operation in self.session.info.operations:
            with suppress(CameraProtocolError):
                self.session.attempt(operation)

    def _wait_for(self, code: int, busy: int) -> int | None:
        """Return the value of a property as soon as it is not `busy`, or after 10 s."""
        clock = self.session.clock
        deadline_s = clock.now() + _FOCUS_S
        while (value := self.properties.number(code)) == busy and clock.now() < deadline_s:
            clock.sleep_until(clock.now() + _FOCUS_POLL_S)
        return value

    def _release_error(self, code: int) -> CameraError:
        """Return the error for a picture that was not taken."""
        charge = self.properties.battery_percent()
        if charge is not None and charge <= _LOW_BATTERY_PERCENT:
            return CameraError(
                f"{self._name} did not take a picture: its battery has {charge} % of its charge",
                hint="charge it or use a mains adapter",
            )
        if self.dialect.lens_warning is not None:
            warning, meaning = self.dialect.lens_warning
            with suppress(CameraError):
                code = meaning if self.session.description(warning).current == 1 else code
        return response_error(code, "take a picture", self._name, self.dialect.name)

    def _do(self, step: Step, task: str) -> None:
        if step.is_optional:
            if step.operation in self.session.info.operations:
                with unsupported_ignored():
                    self._do(replace(step, is_optional=False), task)
            return
        self.session.call(
            step.operation, *step.parameters, task=task, data=step.data, repeatable=False
        )

    # ---- events

    def poll_events(self, wait_s: float) -> CameraEvents:
        """Return the events since the last poll, after up to `wait_s` if there is none yet.

        A camera may answer that it is busy during an exposure and the noise reduction after it:
        that is not an error here.
        """
        added = self.properties.take_added()
        complete = full = busy = False
        while (event := self.session.event(wait_s)) is not None:
            wait_s = _NEXT_EVENT_S
            parameter = event.parameters[0] if event.parameters else 0
            if event.code in _ADDED[self.dialect.name]:
                added.append(parameter)
            complete |= event.code == Event.CAPTURE_COMPLETE
            full |= event.code == Event.STORE_FULL
            for code, operation in self.dialect.acknowledged:
                if event.code == code:
                    with suppress(CameraProtocolError):
                        self.session.attempt(operation, parameter)
        self._keep_on()
        if self.properties.description(Prop.SONY_OBJECT_IN_MEMORY) is not None:
            # An event may be older than the fetching of its picture: only the property counts.
            added = [handle for handle in added if handle != self.dialect.memory]
        try:
            added.extend(self._requested_handles())
        except CameraBusyError:
            busy = True
        return CameraEvents(tuple(dict.fromkeys(added)), complete, full, busy)

    def _requested_handles(self) -> list[int]:
        """Return handles of new objects that the camera reports on request only."""
        if self.dialect.polled == Op.EOS_EVENTS:
            self.properties.refresh(busy_s=0)
            return self.properties.take_added()
        if self.dialect.polled == Op.NIKON_EVENTS:
            if Op.NIKON_EVENTS not in self.session.info.operations:
                return []
            answer = self.session.call(Op.NIKON_EVENTS, task="report its events", busy_s=0)
            events = parse_nikon_events(answer.data)
            return [handle for event, handle in events if event in _ADDED["nikon"]]
        if self.dialect.source is Source.SONY_LIST and self.dialect.memory is not None:
            self.properties.refresh(busy_s=0)
            return [self.dialect.memory] if self._memory_requested() else []
        return []

    def _memory_requested(self) -> bool:
        """Return whether Sony's list, as read last, has a picture that can be fetched."""
        waiting = self.properties.description(Prop.SONY_OBJECT_IN_MEMORY)
        number = None if waiting is None else waiting.current
        return isinstance(number, int) and number >= _SONY_READY

    # ---- cards

    @property
    def lists_objects(self) -> bool:
        """Whether the camera lists the objects on its cards."""
        listed = Op.GET_OBJECT_HANDLES in self.session.info.operations
        return listed and self.dialect.lists_objects

    def handles(self) -> frozenset[int] | None:
        """Return all objects on its cards; None if it is busy or does not list them."""
        if not self.lists_objects:
            return None
        try:
            return self.session.handles(busy_s=0)
        except CameraBusyError:
            return None

    def condition(self) -> CameraCondition:
        """Return battery, room on the cards, lens and mode dial, as far as it states them."""
        stores: tuple[StorageInfo, ...] = ()
        if Op.GET_STORAGE_IDS in self.session.info.operations:
            with suppress(CameraProtocolError):
                stores = self.session.stores()
        rooms = [store.free_images for store in stores if store.free_images != _UNKNOWN_NUMBER]
        known = self.properties
        battery, room = known.battery_percent(), sum(rooms) if rooms else None
        return CameraCondition(battery, room, known.lens(), known.mode())

    def check_card(self) -> str | None:
        """Return a note if the cards say that they are read-only; the release will show it.

        Raises:
            CameraError: no card has room for a picture
        """
        if Op.GET_STORAGE_IDS not in self.session.info.operations:
            return None
        stores: tuple[StorageInfo, ...] = ()
        with suppress(CameraProtocolError):  # if there is a problem, the release will report it
            stores = self.session.stores()
        if stores and all(store.free_bytes == 0 and store.free_images == 0 for store in stores):
            raise CameraError(
                f"the card of {self._name} is full",
                hint="make room on it or put another one in",
            )
        if stores and all(store.is_read_only for store in stores):
            return "its card says that it is read-only: unlock it if no picture is taken"
        return None
