"""A camera body in its own dialect: shutter released, news heard, cards looked at.

The tables are in `vendors`; here is what is done with them.  Nothing here knows of frames.
"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, replace

from camctl.errors import CameraBusyError, CameraError, CameraProtocolError
from drivers.ptp.codes import DEVICE_BUSY, OK, Event, Op, Prop, response_error
from drivers.ptp.datasets import StorageInfo
from drivers.ptp.dialects import OPENING_TRANSACTION, Source, Step, dialect_of
from drivers.ptp.dials import Dial
from drivers.ptp.properties import Properties
from drivers.ptp.session import Session
from drivers.ptp.transport import CAPTURE_S
from drivers.ptp.vendor_datasets import parse_nikon_events

# How long a body may take to show a setting that it has accepted, and pauses between looks.
READ_BACK_S = 3.0
_LOOK_S = 0.02
_LOW_BATTERY = 5  # per cent
_MOST_STEPS = 200
_ADDED = (Event.OBJECT_ADDED, Event.SONY_OBJECT_ADDED, Event.NIKON_OBJECT_IN_MEMORY)
# D215 counts pictures that wait; its top bit says that the first of them can be fetched.
_SONY_READY = 0x8000


@dataclass(frozen=True)
class News:
    """What a camera has told since it was last listened to.

    Attributes:
        added: handles of new objects, folders among them
        is_complete: an exposure has ended
        is_full: there is no room left
    """

    added: tuple[int, ...] = ()
    is_complete: bool = False
    is_full: bool = False


class Body:
    """One camera with an open session.

    Args:
        session: open
        who: how errors call it

    Raises:
        CameraError: it does not come into the mode that its dialect needs
    """

    def __init__(self, session: Session, who: str) -> None:
        self.session, self._who = session, who
        info = session.info
        self.dialect = dialect_of(info.vendor_extension, info.make, info.operations)
        session.maker = self.dialect.name
        self.properties = Properties(session, self.dialect, who)
        self._opening = 0
        session.after_reopening = self._enter
        self._enter()
        self.properties.look()
        self.properties.preset()

    def _enter(self) -> None:
        for step in self.dialect.opening:
            self._do(step, "switching to remote control")

    # ---- exposures

    def release(self, silence_s: float = CAPTURE_S) -> int:
        """Take a picture; return the response code, which is OK or Device_Busy.

        Raises:
            CameraError: the camera says why it does not
        """
        self.wait_ready()
        for steps in self.dialect.releases:
            if all(step.operation in self.session.info.operations for step in steps):
                return self._run(steps, silence_s)
        raise CameraError(
            f"{self._who} cannot be released over USB",
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
            self._do(step, "opening the shutter")
        self._opening = self.session.last_transaction

    def close_bulb(self) -> None:
        """Close the shutter of a bulb exposure."""
        for step in self.dialect.bulb_closes:
            parameters = (self._opening if p == OPENING_TRANSACTION else p for p in step.parameters)
            self._do(replace(step, parameters=tuple(parameters)), "closing the shutter")

    def has_bulb(self, dial: Dial) -> bool:
        """Return whether the shutter can be held open from here."""
        steps = (*self.dialect.bulb_opens, *self.dialect.bulb_closes)
        description = self.properties.description(dial.code)
        choices = description.choices if description is not None else ()
        return (self.dialect.bulb is None or self.dialect.bulb in choices) and all(
            step.operation in self.session.info.operations for step in steps
        )

    def wait_ready(self) -> None:
        """Wait until the camera is done with what it does; raises `CameraBusyError`."""
        ready = self.dialect.ready
        if ready is not None:
            self.session.call(ready, doing="waiting for it")

    def _run(self, steps: Iterable[Step], silence_s: float) -> int:
        for step in steps:
            answer = self.session.attempt(
                step.operation, *step.parameters, data=step.data, silence_s=silence_s
            )
            if answer.code == DEVICE_BUSY:
                return answer.code
            if answer.code != OK:
                raise self._why_not(answer.code)
            # Canon's body says here why it did not, in numbers that differ between models.
            if self.dialect.source is Source.EOS_EVENTS and any(answer.parameters[:1]):
                raise CameraError(
                    f"{self._who} did not take the picture (result {answer.parameters[0]})",
                    hint="set the lens to manual focus (MF), take the lens cap off, check the card",
                )
        return OK

    def _why_not(self, code: int) -> CameraError:
        """Return the error for a picture that the camera would not take."""
        error = response_error(code, "taking a picture", self._who, self.dialect.name)
        if (charge := self.properties.battery()) is not None and charge <= _LOW_BATTERY:
            return CameraError(
                f"{self._who} does not take a picture: its battery is down to {charge} %",
                hint="charge it or use a mains adapter",
            )
        return error

    def _do(self, step: Step, doing: str) -> None:
        self.session.call(
            step.operation, *step.parameters, doing=doing, data=step.data, repeatable=False
        )

    # ---- news

    def news(self, wait_s: float) -> News:
        """Return what happened, waiting up to `wait_s` for an event."""
        added = self.properties.take_added()
        complete = full = False
        while (event := self.session.event(wait_s)) is not None:
            wait_s = 0.001
            parameter = event.parameters[0] if event.parameters else 0
            if event.code in _ADDED:
                added.append(parameter)
            complete |= event.code == Event.CAPTURE_COMPLETE
            full |= event.code == Event.STORE_FULL
        added.extend(self._polled())
        return News(tuple(dict.fromkeys(added)), complete, full)

    def _polled(self) -> list[int]:
        """Return handles of new objects that the camera tells only when asked."""
        if self.dialect.polled == Op.EOS_EVENTS:
            self.properties.look()
            return self.properties.take_added()
        if self.dialect.polled == Op.NIKON_EVENTS:
            if Op.NIKON_EVENTS not in self.session.info.operations:
                return []
            answer = self.session.call(Op.NIKON_EVENTS, doing="asking for news")
            return [handle for event, handle in parse_nikon_events(answer.data) if event in _ADDED]
        if self.dialect.source is Source.SONY_LIST and self.dialect.memory is not None:
            waiting = self.properties.number(Prop.SONY_OBJECT_IN_MEMORY)
            return [self.dialect.memory] if waiting is not None and waiting >= _SONY_READY else []
        return []

    def handles(self) -> frozenset[int] | None:
        """Return all objects on its cards; None where it cannot tell now, or at all."""
        if Op.GET_OBJECT_HANDLES not in self.session.info.operations:
            return None
        try:
            return self.session.handles(busy_s=0)
        except CameraBusyError:
            return None

    def check_card(self) -> None:
        """Raise `CameraError` where the camera has nothing to put a picture on."""
        if Op.GET_STORAGE_IDS not in self.session.info.operations:
            return
        stores: tuple[StorageInfo, ...] = ()
        with suppress(CameraProtocolError):  # the release itself will tell
            stores = self.session.stores()
        if stores and not any(store.is_writable for store in stores):
            raise CameraError(
                f"{self._who}: its card cannot be written", hint="take the lock off the card"
            )
        if stores and all(store.free_bytes == 0 and store.free_images == 0 for store in stores):
            raise CameraError(
                f"{self._who}: its card is full",
                hint="make room on the card or put another one in",
            )
