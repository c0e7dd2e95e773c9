"""Settings of a CoolPix 990: tables of registers, and finding the values that it accepts.

The values that the real camera accepts are not documented.  Those of the similar CoolPix 880 are
(libgphoto2's description of that camera), and there are standard scales of shutter times; each
value is written, and offered if it is read back unchanged.
"""

from __future__ import annotations

from dataclasses import dataclass

from camctl.drivers.coolpix.sierra.packets import RefusedCommandError, Register
from camctl.drivers.coolpix.sierra.session import Sierra
from camctl.errors import CameraError, RefusedSettingError
from camctl.interface.controls import ExposureSetting

# Value of the aperture register for automatic exposure.
_AUTOMATIC = 0
# A setting is written again once if the session ended between writing and reading it.
_ATTEMPTS = 2

# Nominal times: 1/n s, then s, in third and half stops, and the times of the CoolPix 880.
_DENOMINATORS = (
    *(1000, 800, 750, 640, 500, 400, 350, 320, 250, 200, 180, 160, 125, 100, 90, 80, 60, 50, 45),
    *(40, 30, 25, 20, 15, 13, 10, 8, 6, 5, 4, 3, 2.5, 2, 1.6, 1.5, 1.3),
)
_SECONDS = (1, 1.3, 1.5, 1.6, 2, 2.5, 3, 3.2, 4, 5, 6, 7, 8)

#: Shutter times to try, us, ascending; 1/n s is rounded down, as in the CoolPix 880.
CANDIDATES_US: tuple[int, ...] = tuple(
    sorted(
        {int(1e6 / denominator) for denominator in _DENOMINATORS}
        | {round(1e6 * seconds) for seconds in _SECONDS}
    )
)


# The lens is marked 1:2.5-4 and closes in ten settings a third of a stop apart.  These f-numbers
# hold at the wide end of the zoom; at the long end they are 1.6 times as large.  Descriptions of
# the protocol give different register values for "high".
_APERTURE_CODES = {2.5: (1,), 4.0: (2,), 7.0: (3, 4)}


