"""The true exposures of a camera's settings, as a calibration has measured them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Literal, Self

from pydantic import Field, model_validator

from camctl.interface.controls import ExposureControls, ExposureSetting, Layout
from camctl.profiles.record import Record

#: Relative difference of settings that count as the same.
_SAME = 1e-4
#: Shutter times further apart are not interpolated.
_WIDEST_STEP = 2.1


class Correction(Record):
    """The true effect of one setting on the exposure, over the stated one.

    Attributes:
        value: the setting: a shutter time in s, or a linear gain
        factor: true over stated exposure, relative to a reference setting, which has 1
        low: lower end of the 95 % confidence interval of `factor`
        high: upper end
    """

    value: float = Field(gt=0, allow_inf_nan=False)
    factor: float = Field(gt=0, allow_inf_nan=False)
    low: float = Field(gt=0, allow_inf_nan=False)
    high: float = Field(gt=0, allow_inf_nan=False)

    @model_validator(mode="after")
    def _agree(self) -> Self:
        if not self.low <= self.factor <= self.high:
            raise ValueError("expected low <= factor <= high")
        return self

    def times(self, other: Correction) -> Correction:
        """Return the correction of a setting that has both; it keeps the value of this one."""
        factor = self.factor * other.factor
        widths = [
            math.hypot(*(math.log(end) for end in ends))
            for ends in (
                (self.factor / self.low, other.factor / other.low),
                (self.high / self.factor, other.high / other.factor),
            )
        ]
        return Correction(
            value=self.value,
            factor=factor,
            low=factor * math.exp(-widths[0]),
            high=factor * math.exp(widths[1]),
        )

    @property
    def contradicts_label(self) -> bool:
        """Whether the stated exposure lies outside the interval."""
        return not self.low <= 1.0 <= self.high


class ExposureRecord(Record):
    """The true exposures of a camera's settings in one mode.

    The exposure of a setting is the stated one times the factors of its time and of its gain.

    Attributes:
        version: of this format
        times: by ascending shutter time, measured at the gain nearest to 1
        gains: by ascending gain, relative to the gain nearest to 1, which has the factor 1
        interpolates: whether the camera also has the shutter times between those measured
        measured_at: date and time, ISO 8601
    """

    version: Literal[1] = 1
    times: tuple[Correction, ...] = Field(max_length=10_000)
    gains: tuple[Correction, ...] = Field(max_length=10_000)
    interpolates: bool
    measured_at: str

    def correction(self, setting: ExposureSetting) -> Correction | None:
        """Return the correction of a setting; None where it was not measured.

        Where the record interpolates, the factor between two measured times up to `_WIDEST_STEP`
        apart is linear in the logarithm of the time, and the interval is the wider.
        """
        gain = _find(self.gains, setting.gain)
        time = _find(self.times, setting.time_s)
        if time is None and self.interpolates:
            time = _between(self.times, setting.time_s)
        if time is None or gain is None or setting.f_number is not None:
            return None
        return time if gain.factor == gain.low == gain.high == 1 else time.times(gain)

    def joined(self, earlier: ExposureRecord) -> ExposureRecord:
        """Return this record with the settings of an earlier one that it lacks.

        The earlier times are related to this reference by the times that both have; without such
        times they are dropped.
        """
        shared = [(each, old) for each in self.times if (old := _find(earlier.times, each.value))]
        times = list(self.times)
        if shared:
            unit = math.exp(
                sum(math.log(each.factor / old.factor) for each, old in shared) / len(shared)
            )
            widest = max((old for _, old in shared), key=lambda old: old.high / old.low)
            spread = Correction(
                value=1.0,
                factor=unit,
                low=unit * widest.low / widest.factor,
                high=unit * widest.high / widest.factor,
            )
            times += [old.times(spread) for old in earlier.times if not _find(times, old.value)]
        gains = [old for old in earlier.gains if not _find(self.gains, old.value)]
        return self.model_copy(
            update={
                "times": tuple(sorted(times, key=lambda each: each.value)),
                "gains": tuple(sorted([*self.gains, *gains], key=lambda each: each.value)),
            }
        )


def _find(measured: Sequence[Correction], value: float) -> Correction | None:
    return next((each for each in measured if math.isclose(each.value, value, rel_tol=_SAME)), None)


def _between(measured: Sequence[Correction], value: float) -> Correction | None:
    for below, above in pairwise(measured):
        if below.value < value < above.value <= _WIDEST_STEP * below.value:
            share = math.log(value / below.value) / math.log(above.value / below.value)
            factor = below.factor + share * (above.factor - below.factor)
            return Correction(
                value=value,
                factor=factor,
                low=factor * min(each.low / each.factor for each in (below, above)),
                high=factor * max(each.high / each.factor for each in (below, above)),
            )
    return None


def exposure_mode(controls: ExposureControls) -> str:
    """Return the mode that an `ExposureRecord` belongs to, such as mono-yuyv-640x480-255."""
    return mode_name(controls.layout, controls.shape, controls.white, controls.pixel_format)


def mode_name(layout: Layout, shape: tuple[int, ...], white: int, pixel_format: str = "") -> str:
    """Return the name of a mode: pixel layout and format, size, and white level."""
    kind = f"{layout}-{pixel_format}" if pixel_format else layout
    return f"{kind}-{shape[1]}x{shape[0]}-{white}"
