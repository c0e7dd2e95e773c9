"""A Nikon CoolPix 990 behind its registers: what they say and what writing them does."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from typing import Any

from sim.devices.sierra.registers import (
    APERTURES,
    AUTOMATIC_US,
    CARD_THERE,
    CHARGE,
    FOLDER_PATH,
    KEPT,
    LOW_CHARGE,
    QUALITIES,
    QUALITY_OF,
    Action,
    Register,
)
from sim.devices.still_body import Exposure, Picture, StillBody

_US_PER_S = 1_000_000
_TEXTS = {
    Register.CAMERA_ID: "E990V1.1",
    Register.VERSION: "v990-110",
    Register.MODEL: "E990",
    Register.MAKE: "NIKON",
}


class Refused(Exception):  # noqa: N818 - not an error of ours: the camera says no
    """The camera does not do that: INVALID on the line."""


class SierraCamera:
    """Registers and actions.

    Args:
        body: shutter and sensor
        serial: serial number
        files: kinds that it can make
        times_us: shutter times
        card_bytes: what the card holds

    Attributes:
        pictures: on the card, oldest first
        asked_for: the picture that is being sent
    """

    def __init__(
        self,
        body: StillBody,
        serial: str,
        files: Sequence[str],
        times_us: Sequence[int],
        card_bytes: int,
    ) -> None:
        self.body = body
        self.pictures: list[Picture] = []
        self._serial = serial
        self._files = tuple(files)
        self._times_us = tuple(sorted(times_us))
        self._card_bytes = card_bytes
        self._quality = QUALITY_OF[files[0]]
        self._shutter_us = AUTOMATIC_US
        self._is_automatic = True
        self._aperture = 0
        self._current = 0  # picture; 0 is the newest
        self._kept = dict(KEPT)
        self._folder: tuple[str, ...] = FOLDER_PATH
        self._chosen_folder = 0
        self.asked_for: Picture | None = None

    # Registers.

    def read(self, number: int) -> int:
        """Return a register that is a number (Refused: there is none)."""
        readers: dict[int, Callable[[], int]] = {
            Register.QUALITY: lambda: self._quality,
            Register.SHUTTER: lambda: 0 if self._is_automatic else self._shutter_us,
            Register.PICTURE: lambda: self._current or len(self.pictures),
            Register.APERTURE: lambda: self._aperture,
            Register.TAKEN: lambda: len(self.pictures) * (self._folder == FOLDER_PATH),
            Register.LEFT: lambda: self._free_bytes // self.body.largest_file,
            Register.SIZE: lambda: len(self._picture().data),
            Register.THUMBNAIL_SIZE: lambda: len(self._picture().thumbnail),
            Register.BATTERY: lambda: LOW_CHARGE if self.body.faults.is_battery_low else CHARGE,
            Register.MEMORY_LEFT: lambda: self._free_bytes,
            Register.LOCKED: lambda: 0,
            Register.CARD: lambda: CARD_THERE,
            Register.FOLDERS: lambda: len(self._folder) < len(FOLDER_PATH),
        }
        if number in readers:
            return int(readers[number]())
        if number in self._kept:
            return self._kept[number]
        raise Refused

    def write(self, number: int, value: int | None) -> None:
        """Set a register that is a number; None where the host sent no value (Refused)."""
        if number == Register.FOLDERS:
            self._chosen_folder = value or 0
            return
        if value is None:
            raise Refused
        if number == Register.QUALITY:
            if value not in QUALITIES or QUALITIES[value][0] not in self._files:
                raise Refused
            self._quality = value
        elif number == Register.SHUTTER:
            self._set_shutter(value)
        elif number == Register.APERTURE:
            if value and value not in APERTURES:
                raise Refused
            self._aperture = value
        elif number == Register.PICTURE:
            self._current = value
        elif number in self._kept:
            self._kept[number] = value
        else:
            raise Refused

    def read_text(self, number: int) -> bytes:
        """Return a register that is a text or a file (Refused: there is none)."""
        if number == Register.IMAGE:
            self.asked_for = self._picture()
            return self.asked_for.data
        if number == Register.THUMBNAIL:
            return self._picture().thumbnail
        if number == Register.PICTURE_INFO:
            return self._info(self._picture())
        # Names end with a NUL, which libgphoto2 takes for granted.
        return self._name(number).encode("ascii") + b"\0"

    def write_text(self, number: int, text: bytes) -> None:
        r"""Change the folder: "\" is the top (Refused: no such folder or register)."""
        if number != Register.FOLDER:
            raise Refused
        name = text.rstrip(b"\0 ").decode("ascii", "replace")
        depth = len(self._folder)
        if name == "\\":
            self._folder = ()
        elif name == "..":
            self._folder = self._folder[:-1]
        elif depth < len(FOLDER_PATH) and name == FOLDER_PATH[depth]:
            self._folder = FOLDER_PATH[: depth + 1]
        else:
            raise Refused

    # Actions.

    def act(self, number: int) -> None:
        """Do what takes no time (Refused: no such action)."""
        if number == Action.DELETE_ALL:
            self.pictures.clear()
        elif number == Action.DELETE:
            self.pictures.remove(self._picture())
        elif number not in (Action.END, Action.SCREEN):
            raise Refused

    def check_ready(self) -> None:
        """Refuse to take a picture where the card is full or the battery low."""
        if self.body.faults.is_battery_low or self._free_bytes < self.body.largest_file:
            raise Refused

    def capture(self, done: Callable[[], None]) -> None:
        """Take a picture; `done` is called when it is on the card."""
        kind, quality = QUALITIES[self._quality]

        def store(pictures: Sequence[Picture]) -> None:
            self.pictures.extend(pictures)
            self._current = 0
            done()

        f_number = APERTURES[self._aperture or 1]
        light = (APERTURES[1] / f_number) ** 2
        time_s = self._shutter_us / _US_PER_S
        self.body.release(Exposure(time_s, 1.0, light, (kind,), quality), store)

    def downloaded(self) -> None:
        """Hear that what was asked for last has been taken to its end."""
        if self.asked_for is not None:
            self.body.note_download(self.asked_for.name)
            self.asked_for = None

    def state(self) -> dict[str, Any]:
        """Return the settings in force, ready for JSON."""
        return {
            "shutter_us": 0 if self._is_automatic else self._shutter_us,
            "aperture": self._aperture,
            "quality": self._quality,
            "pictures": len(self.pictures),
        }

    @property
    def _free_bytes(self) -> int:
        if self.body.faults.is_card_full:
            return 0
        return max(0, self._card_bytes - sum(len(picture.data) for picture in self.pictures))

    def _set_shutter(self, value: int) -> None:
        """Take the nearest time that there is: the register says afterwards which."""
        self._is_automatic = value == 0
        if self._is_automatic:
            self._shutter_us = AUTOMATIC_US
            return
        limit_s = self.body.faults.clamp_s
        if limit_s is not None and value > limit_s * _US_PER_S:
            value = max(1, int(limit_s * _US_PER_S))
        self._shutter_us = min(self._times_us, key=lambda time_us: abs(math.log(time_us / value)))

    def _picture(self) -> Picture:
        place = self._current or len(self.pictures)
        if not 1 <= place <= len(self.pictures):
            raise Refused
        return self.pictures[place - 1]

    def _info(self, picture: Picture) -> bytes:
        """Return sizes of file, thumbnail and sound, quality, lock, date and kind of film."""
        sizes = (len(picture.data), len(picture.thumbnail), 0)
        return struct.pack("<8I", *sizes, QUALITY_OF[picture.kind], 0, KEPT[2], 0, 0)

    def _name(self, number: int) -> str:
        if number == Register.FILE_NAME:
            return self._picture().name
        if number == Register.SERIAL:
            return self._serial
        if number == Register.FOLDER:
            return self._folder_name()
        if number in _TEXTS:
            return _TEXTS[Register(number)]
        raise Refused

    def _folder_name(self) -> str:
        """Return the name of the folder that register 83 chose, else of the one that is open."""
        if self._chosen_folder and len(self._folder) < len(FOLDER_PATH):
            return FOLDER_PATH[len(self._folder)]
        return self._folder[-1] if self._folder else "\\"
