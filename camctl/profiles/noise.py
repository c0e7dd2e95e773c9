"""The noise of a camera in one mode, as a calibration has measured it."""

from __future__ import annotations

import math
from typing import Literal, Self

from pydantic import Field, FiniteFloat, model_validator

from camctl.findings import Finding
from camctl.model.noise import NoiseModel
from camctl.profiles.record import Record

MOST_HOT_PIXELS = 10_000
"""Hot pixels that a record keeps, the brightest ones."""

#: Gains, times, groups of brightness and notes that a record may have.
_MOST = 1000


class Figure(Record):
    """A measured number >= 0 with its 95 % confidence interval.

    Attributes:
        value: the estimate
        low: lower end of the interval
        high: upper end
    """

    value: float = Field(ge=0, allow_inf_nan=False)
    low: float = Field(ge=0, allow_inf_nan=False)
    high: float = Field(ge=0, allow_inf_nan=False)

    @model_validator(mode="after")
    def _agree(self) -> Self:
        if not self.low <= self.value <= self.high:
            raise ValueError("expected low <= value <= high")
        return self

    def times(self, other: Figure) -> Figure:
        """Return the product with an independent figure; relative errors add in quadrature."""
        if not (self.value and other.value):  # an interval from 0 on
            return Figure(value=0.0, low=0.0, high=self.high * other.high)
        value = self.value * other.value
        below = math.hypot(*(1 - each.low / each.value for each in (self, other)))
        above = math.hypot(*(each.high / each.value - 1 for each in (self, other)))
        return Figure(value=value, low=max(0.0, value * (1 - below)), high=value * (1 + above))

    def scaled(self, factor: float) -> Figure:
        """Return the figure times an exact number."""
        return Figure(value=self.value * factor, low=self.low * factor, high=self.high * factor)


class CurvePoint(Record):
    """One group of samples of like brightness of a photon transfer curve.

    Attributes:
        mean: brightness above black, DN
        variance: of the noise, with its quantisation, DN squared
        fitted: the same by the fit
    """

    mean: FiniteFloat
    variance: FiniteFloat
    fitted: FiniteFloat


class GainNoise(Record):
    """The noise at one gain.

    Attributes:
        gain: linear gain
        conversion_e_per_dn: electrons of one level of the linear scale at this gain
        read_noise_e: noise without light, without quantisation, electrons
        patches: number of patches of 64 samples that were used
        misfit: mean square deviation from the fit over its expectation: well above 1 where the
            response differs from the one assumed, or where the camera filters its pictures
        curve: the photon transfer curve
    """

    gain: float = Field(gt=0, allow_inf_nan=False)
    conversion_e_per_dn: Figure
    read_noise_e: Figure
    patches: int = Field(ge=1)
    misfit: float = Field(ge=0, allow_inf_nan=False)
    curve: tuple[CurvePoint, ...] = Field(default=(), max_length=_MOST)

    def in_levels(self, size: float) -> GainNoise:
        """Return the same noise in levels that are `size` times as large."""
        curve = tuple(
            CurvePoint(
                mean=each.mean / size,
                variance=each.variance / size**2,
                fitted=each.fitted / size**2,
            )
            for each in self.curve
        )
        conversion = self.conversion_e_per_dn.scaled(size)
        return self.model_copy(update={"conversion_e_per_dn": conversion, "curve": curve})


class HotPixel(Record):
    """A pixel whose dark signal grows far faster than in the others.

    Attributes:
        row: counted from 0
        column: counted from 0
        rate_e_s: dark signal minus the dark signal of the median pixel, electrons a second
    """

    row: int = Field(ge=0)
    column: int = Field(ge=0)
    rate_e_s: float = Field(ge=0, allow_inf_nan=False)


class DarkRecord(Record):
    """What frames without light show.

    Attributes:
        gain: linear gain of the frames
        times_s: shutter times, ascending
        dark_current_e_s: electrons a pixel a second
        dsnu_e: standard deviation of the pixels' offset at the shortest time, electrons
        black_dn: brightness at time 0, DN
        hot_pixels: the brightest first, at most `MOST_HOT_PIXELS`
        dcnu_e_s: standard deviation of the dark current over the pixels that are not hot, electrons
            a second; None: not measured
        measured_at: date and time, ISO 8601
    """

    gain: float = Field(gt=0, allow_inf_nan=False)
    times_s: tuple[FiniteFloat, ...] = Field(max_length=_MOST)
    dark_current_e_s: Figure
    dsnu_e: Figure
    black_dn: FiniteFloat
    hot_pixels: tuple[HotPixel, ...] = Field(max_length=MOST_HOT_PIXELS)
    dcnu_e_s: Figure | None = None
    measured_at: str


