"""The properties of one camera: described, read, set, and read back, in the camera's dialect."""

from __future__ import annotations

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
from drivers.ptp.datasets import (
    EosEvents,
    PropertyDescription,
    Reader,
    pack_eos_property,
    pack_integer,
    parse_sony_properties,
)
from drivers.ptp.dialects import Dialect, Source
from drivers.ptp.dials import Dial, Scale, make_dial
from drivers.ptp.session import Session

# How long bodies of Canon and Sony may take to show a setting that they have accepted, and the
# pause between two readings.
_READ_BACK_S, _READ_BACK_POLL_S = 3.0, 0.02
# More than the settings of any dial: a dial that has not reached its setting then never will.
_MAX_STEPS = 200
_M_DIAL = "turn the mode dial to M"


@contextmanager
def _unsupported_ignored() -> Iterator[None]:
    """Ignore the refusal of a property that a camera lists and does not support."""
    try:
        yield
    except (CameraBusyError, CameraDisconnectedError, CameraTimeoutError):
        raise
    except CameraError:
        pass


class Properties:
    """The properties of a camera that matter for exposures; `refresh` reads all of them.

    Args:
        session: open, in the mode that the dialect needs
        dialect: of the camera
        name: name of the camera in error messages
    """

    def __init__(self, session: Session, dialect: Dialect, name: str) -> None:
        self._session, self._dialect, self._name = session, dialect, name
        scales = (*dialect.times, *dialect.gains, *dialect.f_numbers)
        presets = [code for code, _ in dialect.presets]
        self._codes = frozenset(
            {*(s.code for s in scales), *presets, dialect.program[0], dialect.battery}
        )
        self._known: dict[int, PropertyDescription] = {}
        self._added: list[int] = []
        self._stepped: set[int] = set()

    def description(self, code: int) -> PropertyDescription | None:
        """Return a property as it was at the latest `refresh`; None if the camera has none."""
        return self._known.get(code)

    def take_added(self) -> list[int]:
        """Return the handles of new objects in Canon's events since the last call."""
        added, self._added = self._added, []
        return added

    def refresh(self) -> None:
        """Read the descriptions of the properties again."""
        source = self._dialect.source
        if source is Source.EACH_PROPERTY:
            for code in sorted(self._codes.intersection(self._session.info.properties)):
                with _unsupported_ignored():
                    self._known[code] = self._session.description(code)
        elif source is Source.SONY_LIST:
            answer = self._session.call(Op.SONY_PROPERTIES, task="list its properties")
            self._known.update(parse_sony_properties(answer.data))
        else:
            answer = self._session.call(Op.EOS_EVENTS, task="report its events")
            events = EosEvents.parse(answer.data)
            events.update(self._known, self._codes)
            self._added.extend(events.added)

    def number(self, code: int) -> int | None:
        """Return the current number of a property; None if the camera does not report it."""
        if self._dialect.source is Source.EACH_PROPERTY:
            description = self._known.get(code)
            if description is None:
                return None
            answer = self._session.call(Op.GET_PROPERTY, code, task=f"report property {code:04X}")
            value = Reader(answer.data, "property").value(description.data_type)
        else:
            self.refresh()
            description = self._known.get(code)
            value = description.current if description else ""
        return value if isinstance(value, int) else None

    def battery_percent(self) -> int | None:
        """Return the charge of the battery; None if the camera does not report it."""
        with suppress(CameraError):
            if Prop.BATTERY_LEVEL in self._session.info.properties:
                charge = self._session.description(Prop.BATTERY_LEVEL).current
                return charge if isinstance(charge, int) else None
            if self._dialect.battery in self._known:
                return self.number(self._dialect.battery)
        return None

    # ---- modes

    def set_presets(self) -> None:
        """Set the dialect's presets, as far as the camera supports them."""
        for code, number in self._dialect.presets:
            description = self._known.get(code)
            if (
                description is not None
                and description.is_writable
                and description.current != number
                and (not description.choices or number in description.choices)
            ):
                with _unsupported_ignored():
                    self.write(description, number)

    def check_mode(self, code: int) -> None:
        """Set manual exposure if necessary.

        Args:
            code: property of the shutter time

        Raises:
            CameraError: the camera chooses the shutter time itself, and that cannot be changed
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
                self.refresh()
                description = self._known.get(code)
                if description is None or description.is_writable:
                    return
        raise CameraError(f"{self._name} chooses the shutter time itself", hint=_M_DIAL)

    # ---- dials

    def dial(self, name: str, scales: Iterable[Scale]) -> Dial | None:
        """Return the dial of the first of these properties that the camera has, or None."""
        for scale in scales:
            description = self._known.get(scale.code)
            if description is None:
                continue
            listed = self._dialect.stepped_times if name == "time_s" else ()
            dial = make_dial(name, scale, description, listed)
            if dial is not None:
                return dial
        return None

    def has_any(self, scales: Iterable[Scale]) -> bool:
        """Return whether the camera has one of these properties."""
        return any(scale.code in self._known for scale in scales)

    def set_dial(self, dial: Dial, value: float) -> float:
        """Set a dial; return the value read back, SI units.

        Raises:
            RefusedSettingError: the camera applied another value
            CameraError: the camera does not accept the value now
        """
        number = dial.number(value)
        before = self.number(dial.code)
        applied = before
        if before != number:
            self._turn(dial, number)
            applied = self._read_back(dial.code, number)
            if applied == before and self._dialect.source is Source.SONY_LIST:
                # Older bodies of Sony acknowledge a value and ignore it; they have to be stepped.
                self._stepped.add(dial.code)
                self._turn(dial, number)
                applied = self._read_back(dial.code, number)
        actual = None if applied is None else dial.value(applied)
        if actual is None:
            raise CameraProtocolError(
                f"{self._name} does not report the {dial.name} that it has set", hint=_M_DIAL
            )
        if applied != number:
            raise RefusedSettingError(dial.name, value, actual)
        return actual

    def write(self, description: PropertyDescription, number: int) -> None:
        """Set a property; the result is not read back."""
        code, task = description.code, f"set property {description.code:04X}"
        if self._dialect.source is Source.EOS_EVENTS:
            data = pack_eos_property(code, number)
            self._session.call(Op.EOS_SET_PROPERTY, task=task, data=data)
            return
        is_sony = self._dialect.source is Source.SONY_LIST
        operation = Op.SONY_SET_PROPERTY if is_sony else Op.SET_PROPERTY
        data = pack_integer(number, description.data_type)
        self._session.call(operation, code, task=task, data=data)

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
            self.refresh()
            if not self._known[dial.code].is_writable:
                raise CameraError(
                    f"{self._name} does not allow {dial.name} to be set", hint=_M_DIAL
                ) from error
            raise

    def _step_to(self, dial: Dial, number: int) -> None:
        """Step a dial up or down until it shows `number`."""
        up, down = (1).to_bytes(1, "little"), (0xFF).to_bytes(1, "little")
        goal, direction, distance = dial.value(number), up, float("inf")
        assert goal is not None
        for _ in range(_MAX_STEPS):
            shown = self.number(dial.code)
            if shown == number:
                return
            now = dial.value(shown) if shown is not None else None
            before, distance = distance, abs(now - goal) if now is not None else distance
            if distance > before:
                direction = down if direction == up else up
            self._session.call(
                Op.SONY_CONTROL, dial.code, task="turn a dial", data=direction, repeatable=False
            )

    def _read_back(self, code: int, number: int) -> int | None:
        """Return the number of a property: `number` if the camera shows it in time."""
        clock = self._session.clock
        is_delayed = self._dialect.source is not Source.EACH_PROPERTY
        deadline_s = clock.now() + (_READ_BACK_S if is_delayed else 0.0)
        while True:
            shown = self.number(code)
            if shown == number or clock.now() > deadline_s:
                return shown
            if Op.EOS_REQUEST_PROPERTY in self._session.info.operations:
                # The record of the change may be lost, or none was sent.
                task = f"report property {code:04X}"
                self._session.call(Op.EOS_REQUEST_PROPERTY, code, task=task)
            clock.sleep_until(clock.now() + _READ_BACK_POLL_S)
