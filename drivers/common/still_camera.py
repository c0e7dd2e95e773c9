"""What drivers of still cameras share: records in the profile, times in their files."""

from __future__ import annotations

import io
import math
import struct
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from statistics import median

from camctl.camera import CameraInfo
from camctl.clock import CaptureTiming
from camctl.errors import DataError, StorageError
from camctl.library_output import quiet_libraries
from camctl.profile import Profile, StillRecord, TimingRecord, change_profile, load_profile

#: Exposures and files whose median times are kept, and by which share of the whole these may
#: change until the profile is written again.
_MEASURED = 16
_SAME_TIME = 0.02

# Tags of EXIF 2.3, section 4.6, with their names in the EXIF directory.
_EXPOSURE_TIME = (33434, "ExposureTime")
_F_NUMBER = (33437, "FNumber")
_ISO = (34855, "ISOSpeedRatings")  # so tifffile names it, as EXIF 2.2 did
# The same as logarithms (APEX, EXIF 2.3, annex C): t = 2^-Tv, N = 2^(Av / 2).
_SHUTTER_SPEED, _APERTURE = (37377, "ShutterSpeedValue"), (37378, "ApertureValue")
_MAKE, _MODEL = (271, "Make"), (272, "Model")
_SERIAL = (42033, "BodySerialNumber")
_DATE, _OFFSET = (36867, "DateTimeOriginal"), (36881, "OffsetTimeOriginal")
_ORIENTATION = 274
_QUARTER_TURNS = {1: 0, 3: 2, 6: 3, 8: 1}  # mirrored pictures are no camera's
_CHANGED = 306  # when the file was made, where it does not say when the picture was taken
_EXIF_IFD = "ExifTag"
_LARGEST_APEX = 24.0  # 1/16,000,000 s, or 194 days
_LARGEST_ISO = 65535  # of the tag; it stands for higher ones, too
_APP1, _START_OF_SCAN = 0xE1, 0xDA


def save_record(info: CameraInfo, file_format: str, record: StillRecord) -> str | None:
    """Save what is known of a camera's files in its profile; return a note if that fails."""
    try:
        change_profile(info, lambda profile: profile.stills.update({file_format: record}))
    except (DataError, StorageError) as error:
        return f"the format of its files could not be saved in its profile: {error.what}"
    return None


def forget_record(info: CameraInfo, file_format: str) -> None:
    """Remove a format from what is known of a camera's files, if its profile can be changed."""

    def remove(profile: Profile) -> None:
        profile.stills.pop(file_format, None)

    with suppress(DataError, StorageError):
        change_profile(info, remove)


class StillTimes:
    """Measures what a still camera needs beside its exposures, and keeps it in its profile.

    Args:
        info: the camera
        file_format: of its frames
    """

    def __init__(self, info: CameraInfo, file_format: str) -> None:
        self._info, self._format = info, file_format
        self._exposures: deque[tuple[float, float]] = deque(maxlen=_MEASURED)
        self._downloads: deque[float] = deque(maxlen=_MEASURED)
        self._saved: TimingRecord | None = None
        with suppress(DataError):
            self._saved = load_profile(info).timings.get(file_format)

    @property
    def timing(self) -> CaptureTiming | None:
        """The times of the profile; None where none were measured."""
        return None if self._saved is None else self._saved.timing

    def add_exposure(self, settling_s: float, readout_s: float) -> None:
        """Add what one exposure took before it began, and after it ended."""
        self._exposures.append((max(settling_s, 0.0), max(readout_s, 0.0)))

    def add_download(self, download_s: float) -> None:
        """Add how long one file took to be transferred and decoded."""
        self._downloads.append(download_s)

    def save(self, *, overlaps: bool) -> None:
        """Keep the medians of what was added in the profile, where they differ from it."""
        if not (self._exposures and self._downloads):
            return
        settling_s, readout_s = (median(values) for values in zip(*self._exposures, strict=True))
        found = TimingRecord(
            settling_s=settling_s,
            readout_s=readout_s,
            download_s=median(self._downloads),
            overlaps=overlaps,
        )
        if self._saved is not None and _are_near(found, self._saved):
            return
        self._saved = found
        with suppress(DataError, StorageError):  # it is measured again with the next frames
            change_profile(
                self._info, lambda profile: profile.timings.update({self._format: found})
            )


def _are_near(a: TimingRecord, b: TimingRecord) -> bool:
    differences = (
        a.settling_s - b.settling_s,
        a.readout_s - b.readout_s,
        a.download_s - b.download_s,
    )
    whole = b.settling_s + b.readout_s + b.download_s
    return a.overlaps == b.overlaps and max(map(abs, differences)) <= _SAME_TIME * whole


