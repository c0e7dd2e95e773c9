"""The exposure-setting interface: all that the controller knows of a camera.

A camera says what it can set (`ExposureControls`), takes a whole list of settings at once
(`Camera.shoot`) and hands over frames that say which exposure they really had (`Frame`).  Values
are SI: seconds, linear gain, f-number; true times, never the labels on a dial.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import TypeAlias

import numpy as np

from camctl.errors import RefusedSettingError, UsageError
from camctl.response.camera import CameraResponse, linear_response


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
    response: CameraResponse | None = None
    delay_frames: int | None = None
    frame_interval_s: float = 0.0
    sensitivity: float | None = None
    tolerance: float = 1e-6
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not (1 <= self.bits <= 16 and 0 <= self.black < self.white < 2**self.bits):
            raise ValueError("a camera needs 1 to 16 bits and 0 <= black < white < 2^bits")

    @property
    def levels(self) -> CameraResponse:
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
