"""The properties of one camera: described, read, set, and read back, in its own dialect."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress

from camctl.errors import (
    CameraBusyError,
    CameraDisconnectedError,
    CameraError,
    CameraProtocolError,
    CameraTimeoutError,
    RefusedSettingError,
)
from drivers.ptp.codes import Op, Prop
from drivers.ptp.datasets import PropertyDescription, Reader, pack_integer
from drivers.ptp.dialects import Dialect, Scale, Source
from drivers.ptp.dials import Dial, make_dial
from drivers.ptp.session import Session
from drivers.ptp.vendor_datasets import (
    merge_eos,
    pack_eos_property,
    parse_eos_events,
    parse_sony_properties,
)

# How long a body may take to show a setting that it has accepted, and pauses between looks.
READ_BACK_S = 3.0
_LOOK_S = 0.02
_MOST_STEPS = 200


@contextmanager
def _what_it_can() -> Iterator[None]:
    """Pass over a property that a camera lists and then knows nothing of."""
    try:
        yield
    except (CameraBusyError, CameraDisconnectedError, CameraTimeoutError):
        raise
    except CameraError:
        pass


class Properties:
    """What a camera can set and what it has set; `look` reads all of it.

    Args:
        session: open, in the mode that the dialect needs
        dialect: how the camera speaks
        who: how errors call it
    """

    def __init__(self, session: Session, dialect: Dialect, who: str) -> None:
        self._session, self._dialect, self._who = session, dialect, who
        scales = (*dialect.times, *dialect.gains, *dialect.f_numbers)
        presets = [code for code, _ in dialect.presets]
        self._codes = frozenset(
            {*(s.code for s in scales), *presets, dialect.program[0], dialect.battery}
        )
        self._known: dict[int, PropertyDescription] = {}
        self._added: list[int] = []
        self._stepped: set[int] = set()

    def description(self, code: int) -> PropertyDescription | None:
        """Return a property as it was when last looked at; None where the camera has none."""
        return self._known.get(code)

    def take_added(self) -> list[int]:
        """Return handles of new objects that came along with what was read; each once."""
        added, self._added = self._added, []
        return added

    def look(self) -> None:
        """Read again what the properties are and can be."""
        source = self._dialect.source
        if source is Source.ASKED:
            for code in sorted(self._codes.intersection(self._session.info.properties)):
                with _what_it_can():
                    self._known[code] = self._session.description(code)
        elif source is Source.SONY_LIST:
            answer = self._session.call(Op.SONY_PROPERTIES, doing="asking for its properties")
            self._known.update(parse_sony_properties(answer.data))
        else:
            self._listen_eos()

    def _listen_eos(self) -> None:
        answer = self._session.call(Op.EOS_EVENTS, doing="asking for news")
        news = parse_eos_events(answer.data)
        merge_eos(self._known, news, self._codes)
        self._added.extend(news.added)

    def number(self, code: int) -> int | None:
        """Return the number that a property has now; None where the camera does not tell."""
        if self._dialect.source is Source.ASKED:
            description = self._known.get(code)
            if description is None:
                return None
            answer = self._session.call(Op.GET_PROPERTY, code, doing=f"reading property {code:04X}")
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
            listed = self._dialect.times_s if name == "time_s" else ()
            dial = make_dial(name, scale, description, listed)
            if dial is not None:
                return dial
        return None

    def has_any(self, scales: Iterable[Scale]) -> bool:
        """Return whether the camera has one of these properties at all."""
        return any(scale.code in self._known for scale in scales)

    def check_mode(self, code: int) -> None:
        """Raise `CameraError` where the camera itself chooses the exposure.

        `code` is the shutter's property.
        """
        program, manual = self._dialect.program
        mode = self._known.get(program)
        description = self._known.get(code)
        in_manual = mode is None or mode.current in manual
        if in_manual and (description is None or description.is_writable):
            return
        if not in_manual and mode is not None and mode.is_writable:
            with suppress(CameraError):
                self.write(mode, min(manual))
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
            if applied == before and self._dialect.source is Source.SONY_LIST:
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
                self.write(description, number)
        except (CameraBusyError, CameraTimeoutError):
            raise
        except CameraError as error:
            self.look()
            if not self._known[dial.code].is_writable:
                raise CameraError(
                    f"{self._who} does not let {dial.name} be set", hint="turn the mode dial to M"
                ) from error
            raise

    def write(self, description: PropertyDescription, number: int) -> None:
        """Set a property, without looking what became of it."""
        code, doing = description.code, f"setting property {description.code:04X}"
        if self._dialect.source is Source.EOS_EVENTS:
            self._session.call(
                Op.EOS_SET_PROPERTY, doing=doing, data=pack_eos_property(code, number)
            )
            return
        operation = (
            Op.SONY_SET_PROPERTY if self._dialect.source is Source.SONY_LIST else Op.SET_PROPERTY
        )
        self._session.call(
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
            self._session.call(
                Op.SONY_CONTROL, dial.code, doing="turning a dial", data=direction, repeatable=False
            )

    def _read_back(self, code: int, number: int) -> int | None:
        deadline = time.monotonic() + (0 if self._dialect.source is Source.ASKED else READ_BACK_S)
        while True:
            now = self.number(code)
            if now == number or time.monotonic() > deadline:
                return now
            if Op.EOS_REQUEST_PROPERTY in self._session.info.operations:
                # The record of the change may have been lost, or there was none to tell.
                self._session.call(Op.EOS_REQUEST_PROPERTY, code, doing="reading a property")
            time.sleep(_LOOK_S)

    def preset(self) -> None:
        """Set what the dialect wants to be set from the beginning, where the camera can."""
        for code, number in self._dialect.presets:
            description = self._known.get(code)
            if (
                description is not None
                and description.is_writable
                and description.current != number
                and (not description.choices or number in description.choices)
            ):
                with _what_it_can():
                    self.write(description, number)

    def battery(self) -> int | None:
        """Return the charge in per cent, where the camera tells."""
        with suppress(CameraError):
            if Prop.BATTERY_LEVEL in self._session.info.properties:
                charge = self._session.description(Prop.BATTERY_LEVEL).current
                return charge if isinstance(charge, int) else None
            if self._dialect.battery in self._known:
                return self.number(self._dialect.battery)
        return None
