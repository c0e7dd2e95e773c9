"""The settings of a CoolPix in force: for a whole sequence, for each exposure, and restored."""

from __future__ import annotations

from camctl.camera import ExposureSetting
from camctl.errors import CameraError, RefusedSettingError
from drivers.coolpix_settings import (
    AUTOMATIC,
    FORMATS,
    STEADYINGS,
    find_apertures,
    find_times_us,
    takes,
    told,
)
from drivers.sierra import Sierra
from drivers.sierra_packets import Register

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
