"""The properties of one camera: described, read, set, and read back, in the camera's dialect."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace

from camctl.drivers.ptp.codes import M_DIAL, TO_SHOOTING, Op, Prop
from camctl.drivers.ptp.datasets import PropertyDescription, Reader, Value, pack_integer
from camctl.drivers.ptp.dialects import Dialect, Source
from camctl.drivers.ptp.dials import Dial, Scale, make_dial
from camctl.drivers.ptp.maker_datasets import (
    EosEvents,
    pack_eos_property,
    pack_panasonic_property,
    parse_panasonic_property,
    parse_panasonic_value,
    parse_sony_properties,
)
from camctl.drivers.ptp.session import Session
from camctl.errors import (
    CameraBusyError,
    CameraDisconnectedError,
    CameraError,
    CameraProtocolError,
    CameraTimeoutError,
    RefusedSettingError,
)

# How long bodies of Canon and Sony may take to show a setting that they have accepted, and the
# pause between two readings.
_READ_BACK_S, _READ_BACK_POLL_S = 3.0, 0.02
# The pause between two readings after a step, which takes up to 0.7 s.
_STEP_POLL_S = 0.1
# More than the settings of any dial: a dial that has not reached its setting then never will.
_MAX_STEPS = 200
# How long a camera may report no shutter time after it was opened, and the pause between requests.
_FIRST_READING_S, _FIRST_READING_POLL_S = 3.0, 0.1
# Codes above are Panasonic's, of 32 bits.
_LAST_STANDARD_CODE = 0xFFFF


@contextmanager
def unsupported_ignored() -> Iterator[None]:
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
        scales = _scales(dialect)
        others = [scale.set_by for scale in scales if scale.set_by is not None]
        presets = [preset.code for preset in dialect.presets]
        steps = [step for steps in dialect.releases for step in steps]
        awaited = [step.busy_at[0] for step in steps if step.busy_at is not None]
        self._codes = frozenset(
            {*(scale.code for scale in scales), *others, *presets, *awaited}
            | {dialect.program[0], dialect.battery}
            | (set(dialect.lens) if dialect.source is Source.EOS_EVENTS else set())
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

    def read_first(self) -> None:
        """Read the descriptions for the first time; some cameras send none until asked again."""
        clock = self._session.clock
        deadline_s = clock.now() + _FIRST_READING_S
        while True:
            self.refresh()
            if self._dialect.source is Source.EACH_PROPERTY or self.has_any(self._dialect.times):
                return
            if clock.now() > deadline_s:
                return
            clock.sleep_until(clock.now() + _FIRST_READING_POLL_S)

    def refresh(self, *, busy_s: float | None = None) -> None:
        """Read the descriptions of the properties again; `busy_s` as in `Session.call`."""
        source, session = self._dialect.source, self._session
        if source is Source.SONY_LIST:
            answer = session.call(Op.SONY_PROPERTIES, task="list its properties", busy_s=busy_s)
            self._known.update(parse_sony_properties(answer.data))
        elif source is Source.EOS_EVENTS:
            answer = session.call(Op.EOS_EVENTS, task="report its events", busy_s=busy_s)
            events = EosEvents.parse(answer.data)
            events.update(self._known, self._codes)
            self._added.extend(events.added)
        else:
            tried = self._dialect.tried.union(session.info.properties)
            if source is Source.PANASONIC:
                tried |= {scale.code for scale in _scales(self._dialect)}
            for code in sorted(self._codes & tried):
                with unsupported_ignored():
                    self._known[code] = self._describe(code)

    def _describe(self, code: int) -> PropertyDescription:
        if code <= _LAST_STANDARD_CODE:
            return self._session.description(code)
        task = f"describe property {code:08X}"
        answer = self._session.call(Op.PANASONIC_DESCRIPTION, code, 0, 0, task=task)
        return parse_panasonic_property(answer.data, code)

    def number(self, code: int) -> int | None:
        """Return the current number of a property; None if the camera does not report it."""
        task = f"report property {code:04X}"
        value: Value
        if code > _LAST_STANDARD_CODE:
            answer = self._session.call(Op.PANASONIC_GET, code, task=task)
            value = parse_panasonic_value(answer.data)
        elif self._dialect.source in (Source.EACH_PROPERTY, Source.PANASONIC):
            description = self._known.get(code)
            if description is None:
                return None
            answer = self._session.call(Op.GET_PROPERTY, code, task=task)
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

    def mode(self) -> str | None:
        """Return where the mode dial stands; None if the camera does not report it."""
        with suppress(CameraError):
            number = self.number(self._dialect.program[0])
            return None if number is None else self._dialect.modes.get(number)
        return None

    def lens(self) -> str | None:
        """Return the name of the lens, or its focal lengths and apertures; None: not reported."""
        found: list[Value] = []
        with suppress(CameraError):
            for code in self._dialect.lens:
                if (known := self._known.get(code)) is None:
                    if code not in self._session.info.properties:
                        return None
                    known = self._session.description(code)
                found.append(known.current)
        return _lens_text(found)

    # ---- modes

    def set_presets(self) -> None:
        """Set the dialect's presets, as far as the camera supports them.

        Raises:
            CameraError: the camera keeps another value of one that it must have
        """
        for preset in self._dialect.presets:
            description = self._known.get(preset.code)
            if description is None or description.current == preset.number:
                continue
            if description.is_writable and (
                not description.choices or preset.number in description.choices
            ):
                with unsupported_ignored():
                    self.write(description, preset.number)
            if preset.refusal and self._read_back(preset.code, preset.number) != preset.number:
                what, hint = preset.refusal
                raise CameraError(f"{self._name} {what}", hint=hint)

    def check_mode(self, code: int) -> None:
        """Set manual exposure if necessary.

        Args:
            code: property of the shutter time

        Raises:
            CameraError: the camera chooses the shutter time itself, and that cannot be changed
        """
        program, manual = self._dialect.program
        if self._can_set(code):
            return
        mode = self._known.get(program)
        in_manual = mode is None or not manual or mode.current in manual
        if not in_manual and mode is not None and mode.is_writable:
            with suppress(CameraError):
                self.write(mode, min(manual))
                self.refresh()
        if self._can_set(code):
            return
        if in_manual and manual:
            raise CameraError(
                f"{self._name} does not let a computer set the shutter time",
                hint="its mode dial is at M: turn a shutter speed dial to 1/3 STEP, choose remote "
                "control in its USB menu, and leave playback, menus and movie mode; else its "
                "model is not supported",
            )
        raise CameraError(f"{self._name} chooses the shutter time itself", hint=M_DIAL)

    def _can_set(self, code: int) -> bool:
        """Return whether manual exposure is set, as far as is known, and a property can be set."""
        program, manual = self._dialect.program
        mode, description = self._known.get(program), self._known.get(code)
        in_manual = mode is None or not manual or mode.current in manual
        return in_manual and (description is None or description.is_writable)

    # ---- dials

    def dial(self, name: str, scales: Iterable[Scale]) -> Dial | None:
        """Return the dial of the first of these properties that the camera has, or None.

        Where the first cannot be set, one that can be set is preferred.
        """
        found: list[Dial] = []
        listed = self._dialect.listed_times if name == "time_s" else ()
        for scale in scales:
            description = self._known.get(scale.code)
            if description is None:
                continue
            setter = None if scale.set_by is None else self._known.get(scale.set_by)
            if setter is not None and setter.is_writable and not description.choices:
                # What is set by another property is listed there, where it is listed at all.
                description = replace(description, is_writable=True, choices=setter.choices)
            is_stepped = self._dialect.is_stepped
            dial = make_dial(name, scale, description, listed, is_stepped=is_stepped)
            if dial is not None and description.is_writable:
                return dial
            if dial is not None:
                found.append(dial)
        return found[0] if found else None

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
        applied = before = self.number(dial.code)
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
                f"{self._name} does not report the {dial.name} that it has set", hint=M_DIAL
            )
        if applied != number:
            raise RefusedSettingError(dial.name, value, actual, TO_SHOOTING * (applied == before))
        return actual

    def write(self, description: PropertyDescription, number: int) -> None:
        """Set a property; the result is not read back."""
        code, task = description.code, f"set property {description.code:04X}"
        if code > _LAST_STANDARD_CODE:
            # The code to set is the next one after the code of the description.
            data = pack_panasonic_property(code + 1, number, description.data_type)
            self._session.call(Op.PANASONIC_SET, code + 1, task=task, data=data)
            return
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
            by = self._known.get(dial.scale.set_by) if dial.scale.set_by is not None else None
            if by is not None and by.is_writable:
                self.write(by, number)
            elif dial.is_stepped or dial.code in self._stepped:
                self._step_to(dial, number)
            else:
                self.write(description, number)
        except (CameraBusyError, CameraTimeoutError):
            raise
        except CameraError as error:
            self.refresh()
            if not self._known[dial.code].is_writable:
                raise CameraError(
                    f"{self._name} does not allow {dial.name} to be set", hint=M_DIAL
                ) from error
            raise

    def _step_to(self, dial: Dial, number: int) -> None:
        """Step a dial up or down until it shows `number`.

        Each step is awaited before the next: a body may need 0.7 s to take it.  A dial that stays
        where it is, or that passes the setting, is left there; reading back will show.
        """
        up, down = (1).to_bytes(1, "little"), (0xFF).to_bytes(1, "little")
        goal, direction, distance = dial.value(number), up, float("inf")
        assert goal is not None
        shown = self.number(dial.code)
        for _ in range(_MAX_STEPS):
            if shown == number:
                return
            now = dial.value(shown) if shown is not None else None
            before, distance = distance, abs(now - goal) if now is not None else distance
            if distance > before:
                direction = down if direction == up else up
            self._session.call(
                Op.SONY_CONTROL, dial.code, task="turn a dial", data=direction, repeatable=False
            )
            last, shown = shown, self._changed_from(dial.code, shown)
            if shown == last and direction == down:
                return  # at the end of the dial, and up was tried before
            if shown == last:
                direction = down

    def _changed_from(self, code: int, before: int | None) -> int | None:
        """Return the number of a property as soon as it is not `before`, or after 3 s."""
        clock = self._session.clock
        deadline_s = clock.now() + _READ_BACK_S
        while (shown := self.number(code)) == before and clock.now() < deadline_s:
            clock.sleep_until(clock.now() + _STEP_POLL_S)
        return shown

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


def _scales(dialect: Dialect) -> tuple[Scale, ...]:
    return (*dialect.times, *dialect.gains, *dialect.f_numbers)


def _lens_text(found: Sequence[Value]) -> str | None:
    """Return a lens by its name, or by four numbers in hundredths.

    >>> _lens_text([1800, 5500, 350, 560]), _lens_text([5000, 5000, 180, 180]), _lens_text([""])
    ('18-55 mm f/3.5-5.6', '50 mm f/1.8', None)
    """
    match found:
        case [str(name)]:
            return name or None
        case [int(), int(), int(), int()] if all(found):
            low, high, *f_numbers = (f"{each / 100:g}" for each in found if isinstance(each, int))
            pairs = ((low, high), f_numbers)
            lengths, apertures = ("-".join(dict.fromkeys(pair)) for pair in pairs)
            return f"{lengths} mm f/{apertures}"
    return None
