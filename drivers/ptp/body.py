"""A camera body in its own dialect: dials read and turned, shutter released, news heard.

The tables are in `vendors`; here is what is done with them.  Nothing here knows of frames.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, replace

from camctl.errors import (
    CameraBusyError,
    CameraError,
    CameraProtocolError,
    CameraTimeoutError,
    RefusedSettingError,
)
from drivers.ptp.codes import DEVICE_BUSY, OK, Event, Op, Prop, response_error
from drivers.ptp.datasets import PropertyDescription, Reader, pack_integer
from drivers.ptp.dials import Dial, make_dial
from drivers.ptp.protocol import Session
from drivers.ptp.transport import CAPTURE_S
from drivers.ptp.vendordata import (
    merge_eos,
    pack_eos_property,
    parse_eos_events,
    parse_nikon_events,
    parse_sony_properties,
)
from drivers.ptp.vendors import OPENING_TRANSACTION, Scale, Source, Step, dialect_of

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
        scales = (*self.dialect.times, *self.dialect.gains, *self.dialect.f_numbers)
        presets = [code for code, _ in self.dialect.presets]
        self._codes = frozenset(
            {*(s.code for s in scales), *presets, self.dialect.program[0], self.dialect.battery}
        )
        self._known: dict[int, PropertyDescription] = {}
        self._added: list[int] = []
        self._stepped: set[int] = set()
        self._opening = 0
        for step in self.dialect.opening:
            self._do(step, "switching to remote control")
        self.look()
        self._preset()

    # ---- properties

    def look(self) -> None:
        """Read again what the properties are and can be."""
        source = self.dialect.source
        if source is Source.ASKED:
            for code in sorted(self._codes.intersection(self.session.info.properties)):
                self._known[code] = self.session.description(code)
        elif source is Source.SONY_LIST:
            answer = self.session.call(Op.SONY_PROPERTIES, doing="asking for its properties")
            self._known = parse_sony_properties(answer.data)
        else:
            self._listen_eos()

    def _listen_eos(self) -> None:
        answer = self.session.call(Op.EOS_EVENTS, doing="asking for news")
        news = parse_eos_events(answer.data)
        merge_eos(self._known, news, self._codes)
        self._added.extend(news.added)

    def number(self, code: int) -> int | None:
        """Return the number that a property has now; None where the camera does not tell."""
        if self.dialect.source is Source.ASKED:
            description = self._known.get(code)
            if description is None:
                return None
            answer = self.session.call(Op.GET_PROPERTY, code, doing=f"reading property {code:04X}")
            value = Reader(answer.data, "property").value(description.data_type)
        else:
            self.look()
            description = self._known.get(code)
            value = description.current if description else ""
        return value if isinstance(value, int) else None

    def dial(self, name: str, scales: Iterable[Scale]) -> Dial | None:
        """Return the first of these dials that the camera has; None where it has none."""
        for scale in scales:
            description = self._known.get(scale.code)
            if description is None:
                continue
            listed = self.dialect.times_s if name == "time_s" else ()
            dial = make_dial(name, scale, description, listed)
            if dial is not None:
                return dial
        return None

    def check_mode(self, code: int) -> None:
        """Raise `CameraError` where the camera itself chooses the exposure.

        `code` is the shutter's property.
        """
        program, manual = self.dialect.program
        mode = self._known.get(program)
        description = self._known.get(code)
        in_manual = mode is None or mode.current in manual
        if in_manual and (description is None or description.is_writable):
            return
        if not in_manual and mode is not None and mode.is_writable:
            with suppress(CameraError):
                self._write(mode, min(manual))
                self.look()
                description = self._known.get(code)
                if description is None or description.is_writable:
                    return
        raise CameraError(
            f"{self._who} chooses the shutter time itself", hint="turn the mode dial to M"
        )

    def set_dial(self, dial: Dial, value: float) -> float:
        """Turn a dial; return the value read back, SI units.

        Raises:
            RefusedSettingError: the camera took another value than the one that was set
            CameraError: it does not take it now
        """
        number = dial.number(value)
        before = self.number(dial.code)
        applied = before
        if before != number:
            self._turn(dial, number)
            applied = self._read_back(dial.code, number)
            if applied == before and self.dialect.source is Source.SONY_LIST:
                # Older bodies take a value without a word and ignore it.
                self._stepped.add(dial.code)
                self._turn(dial, number)
                applied = self._read_back(dial.code, number)
        actual = None if applied is None else dial.value(applied)
        if actual is None:
            raise CameraProtocolError(
                f"{self._who} does not say which {dial.name} it has set",
                hint="turn the mode dial to M",
            )
        if applied != number:
            raise RefusedSettingError(dial.name, value, actual)
        return actual

    def _turn(self, dial: Dial, number: int) -> None:
        description = self._known[dial.code]
        try:
            if dial.is_stepped or dial.code in self._stepped:
                self._step_to(dial, number)
            else:
                self._write(description, number)
        except (CameraBusyError, CameraTimeoutError):
            raise
        except CameraError as error:
            self.look()
            if not self._known[dial.code].is_writable:
                raise CameraError(
                    f"{self._who} does not let {dial.name} be set", hint="turn the mode dial to M"
                ) from error
            raise

    def _write(self, description: PropertyDescription, number: int) -> None:
        code, doing = description.code, f"setting property {description.code:04X}"
        if self.dialect.source is Source.EOS_EVENTS:
            self.session.call(
                Op.EOS_SET_PROPERTY, doing=doing, data=pack_eos_property(code, number)
            )
            return
        operation = (
            Op.SONY_SET_PROPERTY if self.dialect.source is Source.SONY_LIST else Op.SET_PROPERTY
        )
        self.session.call(
            operation, code, doing=doing, data=pack_integer(number, description.data_type)
        )

    def _step_to(self, dial: Dial, number: int) -> None:
        """Turn a dial that only knows "one up" and "one down" until it shows `number`."""
        up, down = (1).to_bytes(1, "little"), (0xFF).to_bytes(1, "little")
        wanted, direction, distance = dial.value(number), up, float("inf")
        assert wanted is not None
        for _ in range(_MOST_STEPS):
            shown = self.number(dial.code)
            if shown == number:
                return
            now = dial.value(shown) if shown is not None else None
            before, distance = distance, abs(now - wanted) if now is not None else distance
            if distance > before:
                direction = down if direction == up else up
            self.session.call(
                Op.SONY_CONTROL, dial.code, doing="turning a dial", data=direction, repeatable=False
            )

    def _read_back(self, code: int, number: int) -> int | None:
        deadline = time.monotonic() + (0 if self.dialect.source is Source.ASKED else READ_BACK_S)
        while True:
            now = self.number(code)
            if now == number or time.monotonic() > deadline:
                return now
            if Op.EOS_REQUEST_PROPERTY in self.session.info.operations:
                # The record of the change may have been lost, or there was none to tell.
                self.session.call(Op.EOS_REQUEST_PROPERTY, code, doing="reading a property")
            time.sleep(_LOOK_S)

    def _preset(self) -> None:
        for code, number in self.dialect.presets:
            description = self._known.get(code)
            if (
                description is not None
                and description.is_writable
                and description.current != number
                and (not description.choices or number in description.choices)
            ):
                self._write(description, number)

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
        if bulb is not None and self.number(dial.code) != bulb:
            self._write(self._known[dial.code], bulb)
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
        choices = self._known[dial.code].choices
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
        if (charge := self.battery()) is not None and charge <= _LOW_BATTERY:
            return CameraError(
                f"{self._who} does not take a picture: its battery is down to {charge} %",
                hint="charge it or use a mains adapter",
            )
        return error

    def battery(self) -> int | None:
        """Return the charge in per cent, where the camera tells."""
        with suppress(CameraError):
            if Prop.BATTERY_LEVEL in self.session.info.properties:
                charge = self.session.description(Prop.BATTERY_LEVEL).current
                return charge if isinstance(charge, int) else None
            if self.dialect.battery in self._known:
                return self.number(self.dialect.battery)
        return None

    def _do(self, step: Step, doing: str) -> None:
        self.session.call(
            step.operation, *step.parameters, doing=doing, data=step.data, repeatable=False
        )

    # ---- news

    def news(self, wait_s: float) -> News:
        """Return what happened, waiting up to `wait_s` for an event."""
        added, self._added = self._added, []
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
            self._listen_eos()
            added, self._added = self._added, []
            return added
        if self.dialect.polled == Op.NIKON_EVENTS:
            if Op.NIKON_EVENTS not in self.session.info.operations:
                return []
            answer = self.session.call(Op.NIKON_EVENTS, doing="asking for news")
            return [handle for event, handle in parse_nikon_events(answer.data) if event in _ADDED]
        if self.dialect.source is Source.SONY_LIST and self.dialect.memory is not None:
            waiting = self.number(Prop.SONY_OBJECT_IN_MEMORY)
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
        stores = self.session.stores()
        if stores and not any(store.is_writable for store in stores):
            raise CameraError(
                f"{self._who}: its card cannot be written", hint="take the lock off the card"
            )
        if stores and all(store.free_bytes == 0 or store.free_images == 0 for store in stores):
            raise CameraError(
                f"{self._who}: its card is full",
                hint="make room on the card or put another one in",
            )
