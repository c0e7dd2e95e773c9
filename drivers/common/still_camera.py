"""What drivers of still cameras share: records in the profile."""

from __future__ import annotations

from collections import deque
from contextlib import suppress
from statistics import median

from camctl.errors import DataError, StorageError
from camctl.interface.camera import CameraInfo
from camctl.interface.clock import CaptureTiming
from camctl.profiles.profile import Profile, StillRecord, TimingRecord, change_profile, load_profile

#: Exposures and files whose median times are kept, and by which share of the whole these may
#: change until the profile is written again.
_MEASURED = 16
_SAME_TIME = 0.02


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