class NoiseRecord(Record):
    """The measured noise of a camera in one mode.

    Attributes:
        version: of this format
        gains: ascending
        full_well_e: electrons that saturate a sample at the lowest gain: the pixel's full well, or
            the end of the range of the analogue to digital converter, whichever comes first
        saturates: whether saturated samples were seen; else the stated white level is assumed
        prnu: standard deviation of the pixels' sensitivity, relative; None: not measured
        dark: from frames without light; None: not measured
        correlation: of the noise of neighbouring samples; None where it was not measured
        findings: what the user should know
        measured_at: date and time, ISO 8601
    """

    version: Literal[1] = 1
    gains: tuple[GainNoise, ...] = Field(min_length=1, max_length=_MOST)
    full_well_e: Figure
    saturates: bool
    prnu: Figure | None = None
    dark: DarkRecord | None = None
    correlation: float | None = Field(default=None, allow_inf_nan=False)
    findings: tuple[Finding, ...] = Field(default=(), max_length=_MOST)
    measured_at: str

    @model_validator(mode="after")
    def _agree(self) -> Self:
        gains = [each.gain for each in self.gains]
        if gains != sorted(set(gains)):
            raise ValueError("expected different ascending gains")
        if not all(each.conversion_e_per_dn.value > 0 for each in self.gains):
            raise ValueError("expected conversion gains above 0")
        return self

    def in_levels(self, size: float) -> NoiseRecord:
        """Return the same noise in levels that are `size` times as large."""
        return self.model_copy(update={"gains": tuple(each.in_levels(size) for each in self.gains)})

    @property
    def reference(self) -> GainNoise:
        """The noise at the gain nearest to 1, which stands for the camera."""
        return min(self.gains, key=lambda each: abs(math.log(each.gain)))

    def emva(self) -> dict[str, Figure]:
        """Return figures of EMVA 1288 at the lowest gain, with the saturation in electrons.

        `sensitivity_threshold_e` is the signal with as much noise as signal, quantisation included;
        `dynamic_range` the saturation over it; `snr_max` the ratio of signal to noise at saturation
        (amplitude ratios, not decibels).
        """
        lowest = self.gains[0]
        step = lowest.conversion_e_per_dn.value / math.sqrt(12)
        noise = lowest.read_noise_e
        least, low, high = (
            math.hypot(each, step) + 0.5 for each in (noise.value, noise.low, noise.high)
        )
        inverse = Figure(value=1 / least, low=1 / high, high=1 / low)
        full = self.full_well_e
        snr = [math.sqrt(each) for each in (full.value, full.low, full.high)]
        return {
            "sensitivity_threshold_e": Figure(value=least, low=low, high=high),
            "dynamic_range": full.times(inverse),
            "snr_max": Figure(value=snr[0], low=snr[1], high=snr[2]),
        }

    def noise_model(self) -> NoiseModel:
        """Return the noise for `ExposureControls.noise`.

        A `NoiseModel` divides the electrons of a level by the stated gain: read noise is converted,
        so that its levels are those measured, also where the true gain differs from the stated one.
        """
        reference = self.reference
        conversion = reference.conversion_e_per_dn.value * reference.gain
        return NoiseModel(
            conversion_e_per_dn=conversion,
            read_noise_e=tuple(
                (
                    each.gain,
                    each.read_noise_e.value
                    / each.conversion_e_per_dn.value
                    * conversion
                    / each.gain,
                )
                for each in self.gains
            ),
            full_well_e=self.full_well_e.value or None,
            dark_current_e_s=self.dark.dark_current_e_s.value if self.dark else 0.0,
            prnu=self.prnu.value if self.prnu else 0.0,
            dsnu_e=self.dark.dsnu_e.value if self.dark else 0.0,
            dcnu_e_s=self.dark.dcnu_e_s.value if self.dark and self.dark.dcnu_e_s else 0.0,
        )

    def joined(self, earlier: NoiseRecord) -> NoiseRecord:
        """Return this record with what it lacks, and an earlier one has: gains, PRNU, dark."""
        known = {each.gain for each in self.gains}
        gains = [*self.gains, *(each for each in earlier.gains if each.gain not in known)]
        return self.model_copy(
            update={
                "gains": tuple(sorted(gains, key=lambda each: each.gain)),
                "prnu": self.prnu or earlier.prnu,
                "dark": self.dark or earlier.dark,
            }
        )
