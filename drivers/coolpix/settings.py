"""What a CoolPix 990 can be set to: tables of registers, and trying out what it takes.

Which values the real camera takes is documented nowhere.  Those of its sister, the CoolPix 880, are
(libgphoto2's description of that camera), and so are the standard scales of shutter times; each is
written, and offered if it is read back unchanged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from camctl.controls import ExposureSetting
from camctl.errors import CameraError, RefusedSettingError
from drivers.coolpix.sierra.packets import RefusedCommandError, Register
from drivers.coolpix.sierra.session import Sierra

AUTOMATIC = 0

# Nominal times: 1/n s below one second, then s.  Third and half stops, and the CoolPix 880's own.
_PARTS = (1000, 800, 750, 640, 500, 400, 350, 320, 250, 200, 180, 160, 125, 100, 90, 80, 60, 50)
_PARTS_MORE = (45, 40, 30, 25, 20, 15, 13, 10, 8, 6, 5, 4, 3, 2.5, 2, 1.6, 1.5, 1.3)
_SECONDS = (1, 1.3, 1.5, 1.6, 2, 2.5, 3, 3.2, 4, 5, 6, 7, 8)

#: Shutter times to try, us, ascending; parts of a second are cut off as the CoolPix 880 does.
CANDIDATES_US: tuple[int, ...] = tuple(
    sorted(
        {int(1_000_000 / part) for part in _PARTS + _PARTS_MORE}
        | {round(1_000_000 * seconds) for seconds in _SECONDS}
    )
)


@dataclass(frozen=True)
class Aperture:
    """A setting of the aperture register, and the f-number that it is taken for."""

    word: str
    codes: tuple[int, ...]
    f_number: float


# The lens is marked 1:2.5-4 and closes in ten settings a third of a stop apart.  These hold at the
# wide end of the zoom; at the long end all are 1.6 times as much.  Descriptions of the protocol do
# not agree on the number of "high".
APERTURES = (
    Aperture("low", (1,), 2.5),
    Aperture("medium", (2,), 4.0),
    Aperture("high", (3, 4), 7.0),
)


@dataclass(frozen=True)
class FileFormat:
    """A file format as the camera calls it.

    Attributes:
        codes: values of the register of resolution and quality that give it (CoolPix 880)
        default: the one to set where another is in force: all pixels, best quality
        suffixes: of file names
        magic: what files begin with
        typical_bytes: size of a file of 2048 x 1536 pixels
    """

    codes: tuple[int, ...]
    default: int
    suffixes: tuple[str, ...]
    magic: tuple[bytes, ...]
    typical_bytes: int


FORMATS = {
    "jpeg": FileFormat(
        (0x01, 0x02, 0x03, 0x07, 0x08, 0x09, 0x11, 0x12, 0x13),
        0x13,
        (".JPG", ".JPEG"),
        (b"\xff\xd8\xff",),
        1_300_000,
    ),
    "tiff": FileFormat((0x23,), 0x23, (".TIF", ".TIFF"), (b"II*\0", b"MM\0*"), 2048 * 1536 * 3),
}


@dataclass(frozen=True)
class Steadying:
    """A setting that must not change from frame to frame.

    Attributes:
        register: which
        unsteady: values under which the camera decides for each picture
        steady: what to set instead
        note: what a person should know then
    """

    register: Register
    unsteady: tuple[int, ...]
    steady: int
    note: str


STEADYINGS = (
    Steadying(Register.FLASH, (0, 1, 3, 4), 2, "its flash is switched off"),
    Steadying(Register.WHITE_BALANCE, (0,), 1, "its white balance is fixed at sunlight"),
    Steadying(Register.ADJUSTMENT, (5,), 0, "its automatic contrast is switched off"),
)


def takes(sierra: Sierra, register: Register, value: int) -> bool:
    """Write a register and say whether it reads back unchanged; False where it is refused.

    Raises:
        CameraTimeoutError, CameraDisconnectedError, CameraProtocolError
    """
    try:
        sierra.set(register, value)
        return sierra.get(register) == value
    except RefusedCommandError:
        return False


def told(sierra: Sierra, register: Register) -> int | None:
    """Return a register, None where the camera refuses to tell it."""
    try:
        return sierra.get(register)
    except RefusedCommandError:
        return None


def find_times_us(sierra: Sierra, candidates: Sequence[int] = CANDIDATES_US) -> tuple[int, ...]:
    """Return the shutter times that the camera takes, us, ascending; the old one is restored.

    Raises:
        CameraError: it takes none
    """
    before = told(sierra, Register.SHUTTER_US)
    times = tuple(us for us in candidates if takes(sierra, Register.SHUTTER_US, us))
    if before is not None:
        sierra.set(Register.SHUTTER_US, before)
    if not times:
        raise CameraError(
            f"the camera at {sierra.link.url} takes no shutter time",
            hint="turn its dial to M (manual recording), then try again",
        )
    return times


def find_apertures(sierra: Sierra) -> dict[float, int]:
    """Return the codes of the aperture settings that the camera takes, by f-number, ascending."""
    before = told(sierra, Register.APERTURE)
    if before is None:
        return {}
    found = {}
    for aperture in APERTURES:
        for code in aperture.codes:
            if takes(sierra, Register.APERTURE, code):
                found[aperture.f_number] = code
                break
    sierra.set(Register.APERTURE, before)
    return found


_MICRO = 1_000_000
_ATTEMPTS = 2


class CoolpixDials:
    """What the camera can be set to and is set to.

    Args:
        sierra: an open session
        file_format: a name in `FORMATS`

    Attributes:
        apertures: codes of the aperture settings that the camera takes, by f-number
        times_us: shutter times that it takes, us, ascending
        steadied: what was set for the whole sequence, one line each

    Raises:
        CameraError: it takes no shutter time, or cannot be set to the file format
        CameraTimeoutError, CameraDisconnectedError, CameraProtocolError
    """

    def __init__(self, sierra: Sierra, file_format: str) -> None:
        self._sierra = sierra
        self._format = file_format
        self._base_aperture: int | None = None
        self._old: dict[Register, int] = {}
        self._prepared = 0
        self.steadied: list[str] = []
        self.apertures = find_apertures(sierra)
        self.times_us = find_times_us(sierra)
        self.prepare()

    @property
    def are_prepared(self) -> bool:
        """True where the camera has not forgotten what was set: the session is still the same."""
        return self._prepared == self._sierra.sessions

    def prepare(self) -> None:
        """Set what must hold for all pictures, once a session.

        Raises:
            CameraError: it cannot be set to the file format
            CameraTimeoutError, CameraDisconnectedError, CameraProtocolError
        """
        if self.are_prepared:
            return
        session = self._sierra.sessions
        self.steadied.clear()
        self._keep(Register.SHUTTER_US)
        self._set_format()
        for rule in STEADYINGS:
            if self._keep(rule.register) in rule.unsteady:
                done = takes(self._sierra, rule.register, rule.steady)
                self.steadied.append(rule.note if done else f"not done: {rule.note}")
        aperture = self._keep(Register.APERTURE)
        if aperture == AUTOMATIC and self.apertures:
            widest = min(self.apertures)
            aperture = self.apertures[widest]
            self._apply(Register.APERTURE, aperture, "f_number", 0.0)
            self.steadied.append(f"its aperture is fixed at f/{widest:g}")
        if self._base_aperture is None:
            self._base_aperture = aperture
        self._prepared = session

    def expose_for(self, setting: ExposureSetting) -> ExposureSetting:
        """Set time and aperture, and return what was read back.

        Raises:
            RefusedSettingError: the camera applied another shutter time or aperture
            CameraTimeoutError, CameraDisconnectedError, CameraProtocolError
        """
        time_us = round(setting.time_s * _MICRO)
        self._apply(Register.SHUTTER_US, time_us, "time_s", setting.time_s)
        number = setting.f_number
        code = self._base_aperture if number is None else self.apertures[number]
        if code is not None and told(self._sierra, Register.APERTURE) != code:
            wanted = self._meaning(Register.APERTURE, code)
            self._apply(Register.APERTURE, code, "f_number", wanted)
        return ExposureSetting(time_us / _MICRO, 1.0, number)

    def restore(self) -> None:
        """Set everything as it was found."""
        for register, value in self._old.items():
            takes(self._sierra, register, value)

    def _keep(self, register: Register) -> int | None:
        """Return a register, and remember its first value for giving it back."""
        value = told(self._sierra, register)
        if value is not None:
            self._old.setdefault(register, value)
        return value

    def _set_format(self) -> None:
        wanted = FORMATS[self._format]
        if self._keep(Register.RESOLUTION) in wanted.codes:
            return
        if not takes(self._sierra, Register.RESOLUTION, wanted.default):
            raise CameraError(
                f"the camera at {self._sierra.link.url} cannot be set to {self._format}",
                hint="choose the quality with its own menu (HI is tiff), or another -O format",
            )

    def _apply(self, register: Register, value: int, control: str, wanted: float) -> None:
        for _ in range(_ATTEMPTS):
            session = self._sierra.sessions
            self._sierra.set(register, value)
            found = self._sierra.get(register)
            if found == value:
                return
            if session == self._sierra.sessions:
                break  # otherwise it forgot between writing and reading
        raise RefusedSettingError(control, wanted, self._meaning(register, found))

    def _meaning(self, register: Register, value: int) -> float:
        """Return a register's value in SI units; 0 for what is automatic or unknown."""
        if register is Register.SHUTTER_US:
            return value / _MICRO
        return next((number for number, code in self.apertures.items() if code == value), 0.0)
