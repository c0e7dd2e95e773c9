"""Exposures that a camera states of each frame, checked against the pixels before they are used.

The data that a camera sends with a frame may be those of the frame before it.  Then frames of one
stated exposure differ in brightness, or a longer one is not brighter.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Generic, Self, TypeVar

from camctl.interface.controls import ExposureSetting
from camctl.streaming.control_delay import FrameStamp, NumberedSource, Written, same_brightness

DataT = TypeVar("DataT")

#: Frames of each exposure that have to agree.
_FRAMES = 3
#: Mean brightness, as a share of full scale, from which a longer exposure need not be brighter.
_FULL = 0.95
#: Relative difference up to which a stated exposure is that of a setting: cameras state times in
#: whole lines of the sensor, of which a frame has a thousand.
_TOLERANCE = 2e-3


def is_same(one: ExposureSetting, other: ExposureSetting) -> bool:
    """Return whether a stated exposure is that of a setting."""
    return all(
        math.isclose(a, b, rel_tol=_TOLERANCE)
        for a, b in ((one.time_s, other.time_s), (one.gain, other.gain))
    )


class StatedExposures(Generic[DataT]):
    """A `NumberedSource` that compares what its frames state with what they show.

    Args:
        source: the stream
        brightness: mean brightness of a frame as a share of full scale; None: nothing is compared

    Attributes:
        are_believed: whether the pixels have agreed with what was stated
        number: of the last frame
    """

    def __init__(
        self, source: NumberedSource[DataT], brightness: Callable[[DataT], float] | None
    ) -> None:
        self._source, self._brightness = source, brightness
        self._frames: dict[float, list[float]] = {}
        self._data: DataT | None = None
        self._has_data = False
        self.are_believed = False
        self.number = -1
        self.write: Callable[[ExposureSetting], Written] = source.write

    @classmethod
    def of(cls, source: NumberedSource[DataT], brightness: Callable[[DataT], float] | None) -> Self:
        """Return a source that compares; one that does already goes on, with what it has found."""
        return source if isinstance(source, cls) else cls(source, brightness)

    def believed(self, stamp: FrameStamp) -> ExposureSetting | None:
        """Return the exposure that a frame states; None: it states none, or it is not believed."""
        return stamp.applied if self.are_believed else None

    def applied(self, stamp: FrameStamp, written: ExposureSetting) -> ExposureSetting:
        """Return the exposure of a frame that should have a setting that was written."""
        stated = self.believed(stamp)
        return written if stated is None or is_same(stated, written) else stated

    def next_frame(self) -> FrameStamp:
        """Return the next frame's stamp; its pixels are compared with others while they count."""
        stamp = self._source.next_frame()
        self._has_data = False
        self.number = stamp.number
        if stamp.applied is None or self._brightness is None or self.are_believed:
            return stamp
        data = self.read()
        if data is not None:
            self._add(stamp.applied.exposure, self._brightness(data))
        return stamp

    def read(self) -> DataT | None:
        """Return the frame that arrived last; None where it is damaged."""
        if not self._has_data:
            self._data, self._has_data = self._source.read(), True
        return self._data

    def upcoming(self, *, late: bool = False) -> int | None:
        """See `NumberedSource.upcoming`."""
        return self._source.upcoming(late=late)

    def _add(self, exposure: float, brightness: float) -> None:
        frames = self._frames.setdefault(exposure, [])
        frames.append(brightness)
        complete = [each for each in self._frames.values() if len(each) >= _FRAMES]
        # An exposure before the list occurs a few times, and never again.
        is_over = len(complete) == len(self._frames) or len(frames) > 2 * _FRAMES
        if len(complete) >= 2 and is_over:
            self.are_believed = self._agrees()
            self._frames.clear()

    def _agrees(self) -> bool:
        """Return whether equal exposures are equally bright, and longer ones brighter.

        Saturated ones need not be brighter; at least one has to be.
        """
        before, is_shown = -1.0, False
        for _, shown in sorted(self._frames.items()):
            low, high = min(shown), max(shown)
            if not same_brightness(low, high):
                return False
            is_same = same_brightness(before, low)
            if (is_same and before < _FULL) or (low < before and not is_same):
                return False
            is_shown |= before >= 0 and not is_same
            before = high
        return is_shown
