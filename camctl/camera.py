"""The exposure-setting interface: all that the controller knows of a camera.

A camera says what it can set (`ExposureControls`), takes a whole list of settings at once
(`Camera.shoot`) and hands over frames that say which exposure they really had (`Frame`).  Values
are SI: seconds, linear gain, f-number; true times, never the labels on a dial.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from types import TracebackType
from typing import Any, Protocol, Self, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from camctl.clock import Clock
from camctl.errors import RefusedSettingError, UsageError
from camctl.exposure.response import RealResponse, linear_response

Pixels: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]


class Layout(StrEnum):
    """How colour lies in a frame."""

    MONO = "mono"
    RGB = "rgb"
    RGGB = "rggb"
    GRBG = "grbg"
    GBRG = "gbrg"
    BGGR = "bggr"

    @property
    def is_mosaic(self) -> bool:
        """True where each pixel has one colour of a 2 x 2 Bayer pattern, named row by row."""
        return self not in (Layout.MONO, Layout.RGB)


@dataclass(frozen=True)
class CameraInfo:
    """Who a camera is; `id` is what finds it again on the command line."""

    id: str
    make: str
    model: str
    serial: str
    driver: str


@dataclass(frozen=True)
class ExposureSetting:
    """One exposure: shutter time in s, linear gain, f-number (None: the lens is not ours)."""

    time_s: float
    gain: float = 1.0
    f_number: float | None = None

    @property
    def exposure(self) -> float:
        """Everything that scales the light, in arbitrary but constant units: time x gain / N^2."""
        return self.time_s * self.gain / (self.f_number or 1.0) ** 2


@dataclass(frozen=True)
class Choices:
    """A control with a list of settings, ascending."""

    values: tuple[float, ...]

    def __post_init__(self) -> None:
        if not self.values or list(self.values) != sorted(set(self.values)):
            raise ValueError("choices must be ascending, different, and at least one")

    @property
    def minimum(self) -> float:
        """The smallest setting."""
        return self.values[0]

    @property
    def maximum(self) -> float:
        """The largest setting."""
        return self.values[-1]

    def nearest(self, value: float) -> float:
        """Return the setting nearest to `value` as a ratio."""
        return min(self.values, key=lambda choice: abs(math.log(choice / value)))

    def near(self, value: float, count: int) -> tuple[float, ...]:
        """Return up to `count` settings around `value`, ascending."""
        ranked = sorted(self.values, key=lambda choice: abs(choice - value))
        return tuple(sorted(ranked[:count]))

    def between(self, low: float, high: float, count: int) -> tuple[float, ...]:
        """Return up to `count` settings within [low, high], the largest ones, ascending."""
        return tuple(value for value in self.values if low <= value <= high)[-count:]


@dataclass(frozen=True)
class Steps:
    """A control that goes from `minimum` to `maximum` in equal steps (`step` = 0: continuous)."""

    minimum: float
    maximum: float
    step: float = 0.0

    def __post_init__(self) -> None:
        if not (0 < self.minimum <= self.maximum < math.inf and 0 <= self.step < math.inf):
            raise ValueError("a range needs 0 < minimum <= maximum and step >= 0")

    @property
    def _last(self) -> int:
        return math.floor((self.maximum - self.minimum) / self.step * (1 + 1e-12) + 1e-9)

    def _at(self, index: int) -> float:
        return self.minimum + min(max(index, 0), self._last) * self.step

    def nearest(self, value: float) -> float:
        """Return the setting nearest to `value`."""
        if self.step == 0:
            return min(max(value, self.minimum), self.maximum)
        return self._at(round((value - self.minimum) / self.step))

    def near(self, value: float, count: int) -> tuple[float, ...]:
        """Return up to `count` settings around `value`, ascending."""
        if self.step == 0:
            return (self.nearest(value),)
        first = round((value - self.minimum) / self.step - (count - 1) / 2)
        first = max(0, min(first, self._last - count + 1))
        return tuple(self._at(i) for i in range(first, min(first + count, self._last + 1)))

    def between(self, low: float, high: float, count: int) -> tuple[float, ...]:
        """Return up to `count` settings within [low, high], the largest ones, ascending."""
        low, high = max(low, self.minimum), min(high, self.maximum)
        if low > high:
            return ()
        if self.step == 0:
            return tuple(float(v) for v in np.unique(np.geomspace(low, high, count)))
        first = math.ceil((low - self.minimum) / self.step - 1e-9)
        last = math.floor((high - self.minimum) / self.step + 1e-9)
        return tuple(self._at(i) for i in range(max(first, last - count + 1), last + 1))


Control: TypeAlias = Choices | Steps


@dataclass(frozen=True)
class ExposureControls:
    """What a camera can set, and what its frames are made of.

    Attributes:
        time_s: shutter times, s
        gain: linear gains; `Choices((1.0,))` where there is none
        f_number: f-numbers, or None where the aperture is not ours to set
        shape: (rows, columns) of a frame
        layout: how colour lies in it
        bits: bits a sample
        black: brightness without light, DN
        white: brightness from which a sample says no more than "saturated", DN
        phase: the quantiser's phase: 0 floor, 1/2 rounding, a fraction of the black level between
        response: the measured response as levels between black and white; None: linear
        delay_frames: frames from setting an exposure to the frame that has it; None where that is
            not constant, so that the stream settles for each exposure
        frame_interval_s: least time from frame to frame, s
        sensitivity: full scales (white - black + 1) that one second at gain 1 (and f/1 where there
            is an aperture) gives for each unit of the scene's irradiance; None where that is
            unknown, and irradiance is then relative
        tolerance: relative error up to which a setting counts as met
        notes: what a person should know of its pictures, one line each
    """

    time_s: Control
    shape: tuple[int, int]
    layout: Layout
    bits: int
    gain: Control = Choices((1.0,))
    f_number: Control | None = None
    black: int = 0
    white: int = 0
    phase: float = 0.0
    response: RealResponse | None = None
    delay_frames: int | None = None
    frame_interval_s: float = 0.0
    sensitivity: float | None = None
    tolerance: float = 1e-6
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not (1 <= self.bits <= 16 and 0 <= self.black < self.white < 2**self.bits):
            raise ValueError("a camera needs 1 to 16 bits and 0 <= black < white < 2^bits")

    @property
    def levels(self) -> RealResponse:
        """The camera's response as levels: what the exposure table is looked up by."""
        if self.response is not None:
            return self.response
        return linear_response(self.bits, phase=self.phase, levels=self.white - self.black)

    def check(self, setting: ExposureSetting) -> None:
        """Raise `RefusedSettingError` unless the camera can do `setting` within its tolerance."""
        for name in ("time_s", "gain", "f_number"):
            wanted: float | None = getattr(setting, name)
            control: Control | None = getattr(self, name)
            if wanted is None:
                continue
            if not (math.isfinite(wanted) and wanted > 0):
                raise UsageError(f"{name} of {wanted} is not a positive number")
            if control is None:
                raise UsageError(f"this camera cannot set {name}", hint="leave it out")
            nearest = control.nearest(wanted)
            if abs(nearest - wanted) > self.tolerance * wanted:
                raise RefusedSettingError(name, wanted, nearest)


