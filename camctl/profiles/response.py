"""The response of a camera in one mode, as a calibration has measured it."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, FiniteFloat, model_validator

from camctl.errors import unknown_name
from camctl.model.response.camera import CameraResponse, FloatArray
from camctl.model.response.measured import measured_response
from camctl.profiles.record import Record

#: Logarithm of the ratio of irradiances from which their deviation shows the exponent's.
_LEAST_DISTANCE = 1.0
#: Standard deviation of the slope with which a curve is continued where it was not measured.
_CONTINUED = 0.25
#: A level of a 16-bit camera for each number, and both ends.
_Curve = Annotated[tuple[FiniteFloat, ...], Field(max_length=65538)]


class ChannelResponse(Record):
    """The response of one channel as a curve: irradiance of ascending brightness.

    Attributes:
        name: R, G or B; Y on a monochrome camera
        black: brightness without light, DN
        white: brightness from which samples are saturated, DN
        saturates: whether samples were seen to be saturated at `white`
        irradiance: ascending from 0 to 1; each channel has its own unit
        brightness: above black, as a share of white - black + 1, ascending from 0 to 1
        deviation: standard deviation of ln(irradiance / irradiance at half the brightness);
            None where the method gives none
        measured: the least and the largest brightness that the frames determine; the curve outside
            continues it smoothly
    """

    name: str
    black: int = Field(ge=0, le=65535)
    white: int = Field(ge=1, le=65535)
    saturates: bool
    irradiance: _Curve
    brightness: _Curve
    deviation: _Curve | None
    measured: tuple[FiniteFloat, FiniteFloat]

    def level_table(self, phase: float) -> FloatArray:
        """Return the irradiance that each sample of a frame shows, (white + 1,), in its unit.

        A sample of brightness k (above black) has an irradiance between the thresholds of levels k
        and k + 1: the table has the irradiance in the middle of both, and 0 up to black.

        Args:
            phase: of the quantiser, `ResponseRecord.phase`
        """
        levels = self.white - self.black
        middle = (np.arange(self.white + 1) - self.black + 0.5 - phase) / (levels + 1)
        middle[: self.black + 1] = 0.0
        return np.interp(middle, self.brightness, self.irradiance)

    def sample_weights(self, noise_dn: float = 1.0) -> FloatArray:
        """Return the weight of each brightness in a mean of ln(irradiance), (white + 1,).

        It is 1 / (variance of the noise through the slope of the curve + variance of the curve).
        Samples up to the black level and from the white level on have weight 0: they do not show
        the irradiance, and would pull dark and bright pixels together.

        Args:
            noise_dn: standard deviation of a sample, DN
        """
        brightness = (np.arange(self.white + 1) - self.black) / (self.white - self.black + 1)
        logs = np.log(np.maximum(np.interp(brightness, self.brightness, self.irradiance), 1e-12))
        variance = (noise_dn * np.gradient(logs)) ** 2
        if self.deviation is not None:
            variance += np.interp(brightness, self.brightness, self.deviation) ** 2
        variance += 1e-12  # a flat curve
        weights = np.where(brightness > 0, 1 / variance, 0.0)
        weights[[self.black, self.white]] = 0.0
        return np.asarray(weights / weights.max())

    @property
    def exponent_error(self) -> float:
        """Standard deviation of the exponent of the curve; 0 where no deviation is known.

        An exponent that is wrong by e changes ln(irradiance) by e times its distance from its value
        at half the brightness.  The rest of the curve's deviation is errors of single parts, so
        the smallest ratio of deviation and distance is the error of the exponent.
        """
        if self.deviation is None:
            return 0.0
        irradiance, brightness = np.array(self.irradiance[1:]), np.array(self.brightness[1:])
        half = np.interp(0.5, self.brightness, self.irradiance)
        distance = np.abs(np.log(irradiance / half))
        low, high = self.measured
        counts = (distance >= _LEAST_DISTANCE) & (brightness >= low) & (brightness <= high)
        ratios = np.array(self.deviation[1:])[counts] / distance[counts]
        return float(ratios.min()) if ratios.size else 0.0

    @property
    def scale_error(self) -> float:
        """Standard deviation of ln(irradiance) at the end of the curve, as `deviation`.

        Where the curve is continued, its slope is uncertain, however uncertain what was measured.
        """
        if self.deviation is None:
            return 0.0
        ends = np.interp(self.measured, self.brightness, self.irradiance)
        continued = _CONTINUED * float(np.log(1 / ends[1]))
        highest = float(np.interp(self.measured[1], self.brightness, self.deviation))
        return float(min(np.hypot(highest, continued), self.deviation[-1]))

    def level_deviation(self, phase: float) -> FloatArray | None:
        """Return `deviation` of each level, infinite outside `measured`; None if unknown."""
        if self.deviation is None:
            return None
        count = self.white - self.black
        brightness = (np.arange(1.0, count + 1) - phase) / (count + 1)
        found = np.interp(brightness, self.brightness, self.deviation)
        # The ends of the measured range are levels, to rounding.
        low, high = self.measured[0] - 0.5 / count, self.measured[1] + 0.5 / count
        return np.where((brightness >= low) & (brightness <= high), found, np.inf)

    @model_validator(mode="after")
    def _agree(self) -> Self:
        if not self.black < self.white:
            raise ValueError("expected black < white")
        lists = (self.irradiance, self.brightness, self.deviation or self.brightness)
        if len({len(values) for values in lists}) > 1 or len(self.irradiance) < 2:
            raise ValueError("expected two or more numbers, equally many in each list")
        for values in (self.irradiance, self.brightness):
            if values[0] != 0 or values[-1] != 1 or not np.all(np.diff(values) > 0):
                raise ValueError("expected numbers that ascend from 0 to 1")
        return self


class ResponseRecord(Record):
    """The measured response of each channel of a camera in one mode.

    Attributes:
        version: of this format
        channels: in the order R, G, B; one on a monochrome camera
        phase: phase of the quantiser to which the brightness belongs
        frames: number of frames used
        measured_at: date and time, ISO 8601
    """

    version: Literal[1] = 1
    channels: tuple[ChannelResponse, ...] = Field(min_length=1, max_length=3)
    phase: float = Field(ge=0, lt=1)
    frames: int = Field(ge=1)
    measured_at: str

    @property
    def main_channel(self) -> ChannelResponse:
        """The channel that stands for all: green where there are three."""
        return self.channels[len(self.channels) // 2]

    def camera_response(self, channel: str | None = None) -> CameraResponse:
        """Return the response as levels.

        Args:
            channel: name of a channel; None: green where there are three

        Raises:
            UsageError: there is no such channel
        """
        named = {each.name: each for each in self.channels}
        if channel is None:
            channel = self.main_channel.name
        if channel not in named:
            raise unknown_name("channel", channel, named)
        found = named[channel]
        response = measured_response(
            found.irradiance,
            found.brightness,
            bits=found.white.bit_length(),
            phase=self.phase,
            levels=found.white - found.black,
            name=f"measured response, {channel}",
        )
        # The curve is smooth and its points are close enough: that lines join them is no repair.
        return replace(
            response,
            notes=(),
            exponent_error=found.exponent_error,
            deviation=found.level_deviation(self.phase),
            scale_error=found.scale_error,
        )
