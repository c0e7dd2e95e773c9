"""What the files of a CoolPix are, known before the first frame: from its profile or from one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from camctl.camera import CameraInfo
from camctl.clock import Clock
from camctl.controls import Layout
from camctl.errors import CameraError, CameraProtocolError, DataError, StorageError
from camctl.profile import StillRecord, change_profile, load_profile
from drivers.common.still_file import Still, read_still
from drivers.coolpix.settings import FORMATS, told
from drivers.coolpix.sierra.packets import RefusedCommandError, Register
from drivers.coolpix.sierra.session import Sierra

_BITS_A_BYTE = 10  # on the line: with start and stop bit


class KnownFiles:
    """What the files of one camera are in one format; `record` is None until that is known."""

    def __init__(self, info: CameraInfo, file_format: str) -> None:
        self.notes: list[str] = []
        self._info = info
        self._format = file_format
        try:
            self.record = load_profile(info).stills.get(file_format)
        except DataError as error:
            self.record = None
            self.notes.append(str(error))

    def learn(self, still: Still) -> StillRecord:
        """Take from a file what files are, keep it in the profile if it is news, and return it."""
        record = still.record
        if record == self.record:
            return record
        self.record = record
        try:
            change_profile(
                self._info, lambda profile: profile.stills.update({self._format: record})
            )
        except (DataError, StorageError) as error:
            self.notes.append(f"what its files are could not be kept: {error.what}")
        return record

    def note_of_line(self, speed: int) -> str:
        """Return what a person should know of the time that a file takes, at `speed` baud."""
        size = FORMATS[self._format].typical_bytes
        if self.record is not None and self._format == "tiff":
            channels = 3 if self.record.layout is Layout.RGB else 1
            size = self.record.rows * self.record.columns * channels
        seconds = size * _BITS_A_BYTE / speed
        time = f"{seconds / 60:.2g} minutes" if seconds >= 60 else f"{seconds:.2g} s"
        return (
            f"a picture ({self._format}, about {size / 1e6:.2g} MB) takes {time} over the line at "
            f"{speed} baud, and the next exposure begins when it has come"
        )


MAX_PICTURE_BYTES = 1 << 26
_ATTEMPTS = 3
_POLL_S = 0.05
_NO_CARD = 1
_LOW_PERCENT = 5

Progress = Callable[[str, int, int], None]
"""Takes a picture's name, the bytes that have come, and the bytes there are."""


@dataclass(frozen=True)
class OnCard:
    """A picture on the card: its number, from 1 (0: there is none), and its name if it has one."""

    number: int
    name: str


def newest(sierra: Sierra) -> OnCard:
    """Return the newest picture of the camera's folder, the one of the highest number."""
    number = sierra.get(Register.PICTURES)
    if number == 0:
        return OnCard(0, "")
    try:
        return OnCard(number, sierra.text(Register.PICTURE_NAME, picture=number))
    except RefusedCommandError:
        return OnCard(number, "")


def follows(later: OnCard, earlier: OnCard) -> bool:
    """Say whether `later` is the one picture that was taken since `earlier` was the newest.

    After the last picture that a folder holds, the camera counts from 1 again in another one.
    """
    is_another = later.name != earlier.name or not later.name
    is_next = later.number == earlier.number + 1
    return is_another and (is_next or 1 == later.number < earlier.number)


def wait_for_picture(sierra: Sierra, before: OnCard, clock: Clock, wait_s: float) -> OnCard | None:
    """Return the picture that comes after `before`; None where none has come after `wait_s`."""
    deadline_s = clock.now() + wait_s
    while True:
        # A camera that is still writing to its card may refuse to count.
        number = told(sierra, Register.PICTURES)
        if number is not None and number != before.number:
            picture = newest(sierra)
            if follows(picture, before):
                return picture
        if clock.now() >= deadline_s:
            return None
        clock.sleep_until(clock.now() + _POLL_S)


def download(sierra: Sierra, picture: OnCard, progress: Progress | None) -> tuple[bytes, Still]:
    """Return the file of a picture and what it holds, asked for again where that is not whole.

    Raises:
        CameraProtocolError: it comes short or damaged each time
        UsageError: it is a file of a kind that something is not installed for
        CameraTimeoutError, CameraDisconnectedError
    """
    for attempt in range(_ATTEMPTS):
        try:
            data = _whole(sierra, picture, progress)
            return data, read_still(data, picture.name)
        except CameraProtocolError:
            if attempt == _ATTEMPTS - 1:
                raise
    raise AssertionError("unreachable")


def _whole(sierra: Sierra, picture: OnCard, progress: Progress | None) -> bytes:
    size = sierra.get(Register.PICTURE_BYTES, picture=picture.number)
    who = picture.name or f"picture {picture.number}"
    if not 0 < size <= MAX_PICTURE_BYTES:
        raise _unusable(sierra, f"{who} is said to have {size} bytes")

    def tell(come: int) -> None:
        if progress is not None:
            progress(who, come, size)

    data = sierra.read(Register.PICTURE_DATA, size, picture=picture.number, progress=tell)
    if len(data) != size:
        raise _unusable(sierra, f"{who} came with {len(data)} bytes of {size}")
    return data


def _unusable(sierra: Sierra, what: str) -> CameraProtocolError:
    return CameraProtocolError(
        f"{what} over {sierra.link.url}", hint="try a lower speed, such as -O speed=19200"
    )


def why_no_picture(sierra: Sierra) -> CameraError:
    """Return why the camera took no picture, as far as its registers tell."""
    who = f"the camera at {sierra.link.url}"
    battery = told(sierra, Register.BATTERY_PERCENT)
    if told(sierra, Register.CARD) == _NO_CARD:
        return CameraError(f"{who} has no card in it", hint="put one in, then resume")
    if told(sierra, Register.PICTURES_LEFT) == 0:
        return CameraError(
            f"the card of {who} is full", hint="make room on it or put another in, then resume"
        )
    if battery is not None and 0 < battery < _LOW_PERCENT:  # 0: it does not know
        return CameraError(
            f"the battery of {who} is low ({battery} %)",
            hint="charge it or use a mains adapter, then resume",
        )
    return CameraError(
        f"{who} took no picture",
        hint="see its display: lens cap on, lens blocked, or its dial not at M; then resume",
    )