@dataclass(frozen=True)
class StatedExposure:
    """The exposure that a file states; None or "" where it does not.

    Attributes:
        time_s: exposure time
        gain: sensitivity, 1 for ISO 100
        f_number: of the lens
        make, model, serial: of the camera
        taken_at: when the picture was taken; in the local zone where the file states none
        quarter_turns: by which it must be turned anticlockwise to be upright, 0 to 3
    """

    time_s: float | None = None
    gain: float | None = None
    f_number: float | None = None
    make: str = ""
    model: str = ""
    serial: str = ""
    taken_at: datetime | None = None
    quarter_turns: int = 0


def stated_exposure(data: bytes) -> StatedExposure:
    """Return the exposure in the tags of a file (EXIF 2.3, sections 4.6.4 and 4.6.5).

    Args:
        data: a whole JPEG or TIFF file, or any other bytes
    """
    import tifffile

    tags = _exif_of_jpeg(data) if data.startswith(b"\xff\xd8") else data
    if tags is None:
        return StatedExposure()
    try:
        with quiet_libraries(), tifffile.TiffFile(io.BytesIO(tags)) as file:
            top = file.pages.first.tags
            exif = top[_EXIF_IFD].value if _EXIF_IFD in top else {}
            make, model, serial, date, offset = (
                _text(top[tag].value if tag in top else exif.get(name))
                for tag, name in (_MAKE, _MODEL, _SERIAL, _DATE, _OFFSET)
            )
            turns = _QUARTER_TURNS.get(top[_ORIENTATION].value if _ORIENTATION in top else 1, 0)
            date = date or _text(top[_CHANGED].value if _CHANGED in top else None)
            time_s, f_number, iso, speed, aperture = (
                _number(top[tag].value if tag in top else exif.get(name))
                for tag, name in (_EXPOSURE_TIME, _F_NUMBER, _ISO, _SHUTTER_SPEED, _APERTURE)
            )
    except Exception:  # a damaged tag can cause any error in tifffile
        return StatedExposure()
    gain = iso / 100 if iso is not None and 0 < iso < _LARGEST_ISO else None
    time_s = _positive(time_s) or _from_apex(speed, -1.0)
    f_number = _positive(f_number) or _from_apex(aperture, 0.5)
    return StatedExposure(time_s, gain, f_number, make, model, serial, _date(date, offset), turns)


def exposure_time_s(data: bytes) -> float | None:
    """Return the exposure time that a file states, s; None if it is missing or invalid."""
    return stated_exposure(data).time_s


def _text(value: object) -> str:
    return value.strip("\0 ") if isinstance(value, str) else ""


def _date(date: str, offset: str) -> datetime | None:
    """Return the time that EXIF states as "2026:11:22 08:30:00" and "+01:00"; None: it is none."""
    for text, form in ((date + offset, "%Y:%m:%d %H:%M:%S%z"), (date, "%Y:%m:%d %H:%M:%S")):
        with suppress(ValueError, OverflowError, OSError):  # the last two: years without a zone
            return datetime.strptime(text, form).astimezone()
    return None


def _positive(value: float | None) -> float | None:
    return value if value is not None and value > 0 else None


def _from_apex(value: float | None, power: float) -> float | None:
    """Return 2 to the power of a logarithm times `power`; None where it cannot be one."""
    return None if value is None or abs(value) > _LARGEST_APEX else math.exp2(power * value)


def _number(value: object) -> float | None:
    """Return a finite number: an integer, or a fraction of two; None for others."""
    try:
        if isinstance(value, tuple):
            value = value[0] / value[1] if len(value) == 2 else value[0]
        number = float(value)  # type: ignore[arg-type]  # other types raise TypeError
    except (TypeError, ValueError, ZeroDivisionError, IndexError):
        return None
    return number if math.isfinite(number) else None


def _exif_of_jpeg(data: bytes) -> bytes | None:
    """Return the EXIF data of application segment 1, which has the structure of a TIFF file."""
    at = 2
    while at + 4 <= len(data) and data[at] == 0xFF and data[at + 1] != _START_OF_SCAN:
        (length,) = struct.unpack_from(">H", data, at + 2)
        if data[at + 1] == _APP1 and data[at + 4 : at + 10] == b"Exif\0\0":
            return data[at + 10 : at + 2 + length]
        at += 2 + max(length, 2)
    return None
