"""A camera body in its dialect: releases the shutter, reports events, lists its cards.

The dialects are tables (`drivers.ptp.dialects`); this module performs their operations.
"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, replace

from camctl.errors import CameraBusyError, CameraError, CameraProtocolError
from drivers.ptp.codes import DEVICE_BUSY, OK, Event, Op, Prop, response_error
from drivers.ptp.datasets import StorageInfo, parse_nikon_events
from drivers.ptp.dialects import OPENING_TRANSACTION, Source, Step, dialect_of
from drivers.ptp.dials import Dial
from drivers.ptp.properties import Properties
from drivers.ptp.session import Session
from drivers.ptp.transport import CAPTURE_S

# Below this charge a camera that takes no picture probably lacks power, per cent.
_LOW_BATTERY_PERCENT = 5
# Time-out of further events after the first: those that are already there.
_NEXT_EVENT_S = 0.001
_ADDED = (Event.OBJECT_ADDED, Event.SONY_OBJECT_ADDED, Event.NIKON_OBJECT_IN_MEMORY)
# Property D215 counts waiting pictures; its top bit is set when the first can be fetched.
_SONY_READY = 0x8000


@dataclass(frozen=True)
class CameraEvents:
    """The events since the last poll.

    Attributes:
        added: handles of new objects, including folders
        is_complete: True if an exposure has ended
        is_full: True if the card is full
    """

    added: tuple[int, ...] = ()
    is_complete: bool = False
    is_full: bool = False


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
        self.dialect = dialect_of(info.vendor_extension, info.make, info.operations)
        session.maker = self.dialect.name
        self.properties = Properties(session, self.dialect, name)
        self._opening_transaction = 0
        session.after_reopening = self._enter_remote_mode
        self._enter_remote_mode()
        self.properties.refresh()
        self.properties.set_presets()

    def _enter_remote_mode(self) -> None:
        for step in self.dialect.opening:
            self._do(step, "switch to remote control")

    # ---- exposures

    def release(self, silence_s: float = CAPTURE_S) -> int:
        """Take a picture; return the response code, which is OK or Device_Busy.

        Raises:
            CameraError: the camera does not take one, with the reason it gives
        """
        self.wait_ready()
        for steps in self.dialect.releases:
            if all(step.operation in self.session.info.operations for step in steps):
                return self._run(steps, silence_s)
        raise CameraError(
            f"{self._name} cannot take pictures over USB",
            hint="choose remote control or PTP in its USB menu; else its model is not supported",
        )

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
        for step in steps:
            answer = self.session.attempt(
                step.operation, *step.parameters, data=step.data, silence_s=silence_s
            )
            if answer.code == DEVICE_BUSY:
                return answer.code
            if answer.code != OK:
                raise self._release_error(answer.code)
            # Canon's bodies give a result number here; its meaning differs between models.
            if self.dialect.source is Source.EOS_EVENTS and any(answer.parameters[:1]):
                raise CameraError(
                    f"{self._name} did not take a picture: result {answer.parameters[0]}",
                    hint="set the lens to manual focus (MF), take the lens cap off, check the card",
                )
        return OK

    def _release_error(self, code: int) -> CameraError:
        """Return the error for a picture that was not taken."""
        charge = self.properties.battery_percent()
        if charge is not None and charge <= _LOW_BATTERY_PERCENT:
            return CameraError(
                f"{self._name} did not take a picture: its battery has {charge} % of its charge",
                hint="charge it or use a mains adapter",
            )
        return response_error(code, "take a picture", self._name, self.dialect.name)

    def _do(self, step: Step, task: str) -> None:
        self.session.call(
            step.operation, *step.parameters, task=task, data=step.data, repeatable=False
        )

    # ---- events

    def poll_events(self, wait_s: float) -> CameraEvents:
        """Return the events since the last poll, after up to `wait_s` if there is none yet."""
        added = self.properties.take_added()
        complete = full = False
        while (event := self.session.event(wait_s)) is not None:
            wait_s = _NEXT_EVENT_S
            parameter = event.parameters[0] if event.parameters else 0
            if event.code in _ADDED:
                added.append(parameter)
            complete |= event.code == Event.CAPTURE_COMPLETE
            full |= event.code == Event.STORE_FULL
        added.extend(self._requested_handles())
        return CameraEvents(tuple(dict.fromkeys(added)), complete, full)

    def _requested_handles(self) -> list[int]:
        """Return handles of new objects that the camera reports on request only."""
        if self.dialect.polled == Op.EOS_EVENTS:
            self.properties.refresh()
            return self.properties.take_added()
        if self.dialect.polled == Op.NIKON_EVENTS:
            if Op.NIKON_EVENTS not in self.session.info.operations:
                return []
            answer = self.session.call(Op.NIKON_EVENTS, task="report its events")
            return [handle for event, handle in parse_nikon_events(answer.data) if event in _ADDED]
        if self.dialect.source is Source.SONY_LIST and self.dialect.memory is not None:
            waiting = self.properties.number(Prop.SONY_OBJECT_IN_MEMORY)
            return [self.dialect.memory] if waiting is not None and waiting >= _SONY_READY else []
        return []

    # ---- cards

    def handles(self) -> frozenset[int] | None:
        """Return all objects on its cards; None if it is busy or does not support the list."""
        if Op.GET_OBJECT_HANDLES not in self.session.info.operations:
            return None
        try:
            return self.session.handles(busy_s=0)
        except CameraBusyError:
            return None

    def check_card(self) -> None:
        """Raise `CameraError` if no card can store a picture."""
        if Op.GET_STORAGE_IDS not in self.session.info.operations:
            return
        stores: tuple[StorageInfo, ...] = ()
        with suppress(CameraProtocolError):  # if there is a problem, the release will report it
            stores = self.session.stores()
        if stores and not any(store.is_writable for store in stores):
            raise CameraError(f"the card of {self._name} is write-protected", hint="unlock it")
        if stores and all(store.free_bytes == 0 and store.free_images == 0 for store in stores):
            raise CameraError(
                f"the card of {self._name} is full",
                hint="make room on it or put another one in",
            )