@dataclass(frozen=True)
class OriginalFile:
    """The file that a still camera made of a frame, byte for byte."""

    suffix: str
    data: bytes


@dataclass(frozen=True, eq=False)
class Frame:
    """One exposure as it came.

    Attributes:
        pixels: (rows, columns) or, for RGB, (rows, columns, 3); uint8 up to 8 bits, else uint16
        requested: the setting that was asked for
        applied: the setting read back from the camera
        timestamp_s: when the exposure ended, on the camera's clock, s
        index: position of the setting in the list that `shoot` was given
        black: brightness without light in this frame, DN
        white: brightness from which samples of this frame are saturated, DN
        original: the camera's own file where there is one
        details: what else the camera says of the frame; goes into the capture's report as JSON
    """

    pixels: Pixels
    requested: ExposureSetting
    applied: ExposureSetting
    timestamp_s: float
    index: int
    black: int
    white: int
    original: OriginalFile | None = None
    details: Mapping[str, Any] = field(default_factory=dict)


class FrameStream(Iterator[Frame], Protocol):
    """Frames as they come; any generator of frames is one."""

    def close(self) -> None:
        """Cancel what is left."""
        ...


@runtime_checkable
class Camera(Protocol):
    """What every camera, real or simulated, stands behind.

    A camera is a context manager; leaving it closes the device.  `camctl.testing.CameraConformance`
    checks all that is promised here.
    """

    @property
    def info(self) -> CameraInfo:
        """Who it is."""
        ...

    @property
    def controls(self) -> ExposureControls:
        """What it can set."""
        ...

    @property
    def clock(self) -> Clock:
        """The clock of its timestamps."""
        ...

    def shoot(self, settings: Sequence[ExposureSetting]) -> FrameStream:
        """Take the settings in their order and yield one frame for each.

        The whole list is checked before the first frame: a setting that cannot be met within
        `ExposureControls.tolerance` raises `RefusedSettingError` from this call, and nothing is
        shot.  A frame is yielded only if the camera can say which exposure it had; it is then the
        caller's to keep.  Closing the iterator cancels what is left.  With a constant control delay
        of d frames, n settings take n + d frames.

        Raises:
            RefusedSettingError: a setting cannot be met
            CameraBusyError, CameraDisconnectedError, CameraTimeoutError, CameraProtocolError
        """
        ...

    def close(self) -> None:
        """Let go of the device; a second call does nothing."""
        ...

    def __enter__(self) -> Self:
        """Return the camera itself."""
        ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the camera."""
        ...


@runtime_checkable
class PreviewingCamera(Camera, Protocol):
    """A camera that can look without spending a shutter actuation."""

    def preview(self, setting: ExposureSetting) -> Frame:
        """Return one frame at `setting`, for metering; raises as `shoot` does."""
        ...


@runtime_checkable
class StreamingCamera(Camera, Protocol):
    """A camera whose frames keep coming, so that the delay of its controls can be measured."""

    @property
    def mode(self) -> str:
        """What a delay belongs to: pixel format, size and frame rate in one word."""
        ...

    def step(self, before: ExposureSetting, after: ExposureSetting, frames: int) -> Sequence[Frame]:
        """Settle at `before`, set `after`, and return the next `frames` frames as they come.

        Frame 0 is the first whose exposure had not begun when `after` was set; with a control delay
        of d frames, frame d is the first that has it.  Which exposure each frame had is what the
        caller wants to find out: `requested` and `applied` are those of `after`, and `index` counts
        from 0.  Raises as `shoot` does.
        """
        ...
