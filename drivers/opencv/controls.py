"""The exposure of a video that OpenCV has opened: what can be set, and what is read back."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

from camctl.drivers.opencv.video import Video
from camctl.errors import CameraError, RefusedSettingError, UsageError
from camctl.interface.controls import Choices, Control, ExposureSetting, Steps


@dataclass(frozen=True)
class ExposureUnit:
    """What CAP_PROP_EXPOSURE and CAP_PROP_AUTO_EXPOSURE mean in one of OpenCV's backends.

    Attributes:
        ticks_per_s: of a linear value; 0: the value is the binary logarithm of seconds
        manual: value of the automatic exposure that switches it off
    """

    ticks_per_s: float
    manual: float

    def time_s(self, value: float) -> float:
        """Return the exposure time of a value, s."""
        return value / self.ticks_per_s if self.ticks_per_s else math.exp2(value)

    def value(self, time_s: float) -> float:
        """Return the whole value nearest to an exposure time, s."""
        return float(round(time_s * self.ticks_per_s if self.ticks_per_s else math.log2(time_s)))


#: By `Video.backend`.  V4L2 counts 100 us; DirectShow and Media Foundation state log2 of seconds.
UNITS: Mapping[str, ExposureUnit] = {
    "V4L2": ExposureUnit(10_000, 1),
    "DSHOW": ExposureUnit(0, 0.25),
    "MSMF": ExposureUnit(0, 0.25),
}
#: Values that are written to learn where a camera's range ends: 100 us to 10 s.
_LOWEST_LINEAR, _HIGHEST_LINEAR = 1.0, 100_000.0
_LOWEST_LOGARITHM, _HIGHEST_LOGARITHM = -14, 3
#: Control, value that switches it off, and its name.
_AUTOMATICS = (
    ("AUTO_WB", 0.0, "automatic white balance"),
    ("BACKLIGHT", 0.0, "backlight compensation"),
)


class PropertyExposure:
    """The exposure of a webcam, through OpenCV's property.

    Args:
        video: the open webcam
        interval_s: no time is offered beyond it

    Raises:
        CameraError: the exposure cannot be set, or its unit is not known
    """

    def __init__(self, video: Video, interval_s: float) -> None:
        self._video = video
        unit = UNITS.get(video.backend)
        if unit is None:
            known = ", ".join(UNITS)
            raise CameraError(
                f"{video.name} is read by OpenCV's {video.backend}, whose unit of exposure is not "
                "known",
                hint=f"use a camera that one of {known} reads",
            )
        self._unit = unit
        found = video.set("AUTO_EXPOSURE", unit.manual)
        notes = [
            f"the range and the unit of the exposure are assumed, as OpenCV's {video.backend} has "
            "them; the times are what it reads back"
        ]
        if found != unit.manual:
            notes.append("manual exposure is not read back: frames with one exposure may differ")
        for name, off, words in _AUTOMATICS:
            if video.set(name, off) != off:
                notes.append(f"{words} is not read back as off: frames may differ")
        self.notes = tuple(notes)
        self.times = self._times(interval_s)

    def write(self, setting: ExposureSetting) -> ExposureSetting:
        """Set the time and return it as read back.

        Raises:
            RefusedSettingError: the camera applied another one
        """
        value = self._unit.value(setting.time_s)
        found = self._video.set("EXPOSURE", value)
        if found != value:
            raise RefusedSettingError("time_s", setting.time_s, self._unit.time_s(found))
        return ExposureSetting(self._unit.time_s(found))

    def _times(self, interval_s: float) -> Control:
        if self._unit.ticks_per_s:
            low = self._video.set("EXPOSURE", _LOWEST_LINEAR)
            high = self._video.set("EXPOSURE", _HIGHEST_LINEAR)
            longest = min(high, math.floor(interval_s * self._unit.ticks_per_s * (1 + 1e-9)))
            if not 0 < low < longest:
                raise self._not_settable(low, high)
            per_s = self._unit.ticks_per_s
            return Steps(low / per_s, longest / per_s, 1 / per_s)
        values = range(_LOWEST_LOGARITHM, _HIGHEST_LOGARITHM + 1)
        kept = [value for value in values if self._video.set("EXPOSURE", value) == value]
        times = tuple(math.exp2(value) for value in kept if math.exp2(value) <= interval_s)
        if len(times) < 2:
            raise self._not_settable(kept[0] if kept else 0, kept[-1] if kept else 0)
        return Choices(times)

    def _not_settable(self, low: float, high: float) -> CameraError:
        return CameraError(
            f"the exposure of {self._video.name} cannot be set: {low:g} to {high:g} are read back",
            hint="use a camera with manual exposure; on Linux, v4l2: knows more of a webcam",
        )


class FixedExposure:
    """The exposure of a stream that has no control for it: one time, as the user states it."""

    def __init__(self, time_s: float, *, is_stated: bool) -> None:
        self.times: Control = Choices((time_s,))
        origin = "as stated" if is_stated else "unknown and taken as the frame interval"
        self.notes = (
            f"the exposure of this stream cannot be set; it is {origin}, and may change by itself",
        )

    def write(self, setting: ExposureSetting) -> ExposureSetting:
        """Return the setting: there is nothing to set."""
        return setting


class AddressExposure:
    """The exposure of a stream whose address has a place for it; each change opens it again.

    Args:
        reopen: opens the stream again with another time, s
        shortest_s, longest_s: as the user states them

    Raises:
        UsageError: they are missing or contradict each other
    """

    def __init__(
        self, reopen: Callable[[float], None], shortest_s: float | None, longest_s: float | None
    ) -> None:
        if shortest_s is None or longest_s is None or not shortest_s <= longest_s:
            raise UsageError(
                "an address with a place for the exposure time needs its range",
                hint="give its shortest and its longest time in seconds",
                remedies={"option:shortest": None, "option:longest": None},
            )
        self._reopen = reopen
        self._time_s: float | None = None
        self.times: Control = Steps(shortest_s, longest_s, 1e-6)
        self.notes = (
            "the exposure time is a part of the address and cannot be read back: compare the "
            "ratios measured in the report",
        )

    def write(self, setting: ExposureSetting) -> ExposureSetting:
        if setting.time_s != self._time_s:
            self._reopen(setting.time_s)
            self._time_s = setting.time_s
        return setting


Exposure: TypeAlias = PropertyExposure | FixedExposure | AddressExposure
"""The exposure control of a video: `times`, what is not known of them (`notes`), and `write`."""