@dataclass(frozen=True)
class FileFormat:
    """A file format of the camera.

    Attributes:
        codes: values of the resolution and quality register for this format (CoolPix 880)
        default: the value to set if the camera is set to another format: all pixels, best quality
        suffixes: of file names
        magic: first bytes of a file
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
class AutomaticSetting:
    """A setting that the camera may change from picture to picture.

    Attributes:
        register: its register
        automatic: values with which the camera decides for each picture
        fixed: the value to set instead
        name: of the setting, in notes
        state: of the fixed value, in notes
    """

    register: Register
    automatic: tuple[int, ...]
    fixed: int
    name: str
    state: str


AUTOMATIC_SETTINGS = (
    AutomaticSetting(Register.FLASH, (0, 1, 3, 4), 2, "flash", "off"),
    AutomaticSetting(Register.WHITE_BALANCE, (0,), 1, "white balance", "sunlight"),
    AutomaticSetting(Register.ADJUSTMENT, (5,), 0, "image adjustment", "normal"),
)


def accepts(sierra: Sierra, register: Register, value: int) -> bool:
    """Write a register; return whether the camera accepts the value and reads it back unchanged."""
    try:
        sierra.set(register, value)
        return sierra.get(register) == value
    except RefusedCommandError:
        return False


def read_register_or_none(sierra: Sierra, register: Register) -> int | None:
    """Return a register; None if the camera refuses to report it."""
    try:
        return sierra.get(register)
    except RefusedCommandError:
        return None


def find_times_us(sierra: Sierra) -> tuple[int, ...]:
    """Return the shutter times that the camera accepts, us, ascending; restores the current one.

    Raises:
        CameraError: it accepts none
    """
    before = read_register_or_none(sierra, Register.SHUTTER_US)
    times = tuple(us for us in CANDIDATES_US if accepts(sierra, Register.SHUTTER_US, us))
    if before is not None:
        sierra.set(Register.SHUTTER_US, before)
    if not times:
        raise CameraError(
            f"the camera at {sierra.link.url} accepts no shutter time",
            hint="turn its dial to M (manual recording), then try again",
        )
    return times


def find_apertures(sierra: Sierra) -> dict[float, int]:
    """Return the register values of the apertures that the camera accepts, by f-number."""
    before = read_register_or_none(sierra, Register.APERTURE)
    if before is None:
        return {}
    found = {}
    for f_number, codes in _APERTURE_CODES.items():
        for code in codes:
            if accepts(sierra, Register.APERTURE, code):
                found[f_number] = code
                break
    sierra.set(Register.APERTURE, before)
    return found


class CoolpixDials:
    """The settings of the camera.

    Args:
        sierra: an open session
        file_format: a name in `FORMATS`

    Attributes:
        apertures: register values of the apertures that the camera accepts, by f-number
        times_us: shutter times that it accepts, us, ascending
        notes: what was set for the whole sequence, one line each

    Raises:
        CameraError: it accepts no shutter time, or cannot be set to the file format
    """

    def __init__(self, sierra: Sierra, file_format: str) -> None:
        self._sierra = sierra
        self._format = file_format
        self._base_aperture: int | None = None
        self._old: dict[Register, int] = {}
        self._prepared_session = 0
        self.notes: list[str] = []
        self.apertures = find_apertures(sierra)
        self.times_us = find_times_us(sierra)
        self.prepare()

    @property
    def are_prepared(self) -> bool:
        """True if `prepare` was done in this session; a new one may have lost the settings."""
        return self._prepared_session == self._sierra.sessions

    def prepare(self) -> None:
        """Set what holds for all pictures, once in each session.

        Raises:
            CameraError: it cannot be set to the file format
        """
        if self.are_prepared:
            return
        session = self._sierra.sessions
        self.notes.clear()
        self._save(Register.SHUTTER_US)
        self._set_format()
        for each in AUTOMATIC_SETTINGS:
            if self._save(each.register) in each.automatic:
                is_set = accepts(self._sierra, each.register, each.fixed)
                verb = "is" if is_set else "could not be"
                self.notes.append(f"its {each.name} {verb} set to {each.state}")
        aperture = self._save(Register.APERTURE)
        if aperture == _AUTOMATIC and self.apertures:
            widest = min(self.apertures)
            aperture = self.apertures[widest]
            self._apply(Register.APERTURE, aperture, "f_number", 0.0)
            self.notes.append(f"its aperture is set to f/{widest:g}")
        if self._base_aperture is None:
            self._base_aperture = aperture
        self._prepared_session = session

    def set_exposure(self, setting: ExposureSetting) -> ExposureSetting:
        """Set shutter time and aperture; return the setting read back.

        Raises:
            RefusedSettingError: the camera applied another shutter time or aperture
        """
        time_us = round(setting.time_s * 1e6)
        self._apply(Register.SHUTTER_US, time_us, "time_s", setting.time_s)
        number = setting.f_number
        code = self._base_aperture if number is None else self.apertures[number]
        if code is not None and read_register_or_none(self._sierra, Register.APERTURE) != code:
            f_number = self._si_value(Register.APERTURE, code)
            self._apply(Register.APERTURE, code, "f_number", f_number)
        return ExposureSetting(time_us / 1e6, 1.0, number)

    def restore(self) -> None:
        """Restore the settings that the camera had before."""
        for register, value in self._old.items():
            accepts(self._sierra, register, value)

    def _save(self, register: Register) -> int | None:
        """Return a register, and keep its first value for `restore`."""
        value = read_register_or_none(self._sierra, register)
        if value is not None:
            self._old.setdefault(register, value)
        return value

    def _set_format(self) -> None:
        file_format = FORMATS[self._format]
        if self._save(Register.RESOLUTION) in file_format.codes:
            return
        if not accepts(self._sierra, Register.RESOLUTION, file_format.default):
            raise CameraError(
                f"the camera at {self._sierra.link.url} cannot be set to {self._format}",
                hint="choose the quality with its own menu (HI is tiff), or another format",
                remedies={"option:format": None},
            )

    def _apply(self, register: Register, value: int, control: str, requested: float) -> None:
        for _ in range(_ATTEMPTS):
            session = self._sierra.sessions
            self._sierra.set(register, value)
            found = self._sierra.get(register)
            if found == value:
                return
            if session == self._sierra.sessions:
                break  # else the value was lost with the session, between writing and reading
        raise RefusedSettingError(control, requested, self._si_value(register, found))

    def _si_value(self, register: Register, value: int) -> float:
        """Return a register's value in SI units; 0 if it is automatic or unknown."""
        if register is Register.SHUTTER_US:
            return value / 1e6
        return next((number for number, code in self.apertures.items() if code == value), 0.0)
