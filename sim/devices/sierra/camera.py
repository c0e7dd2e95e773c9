"""The virtual CoolPix 990 without its line: values and effects of its registers and actions."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from typing import Any

from camctl.sim.devices.sierra.config import (
    APERTURES,
    AUTOMATIC_US,
    CARD_PRESENT,
    CHARGE,
    FOLDER_PATH,
    LOW_CHARGE,
    QUALITIES,
    QUALITY_OF,
    STORED,
    Action,
    Register,
    SierraConfig,
)
from camctl.sim.devices.still_body import CARD_BYTES, Exposure, ImageFile, StillBody

_TEXTS = {
    Register.CAMERA_ID: "E990V1.1",
    Register.VERSION: "v990-110",
    Register.MODEL: "E990",
    Register.MAKE: "NIKON",
}


class RefusedError(Exception):
    """The camera refuses a command: INVALID on the line."""


class SierraCamera:
    """Registers and actions.

    Args:
        body: shutter and sensor
        config: options of the camera

    Attributes:
        pictures: on the card, oldest first
        downloading: the picture that is being sent
    """

    def __init__(self, body: StillBody, config: SierraConfig) -> None:
        self.body = body
        self.pictures: list[ImageFile] = []
        self.downloading: ImageFile | None = None
        self._config = config
        self._times_us = tuple(sorted(config.times_us))
        self._quality = QUALITY_OF[config.files[0]]
        self._shutter_us = AUTOMATIC_US
        self._is_automatic = True
        self._aperture = 0
        self._selected = 0  # number of a picture; 0 is the newest
        self._stored = dict(STORED)
        self._folder: tuple[str, ...] = FOLDER_PATH
        self._listed_folder = 0  # number of the subfolder whose name register 84 gives; 0: none

    # Registers.

    def read(self, number: int) -> int:
        """Return the value of a numeric register (RefusedError: there is none)."""
        readers: dict[int, Callable[[], int]] = {
            Register.QUALITY: lambda: self._quality,
            Register.SHUTTER: lambda: 0 if self._is_automatic else self._shutter_us,
            Register.PICTURE: lambda: self._selected or len(self._newest_folder),
            Register.APERTURE: lambda: self._aperture,
            Register.TAKEN: lambda: self._opened_count,
            Register.LEFT: lambda: self._free_bytes // self.body.largest_file,
            Register.SIZE: lambda: len(self._selected_picture().data),
            Register.BATTERY: lambda: LOW_CHARGE if self.body.faults.is_battery_low else CHARGE,
            Register.MEMORY_LEFT: lambda: self._free_bytes,
            Register.LOCKED: lambda: 0,
            Register.CARD: lambda: CARD_PRESENT,
            Register.FOLDERS: lambda: len(self._folder) < len(FOLDER_PATH),
        }
        if number in readers:
            return int(readers[number]())
        if number in self._stored:
            return self._stored[number]
        raise RefusedError

    def write(self, number: int, value: int | None) -> None:
        """Set a numeric register; `value` is None if the host sent none.

        Raises:
            RefusedError: no such register, no value, or a value that the register does not accept
        """
        if number == Register.FOLDERS:
            self._listed_folder = value or 0
            return
        if value is None:
            raise RefusedError
        if number == Register.QUALITY:
            if value not in QUALITIES or QUALITIES[value][0] not in self._config.files:
                raise RefusedError
            self._quality = value
        elif number == Register.SHUTTER:
            self._set_shutter(value)
        elif number == Register.APERTURE:
            if value and value not in APERTURES:
                raise RefusedError
            self._aperture = value
        elif number == Register.PICTURE:
            self._selected = value
        elif number in self._stored:
            self._stored[number] = value
        else:
            raise RefusedError

    def read_text(self, number: int) -> bytes:
        """Return a text, a file or a record from a register (RefusedError: there is none)."""
        if number == Register.IMAGE:
            self.downloading = self._selected_picture()
            return self.downloading.data
        if number == Register.PICTURE_INFO:
            return self._info(self._selected_picture())
        # Names end with a NUL, which libgphoto2 requires.
        return self._name(number).encode("ascii") + b"\0"

    def write_text(self, number: int, text: bytes) -> None:
        r"""Change the folder: "\" is the root (RefusedError: no such folder or register)."""
        if number != Register.FOLDER:
            raise RefusedError
        name = text.rstrip(b"\0 ").decode("ascii", "replace")
        depth = len(self._folder)
        if name == "\\":
            self._folder = ()
        elif name == "..":
            self._folder = self._folder[:-1]
        elif depth < len(FOLDER_PATH) and name == FOLDER_PATH[depth]:
            self._folder = FOLDER_PATH[: depth + 1]
        else:
            raise RefusedError

    # Actions.

    def act(self, number: int) -> None:
        """Execute an action other than a capture (RefusedError: no such action)."""
        if number == Action.DELETE_ALL:
            self.pictures.clear()
        elif number == Action.DELETE:
            self.pictures.remove(self._selected_picture())
        elif number not in (Action.END, Action.SCREEN):
            raise RefusedError

    def check_ready(self) -> None:
        """Raise RefusedError where the card is full or the battery is low."""
        if self.body.faults.is_battery_low or self._free_bytes < self.body.largest_file:
            raise RefusedError

    def capture(self, done: Callable[[], None]) -> None:
        """Take a picture; `done` is called when it is on the card."""
        form, quality = QUALITIES[self._quality]

        def store(files: Sequence[ImageFile]) -> None:
            self.pictures.extend(files)
            self._selected = 0
            done()

        f_number = APERTURES[self._aperture or 1]
        light = (APERTURES[1] / f_number) ** 2
        time_s = self._shutter_us / 1e6
        self.body.release(Exposure(time_s, 1.0, light, (form,), quality), store)

    def downloaded(self) -> None:
        """Record that the host has acknowledged all of the last answer."""
        if self.downloading is not None:
            self.body.note_download(self.downloading.name)
            self.downloading = None

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
        return max(0, CARD_BYTES - sum(len(file.data) for file in self.pictures))

    def _set_shutter(self, value: int) -> None:
        """Set the nearest shutter time that the camera has; the register then holds it."""
        self._is_automatic = value == 0
        if self._is_automatic:
            self._shutter_us = AUTOMATIC_US
            return
        limit_s = self.body.faults.longest_s
        if limit_s is not None and value > limit_s * 1e6:
            value = max(1, int(limit_s * 1e6))
        self._shutter_us = min(self._times_us, key=lambda time_us: abs(math.log(time_us / value)))

    def _selected_picture(self) -> ImageFile:
        folder = self._newest_folder
        number = self._selected or len(folder)
        if not 1 <= number <= len(folder):
            raise RefusedError
        return folder[number - 1]

    @property
    def _newest_folder(self) -> Sequence[ImageFile]:
        """The pictures in the folder of the newest one."""
        limit = self._config.folder_pictures
        first = max(len(self.pictures) - 1, 0) // limit * limit if limit else 0
        return self.pictures[first:]

    @property
    def _opened_count(self) -> int:
        """The number of pictures in the folder that the host has opened: the first one, or none."""
        if self._folder != FOLDER_PATH:
            return 0
        return min(len(self.pictures), self._config.folder_pictures or len(self.pictures))

    def _info(self, picture: ImageFile) -> bytes:
        """Return sizes of file, thumbnail and sound, quality, lock, date, and two zeros."""
        quality = QUALITY_OF[picture.format]
        return struct.pack("<8I", len(picture.data), 0, 0, quality, 0, STORED[2], 0, 0)

    def _name(self, number: int) -> str:
        if number == Register.FILE_NAME:
            return self._selected_picture().name
        if number == Register.SERIAL:
            return self._config.serial
        if number == Register.FOLDER:
            return self._folder_name()
        if number in _TEXTS:
            return _TEXTS[Register(number)]
        raise RefusedError

    def _folder_name(self) -> str:
        """Return the subfolder that register 83 selected, else the current folder."""
        if self._listed_folder and len(self._folder) < len(FOLDER_PATH):
            return FOLDER_PATH[len(self._folder)]
        return self._folder[-1] if self._folder else "\\"
