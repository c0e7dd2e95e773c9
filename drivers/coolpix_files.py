"""What the files of a CoolPix are, known before the first frame: from its profile or from one."""

from __future__ import annotations

from camctl.camera import CameraInfo, Layout
from camctl.errors import DataError, StorageError
from camctl.profile import StillRecord, change_profile, load_profile
from drivers.coolpix_settings import FORMATS
from drivers.stillfile import Still

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
