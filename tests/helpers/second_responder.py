"""A second opinion on the makers' cameras: written from what libgphoto2 does and recorded bodies.

It shares nothing with the virtual cameras of `camctl.sim.devices`.  When an event comes, when a
property shows its value and how long a lens focuses is drawn at random from a seed.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from random import Random
from types import SimpleNamespace
from typing import Any, Final, TypeAlias

from PIL import Image

from camctl.drivers.ptp.camera import PtpCamera, PtpOptions
from camctl.drivers.ptp.transport import DATA, RESPONSE, Container
from camctl.errors import CameraProtocolError
from camctl.interface.camera import CameraInfo
from camctl.interface.clock import VirtualClock

OK, REFUSED, NO_OBJECT, BUSY, NO_PROPERTY = 0x2001, 0x2005, 0x2009, 0x2019, 0x200A
EVENT: Final = 4  # kind of a container
JPEG, FOLDER = 0x3801, 0x3001
SHAPE = (8, 16)
U8, U16, U32 = 2, 4, 6
SIZES = {U8: "B", U16: "H", U32: "I"}
#: Response code, data and parameters.
Answer: TypeAlias = tuple[int, bytes | None, tuple[int, ...]]

#: Event orders: what is announced, and when, relative to the moment the file can be read, s; "F"
#: stands for the moment when the host has fetched the file, "R" for before the response.
ORDERS: Final[dict[str, tuple[tuple[str, str, float], ...]]] = {
    "before the file": (("file", "", -0.08),),
    "with the file": (("file", "", 0.0),),
    "after the file": (("file", "", 0.15),),
    "twice": (("file", "", 0.0), ("file", "", 0.3)),
    "never": (),
    "folder first": (("folder", "", -0.05), ("file", "", 0.02)),
    "before the response": (("file", "R", 0.0),),
    "after it was fetched": (("file", "F", 0.01),),
    "long after it was fetched": (("file", "F", 0.6),),
}


@dataclass(frozen=True)
class Maker:
    """What is particular of a maker.

    Attributes:
        extension, make: of its device information
        operations: that it lists
        shutter: its property, type, and numbers by seconds
        others: further properties with their type, number and choices
        added: its event of a new object
        lag_s: how long a property may show its old number
    """

    extension: int
    make: str
    operations: tuple[int, ...]
    shutter: tuple[int, int, dict[float, int]]
    others: dict[int, tuple[int, int, tuple[int, ...]]]
    added: int
    lag_s: float = 0.0


_RATIOS = {1 / 60: 1 << 16 | 60, 1 / 15: 1 << 16 | 15, 1 / 4: 1 << 16 | 4}
_CARD = (0x1007, 0x1008, 0x1009)
_EACH = (0x1014, 0x1015, 0x1016)
MAKERS: Final[dict[str, Maker]] = {
    "nikon": Maker(
        0x0A,
        "Nikon Corporation",
        (*_CARD, *_EACH, 0x90C7, 0x90C8, 0x9207),
        (0xD100, U32, _RATIOS),
        {0x500E: (U16, 1, (1,)), 0x500F: (U16, 100, (100, 400))},
        0x4002,
    ),
    "canon": Maker(
        0x0B,
        "Canon Inc.",
        (*_CARD, 0x910F, 0x9110, 0x9114, 0x9115, 0x9116, 0x911D, 0x9127, 0x9128, 0x9129),
        (0xD102, U32, {1 / 64: 0x68, 1 / 16: 0x58, 1 / 4: 0x48}),
        {0xD105: (U32, 3, (3,)), 0xD103: (U32, 0x48, (0x48, 0x58)), 0xD11C: (U32, 2, (2, 4))},
        0xC181,
        0.3,
    ),
    "sony": Maker(
        0x11,
        "Sony Corporation",
        (0x1008, 0x1009, 0x9201, 0x9202, 0x9205, 0x9207, 0x9209),
        (0xD20D, U32, _RATIOS),
        {
            0x500E: (U32, 1, ()),
            0x500A: (U16, 1, ()),
            0xD213: (U8, 1, ()),
            0xD215: (U16, 0, ()),
            0xD21E: (U32, 100, (100, 400)),
        },
        0xC201,
        0.7,
    ),
    "fuji": Maker(
        0x0E,
        "FUJIFILM",
        (*_CARD, *_EACH, 0x100E),
        (0x500D, U32, {1 / 64: 15625, 1 / 16: 62500, 1 / 4: 250000}),
        {
            0x500E: (U16, 1, (1,)),
            0xD207: (U16, 1, (1, 2)),
            0xD208: (U16, 0x304, (0x200, 0x304, 4)),
            0xD209: (U16, 2, ()),
        },
        0xC004,
    ),
    "olympus": Maker(
        0xFFFD,
        "OLYMPUS IMAGING CORP.",
        (*_CARD, *_EACH, 0x9481),
        (0xD01C, U32, _RATIOS),
        {0xD007: (U16, 100, (100, 400)), 0xD052: (U16, 0, (0, 1))},
        0xC102,
    ),
    "panasonic": Maker(
        0x1C,
        "Panasonic",
        (*_CARD, 0x9102, 0x9103, 0x9108, 0x9401, 0x9402, 0x9403, 0x9404),
        (0x0200_0030, U32, {1 / 60: 60_000, 1 / 15: 15_000, 1 / 4: 4_000}),
        {0x0200_0020: (U32, 100, (100, 400))},
        0xC108,
        0.3,
    ),
}


class SecondCamera:
    """One camera, as the transport of the driver sees it.

    Attributes:
        taken: (shutter number in force, file name) of each picture
        log: codes of the operations, in order
        faults: what a host did that the real camera would not forgive
    """

    silence_s = 20.0

    def __init__(self, maker: str, order: str, seed: int, **manners: Any) -> None:
        self.kind, self.name, self.order = MAKERS[maker], maker, ORDERS[order]
        self.random, self.clock = Random(f"{maker} {order} {seed}"), VirtualClock()
        self.manners = manners
        self.taken: list[tuple[int, str]] = []
        self.log: list[int] = []
        self.faults: list[str] = []
        code, _, numbers = self.kind.shutter
        self.values = {each: number for each, (_, number, _) in self.kind.others.items()}
        self.values[code] = self.shown_shutter = max(numbers.values())
        self.shown = dict(self.values)
        self._due: list[tuple[float, int, Callable[[], None]]] = []
        self._events: list[tuple[float, int, int]] = []
        self._records: list[bytes] = []
        self._files: dict[int, tuple[str, bytes]] = {}
        self._memory: list[tuple[str, bytes]] = []
        self._reply: list[Container] = []
        self._pressed: dict[str, float] = {}
        self._busy_until_s, self._unanswered = 0.0, 0
        self._is_failing = bool(manners.get("fails_to_focus"))

    # ---- transport

    def send(
        self, operation: int, transaction: int, parameters: Sequence[int], data: bytes | None
    ) -> None:
        self._wait(self.random.uniform(0.0005, 0.004))
        self.log.append(operation)
        known = operation in (0x1001, 0x1002, 0x1003) or operation in self.kind.operations
        refused: Answer = REFUSED, None, ()
        code, sent, answers = (
            self._execute(operation, tuple(parameters), data or b"") if known else refused
        )
        self._reply = []
        if sent is not None:
            self._reply.append(Container(DATA, operation, transaction, sent))
        payload = struct.pack(f"<{len(answers)}I", *answers)
        self._reply.append(Container(RESPONSE, code, transaction, payload))

    def receive(self, transaction: int, *, limit: int) -> Container:
        if not self._reply:
            raise CameraProtocolError("nothing to receive")
        return self._reply.pop(0)

    def event(self, wait_s: float) -> Container | None:
        ends_s = self.clock.now() + wait_s
        while True:
            due = [each for each in sorted(self._events) if each[0] <= self.clock.now()]
            if due:
                self._events.remove(due[0])
                return Container(EVENT, due[0][1], 0, struct.pack("<I", due[0][2]))
            if self.clock.now() >= ends_s:
                return None
            self._wait(min(0.01, ends_s - self.clock.now()))

    def recover(self, transaction: int) -> bool:
        return True

    def reset(self) -> None: ...

    def close(self) -> None: ...

    # ---- time

    def _wait(self, seconds: float) -> None:
        self.clock.sleep_until(self.clock.now() + seconds)
        while self._due and min(self._due)[0] <= self.clock.now():
            entry = min(self._due)
            self._due.remove(entry)
            entry[2]()

    def _later(self, seconds: float, action: Callable[[], None]) -> None:
        self._due.append((self.clock.now() + seconds, len(self._due) + len(self.log), action))

    def _announce(self, seconds: float, code: int, parameter: int) -> None:
        at_s = self.clock.now() + max(0.0, seconds)
        if self.name == "nikon":
            self._later(seconds, lambda: self._records.append(struct.pack("<HI", code, parameter)))
        elif self.name == "canon":
            body = struct.pack("<IIHHII", parameter, 1, JPEG, 0, 0, 100) + bytes(16)
            self._later(seconds, lambda: self._record(code, body))
        else:
            self._events.append((at_s, code, parameter))

    def _record(self, kind: int, body: bytes) -> None:
        self._records.append(struct.pack("<II", 8 + len(body), kind) + body)

    # ---- pictures

    def _take(self) -> None:
        """Expose and save a picture, and announce it in the order of this camera."""
        code, _, numbers = self.kind.shutter
        number = self.values[code]
        time_s = next(time_s for time_s, each in numbers.items() if each == number)
        name = f"SEC_{len(self.taken) + 1:04d}.JPG"
        self.taken.append((number, name))
        level = 60 + 40 * sorted(numbers).index(time_s)
        file = io.BytesIO()
        Image.new("L", SHAPE[::-1], level).save(file, "jpeg")
        saved_s = time_s + self.random.uniform(0.02, 0.5)
        handle = 0xFFFF_C001 if self.name == "sony" else 0x1000 + 2 * len(self.taken)
        self._busy_until_s = self.clock.now() + saved_s

        def save() -> None:
            if self.name == "sony":
                self._memory.append((name, file.getvalue()))
                self._show_memory()
            else:
                self._files[handle] = (name, file.getvalue())
            for what, when, seconds in self.order:
                if when == "" and seconds >= 0:
                    self._announce(seconds, self.kind.added, self._of(what, handle))

        for what, when, seconds in self.order:
            if when == "R":
                self._announce(0.0, self.kind.added, self._of(what, handle))
            elif when == "" and seconds < 0:
                self._announce(saved_s + seconds, self.kind.added, self._of(what, handle))
        if self.name == "sony" and self.random.random() < 0.5:
            self._later(
                saved_s / 2, lambda: self.shown.update({0xD215: 1})
            )  # not to be fetched yet
        if self.name == "panasonic":
            self._later(saved_s, lambda: self._ask(save))
        else:
            self._later(saved_s, save)

    def _of(self, what: str, handle: int) -> int:
        return handle if what == "file" else 0x0FFF

    def _ask(self, save: Callable[[], None]) -> None:
        """Panasonic's event C101, after whose answer the picture is saved."""
        self._unanswered = 0x77
        self._saving = save
        self._events.append((self.clock.now(), 0xC101, self._unanswered))

    def _show_memory(self) -> None:
        self.shown[0xD215] = 0x8000 + len(self._memory) if self._memory else 0

    def _object_info(self, handle: int) -> bytes | None:
        entry = self._entry(handle)
        if handle == 0x0FFF:
            entry = ("DCIM", b"")
        if entry is None:
            return None
        name, data = entry
        text = name.encode("utf-16le") + b"\0\0"
        kind = FOLDER if handle == 0x0FFF else JPEG
        head = struct.pack("<IHHIHIIIIIIIHII", 1, kind, 0, len(data), *(0,) * 11)
        return head + bytes([len(name) + 1]) + text + b"\0\0\0"

    def _entry(self, handle: int) -> tuple[str, bytes] | None:
        if handle == 0xFFFF_C001:
            return self._memory[0] if self._memory else None
        return self._files.get(handle)

    def _fetch(self, handle: int) -> Answer:
        entry = self._entry(handle)
        if entry is None:
            self.faults += ["fetched nothing"] if self.name == "sony" else []
            return NO_OBJECT, None, ()
        if handle == 0xFFFF_C001:
            self._memory.pop(0)
            self._show_memory()
        for what, when, seconds in self.order:
            if when == "F":
                late_s = seconds * self.random.uniform(0.5, 2)
                self._announce(late_s, self.kind.added, self._of(what, handle))
        return OK, entry[1], ()

    # ---- operations

    def _execute(self, code: int, parameters: tuple[int, ...], data: bytes) -> Answer:
        first = parameters[0] if parameters else 0
        if code == 0x1001:
            return OK, self._device_info(), ()
        if code in (0x1002, 0x1003):
            return OK, None, ()
        if code == 0x1007:
            listed = sorted(self._files)
            return OK, struct.pack(f"<I{len(listed)}I", len(listed), *listed), ()
        if code == 0x1008:
            info = self._object_info(first)
            return (OK, info, ()) if info is not None else (NO_OBJECT, None, ())
        if code == 0x1009:
            return self._fetch(first)
        if code in _EACH:
            return self._standard_property(code, first, data)
        handler = getattr(self, f"_{self.name}")
        answer: Answer = handler(code, parameters, data)
        return answer

    def _device_info(self) -> bytes:
        def array(codes: Sequence[int]) -> bytes:
            return struct.pack(f"<I{len(codes)}H", len(codes), *codes)

        def text(word: str) -> bytes:
            return bytes([len(word) + 1]) + word.encode("utf-16le") + b"\0\0"

        known = [c for c in (*self.kind.others, self.kind.shutter[0]) if c <= 0xFFFF]
        listed = known if self.name in ("nikon", "fuji", "olympus") else []
        head = struct.pack("<HIH", 100, self.kind.extension, 100) + text("x") + b"\0\0"
        lists = array((0x1001, 0x1002, 0x1003, *self.kind.operations)) + array(()) + array(listed)
        names = b"".join(map(text, (self.kind.make, f"Second {self.name}", "1", "42")))
        return head + lists + array((JPEG,)) + array((JPEG,)) + names

    def _property(self, code: int) -> tuple[int, tuple[int, ...]] | None:
        if code == self.kind.shutter[0]:
            return self.kind.shutter[1], tuple(self.kind.shutter[2].values())
        if code in self.kind.others:
            data_type, _, choices = self.kind.others[code]
            return data_type, choices
        return None

    def _set(self, code: int, number: int) -> int:
        found = self._property(code)
        if found is None or (found[1] and number not in found[1]):
            return 0x201B
        lag_s = self.random.uniform(0, self.kind.lag_s)

        def take_effect() -> None:
            self.values[code] = self.shown[code] = number
            if self.name == "canon":
                self._record(0xC189, struct.pack("<II", code, number))

        if lag_s:
            self._later(lag_s, take_effect)
        else:
            take_effect()
        return OK

    def _standard_property(self, code: int, which: int, data: bytes) -> Answer:
        found = self._property(which)
        if found is None:
            return NO_PROPERTY, None, ()
        data_type, choices = found
        form = SIZES[data_type]
        if code == 0x1015:
            return OK, struct.pack(f"<{form}", self.shown[which]), ()
        if code == 0x1016:
            return self._set(which, struct.unpack(f"<{form}", data)[0]), None, ()
        now = self.shown[which]
        head = struct.pack(f"<HHB{form}{form}", which, data_type, 1, now, now)
        listed = struct.pack(f"<BH{len(choices)}{form}", 2, len(choices), *choices)
        return OK, head + (listed if choices else b"\0"), ()

    def _nikon(self, code: int, parameters: tuple[int, ...], data: bytes) -> Any:
        if code == 0x90C8:
            return (BUSY if self.clock.now() < self._busy_until_s else OK), None, ()
        if code == 0x90C7:
            records, self._records = self._records, []
            return OK, struct.pack("<H", len(records)) + b"".join(records), ()
        self._take()
        return OK, None, ()

    def _canon(self, code: int, parameters: tuple[int, ...], data: bytes) -> Any:
        first = parameters[0] if parameters else 0
        if code == 0x9114:
            for each, number in self.shown.items():
                _, choices = self._property(each) or (0, ())
                self._record(0xC189, struct.pack("<II", each, number))
                numbers = struct.pack(f"<III{len(choices)}I", each, 3, len(choices), *choices)
                self._record(0xC18A, numbers)
        elif code == 0x9110:
            _, which, number = struct.unpack("<III", data)
            return self._set(which, number), None, ()
        elif code == 0x9116:
            if self.random.random() < 0.3:
                return OK, struct.pack("<II", 8, 0), ()  # empty, whatever waits
            records, self._records = self._records, []
            return OK, b"".join(records) + struct.pack("<II", 8, 0), ()
        elif code == 0x9128 and self.manners.get("refuses_presses"):
            return REFUSED, None, ()
        elif code == 0x9128:
            if first == 1 and self._pressed:
                self.faults.append("pressed while pressed")
            if first == 2 and 1 not in [int(each) for each in self._pressed]:
                self.faults.append("full press without half")
            if first == 2 and self.manners.get("refuses_full") and self.log.count(0x9128) < 3:
                return 0x2002, None, ()
            self._pressed[str(first)] = self.clock.now()
            if first == 1:
                self._wait(self.random.uniform(0, 0.8))  # it answers once it has focused
            elif first in (2, 3):
                self._take()
        elif code == 0x9129:
            self._pressed.pop(str(first), None)
        elif code == 0x910F:
            self._take()
            return OK, None, (0,)
        return OK, None, ()

    def _sony(self, code: int, parameters: tuple[int, ...], data: bytes) -> Any:
        first = parameters[0] if parameters else 0
        if code == 0x9205:
            return self._set(first, struct.unpack("<I", data)[0]), None, ()
        if code == 0x9209:
            return OK, self._sony_list(), ()
        if code in (0x9201, 0x9202):
            return OK, bytes(8), ()
        state = struct.unpack("<H", data)[0]
        name = {0xD2C1: "focus", 0xD2C2: "shutter"}.get(first, "")
        if state == 2:
            self._pressed[name] = self.clock.now()
        else:
            self._pressed.pop(name, None)
        if state == 2 and name == "shutter":
            manual = self.values[0x500A] == 1
            self.shown[0xD213] = 1
            self._later(0.0 if manual else self.random.uniform(0.1, 0.85), self._sony_focused)
        return OK, None, ()

    def _sony_focused(self) -> None:
        """The lens has focused: if the shutter is still pressed, the picture is taken."""
        self.shown[0xD213] = 2
        if "shutter" in self._pressed or self.values[0x500A] == 1:
            self._take()

    def _sony_list(self) -> bytes:
        rows = []
        for code in sorted(self.shown):
            data_type, choices = self._property(code) or (U32, ())
            form, now = SIZES[data_type], self.shown[code]
            row = struct.pack(f"<HHBB{form}{form}", code, data_type, 1, 1, 0, now)
            row += struct.pack(f"<BH{len(choices)}{form}", 2, len(choices), *choices)
            rows.append(row)
        return struct.pack("<II", len(rows), 0) + b"".join(rows)

    def _fuji(self, code: int, parameters: tuple[int, ...], data: bytes) -> Any:
        button = self.values[0xD208]
        if self.values[0xD207] != 2:
            return BUSY, None, ()
        if button == 0x200:
            if "half" in self._pressed:
                self.faults.append("half press stayed")
                return BUSY, None, ()
            self._pressed["half"] = self.clock.now()
            self.shown[0xD209] = 1
            found, self._is_failing = (3 if self._is_failing else 2), False
            self._later(self.random.uniform(0.05, 1.5), lambda: self.shown.update({0xD209: found}))
        elif button == 0x304:
            self._pressed.clear()
            self._take()
        elif button == 4:
            self._pressed.clear()
        return OK, None, ()

    def _olympus(self, code: int, parameters: tuple[int, ...], data: bytes) -> Any:
        if parameters == (3,):
            self._take()
        return OK, None, ()

    def _panasonic(self, code: int, parameters: tuple[int, ...], data: bytes) -> Any:
        first = parameters[0] if parameters else 0
        if code == 0x9108:
            found = self._property(first)
            if found is None:
                return NO_PROPERTY, None, ()
            _, choices = found
            numbers = (first, 2, U32, 0, self.shown[first], len(choices), *choices)
            return OK, struct.pack(f"<{len(numbers)}I", *numbers), ()
        if code == 0x9402:
            if first not in self.shown:
                return NO_PROPERTY, None, ()
            return OK, struct.pack("<III", first, 4, self.shown[first]), ()
        if code == 0x9403:
            which, _, number = struct.unpack("<III", data)
            return self._set(which - 1, number), None, ()
        if code == 0x9401 and first == self._unanswered:
            self._unanswered = 0
            self._later(self.random.uniform(0, 0.2), self._saving)
        if code == 0x9404:
            if self._unanswered:
                return BUSY, None, ()
            self._take()
        return OK, None, ()


class SecondPtpCamera(PtpCamera):
    """Our driver on such a camera."""

    def __init__(self, second: SecondCamera) -> None:
        place = SimpleNamespace(bus=1, address=1)
        options = PtpOptions.parse({"response": "linear", "format": "jpeg"})
        super().__init__(place, options, clock=second.clock)
        self._second = second

    def _connect(self) -> Any:
        self._name = f"the second {self._second.name}"
        return self._second

    def _identity(self) -> CameraInfo:
        info = self._body.session.info
        return CameraInfo(f"ptp:{self._second.name}", info.make, info.model, info.serial, "ptp")
