"""What the control-delay pipeline needs of a stream: numbered frames and an exposure control."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from camctl.errors import CameraProtocolError
from camctl.interface.camera import Pixels
from camctl.interface.controls import ExposureSetting

#: Two frames have the same exposure if their brightnesses differ by at most this share of the
#: brightness, or of full scale: more than the noise of a mean, less than a step of exposure.
_SAME_RELATIVE, _SAME_OF_FULL_SCALE = 0.02, 0.002
#: Samples of which `mean_brightness` takes the mean, about: noise averages out to 1/128.
_SAMPLES = 1 << 14

DataT_co = TypeVar("DataT_co", covariant=True)


@dataclass(frozen=True)
class FrameStamp:
    """Which frame arrived.

    Attributes:
        number: of its slot; larger than the number of every frame before it
        time_s: when its exposure ended, on the camera's clock, s
        is_certain: False where an unknown number of frames was lost, so that the number may
            be wrong in relation to the numbers before it
        applied: the exposure that the camera states of this very frame (metadata, chunk data); None
            where it states none.  Some state the exposure of another frame, so that it is used
            only after the pixels have agreed, see `StatedExposures`
    """

    number: int
    time_s: float
    is_certain: bool = True
    applied: ExposureSetting | None = None


@dataclass(frozen=True)
class Written:
    """A setting that was written.

    Attributes:
        applied: the setting as read back from the device
        first, last: bounds of the number of the first slot that had not begun at the write; equal
            where it is certain in which slot the write took place
    """

    applied: ExposureSetting
    first: int
    last: int


class NumberedSource(Protocol[DataT_co]):
    """A running stream whose frames have slot numbers.

    Slots are numbered in the order of their exposure; the number of a lost frame is skipped.
    `DataT_co` is whatever the stream delivers as a frame: an array of pixels, or a buffer that is
    decoded later.  Each method may raise `camctl.CameraError`.
    """

    def next_frame(self) -> FrameStamp:
        """Wait for the next frame and state its number.

        Raises:
            CameraTimeoutError: no frame arrived within the time-out of the stream
        """

    def read(self) -> DataT_co | None:
        """Return the frame that arrived last; None where it is damaged."""

    def upcoming(self, *, late: bool = False) -> int | None:
        """Return the number of the first slot that has not begun, if a setting may be written now.

        Where a write would have to wait a moment for the current slot, this method waits.  `late`
        asks for the latest moment in the slot at which a write is still allowed.

        Returns:
            None where the current slot is too far advanced: take a frame, then ask again.
        """

    def write(self, setting: ExposureSetting) -> Written:
        """Set the exposure and read it back.

        Raises:
            RefusedSettingError: the device applied another setting
        """


def irregular_frames() -> CameraProtocolError:
    """Return the error for a stream in which no setting can be assigned to a frame."""
    return CameraProtocolError(
        "frames are lost, damaged, or arrive at irregular times",
        hint="close other programs, give the camera a USB port of its own, or choose a smaller "
        "size or a lower frame rate",
    )


def mean_brightness(pixels: Pixels, full_scale: int) -> float:
    """Return the mean of about 16,000 samples of a frame, as a share of `full_scale`, DN."""
    step = max(1, int((pixels.size / _SAMPLES) ** 0.5))
    return float(np.mean(pixels[::step, ::step])) / full_scale


def same_brightness(one: float, other: float) -> bool:
    """Return whether two mean brightnesses, shares of full scale, are those of one exposure."""
    return abs(one - other) <= max(_SAME_RELATIVE * one, _SAME_OF_FULL_SCALE)
