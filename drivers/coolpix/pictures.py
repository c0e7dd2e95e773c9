"""Pictures on the card of a CoolPix: found and downloaded."""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import dataclass

from camctl.drivers.coolpix.settings import read_register_or_none
from camctl.drivers.coolpix.sierra.packets import RefusedCommandError, Register
from camctl.drivers.coolpix.sierra.session import Sierra
from camctl.errors import CameraError, CameraProtocolError
from camctl.interface.clock import Clock
from camctl.stills.decoding import Still, read_still

# Above any file of this camera, whose TIFF has 9.4 MB.
_MAX_PICTURE_BYTES = 1 << 26
_DOWNLOAD_ATTEMPTS = 3
# Pause between two requests for the number of pictures.
_POLL_S = 0.05
# Value of the register CARD, and charge below which the battery explains a missing picture.
_NO_CARD = 1
_LOW_BATTERY_PERCENT = 5


@dataclass(frozen=True)
class CardPicture:
    """A picture on the card: its number in its folder, from 1 (0: there is none), and its name."""

    number: int
    name: str

    @property
    def label(self) -> str:
        """The name, or else the number, in messages."""
        return self.name or f"picture {self.number}"


def newest_picture(sierra: Sierra) -> CardPicture:
    """Return the newest picture, in whatever folder it is.

    It is read from register 4, set to 0, and register 79; register 10 counts the pictures of one
    folder, and a camera puts a picture into another one when that is full.
    """
    number = sierra.get(Register.PICTURE, picture=0)
    try:
        return CardPicture(number, sierra.text(Register.PICTURE_NAME, picture=0))
    except RefusedCommandError:
        return CardPicture(number, "")


def is_next(later: CardPicture, earlier: CardPicture) -> bool:
    """Return whether `later` is the one picture taken since `earlier` was the newest.

    When a folder is full, the camera counts from 1 again in another one; its names continue.
    """
    if later.name == earlier.name and (later.name or later.number == earlier.number):
        return False
    if earlier == CardPicture(0, "") and later.name:
        return True  # the first one on the card, whose number may still be read as 0
    restarts = 1 == later.number < earlier.number
    return later.number == earlier.number + 1 or restarts or _follows(later.name, earlier.name)


def _follows(later: str, earlier: str) -> bool:
    """Return whether the number in a name is the next one: DSCN0101.JPG after DSCN0100.JPG."""
    numbers = [re.search(r"(\d+)\.\w+$", name) for name in (later, earlier)]
    if numbers[0] is None or numbers[1] is None:
        return False
    width = len(numbers[0][1])
    return bool(int(numbers[0][1]) == (int(numbers[1][1]) + 1) % 10**width)


def wait_for_picture(
    sierra: Sierra, before: CardPicture, clock: Clock, wait_s: float
) -> CardPicture | None:
    """Return the next picture after `before`; None if there is none after `wait_s`."""
    deadline_s = clock.now() + wait_s
    while True:
        # A camera that is still writing to its card may refuse to answer.
        with suppress(RefusedCommandError):
            picture = newest_picture(sierra)
            if is_next(picture, before):
                return picture
        if clock.now() >= deadline_s:
            return None
        clock.sleep_until(clock.now() + _POLL_S)


def download(sierra: Sierra, picture: CardPicture) -> tuple[bytes, Still]:
    """Return the file of a picture and its contents; repeated if the file is incomplete.

    Raises:
        CameraProtocolError: it is incomplete or damaged each time
        UsageError: the package that reads its format is not installed
        CameraTimeoutError, CameraDisconnectedError
    """
    for attempt in range(_DOWNLOAD_ATTEMPTS):
        try:
            data = _file_of(sierra, picture)
            return data, read_still(data, picture.name)
        except CameraProtocolError:
            if attempt == _DOWNLOAD_ATTEMPTS - 1:
                raise
    raise AssertionError("unreachable")


def _file_of(sierra: Sierra, picture: CardPicture) -> bytes:
    size = sierra.get(Register.PICTURE_BYTES, picture=picture.number)
    if not 0 < size <= _MAX_PICTURE_BYTES:
        raise _transfer_error(sierra, f"stated an invalid size of {size} bytes for {picture.label}")
    data = sierra.read(Register.PICTURE_DATA, size, picture=picture.number)
    if len(data) != size:
        raise _transfer_error(sierra, f"sent {len(data)} of {size} bytes of {picture.label}")
    return data


def _transfer_error(sierra: Sierra, what: str) -> CameraProtocolError:
    return CameraProtocolError(
        f"the camera at {sierra.link.url} {what}",
        hint="try a lower speed",
        remedies={"option:speed": 19200},
    )


def no_picture_error(sierra: Sierra) -> CameraError:
    """Return the error for a picture that was not taken, with the reason in its registers."""
    name = f"the camera at {sierra.link.url}"
    battery = read_register_or_none(sierra, Register.BATTERY_PERCENT)
    if read_register_or_none(sierra, Register.CARD) == _NO_CARD:
        return CameraError(f"{name} has no card in it", hint="put one in, then resume")
    if read_register_or_none(sierra, Register.PICTURES_LEFT) == 0:
        return CameraError(
            f"the card of {name} is full", hint="make room on it or put another in, then resume"
        )
    if battery is not None and 0 < battery < _LOW_BATTERY_PERCENT:  # 0: unknown
        return CameraError(
            f"the battery of {name} is low ({battery} %)",
            hint="charge it or use a mains adapter, then resume",
        )
    return CameraError(
        f"{name} took no picture",
        hint="look at its display: lens cap on, lens blocked, or its dial not at M; then resume",
    )
