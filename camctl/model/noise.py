"""The noise of a camera, in the terms of EMVA 1288."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from camctl.errors import UsageError

if TYPE_CHECKING:
    from camctl.model.block_rounding import BlockRounding


@dataclass(frozen=True)
class FrameNoise:
    """The noise of one frame, in brightness levels (DN) of the linear scale.

    Attributes:
        electrons_per_level: electrons of one level; infinite without photon noise
        read_noise_levels: standard deviation of what is added whatever the light is, without the
            quantisation (read noise and the shot noise of the dark current), levels
        dark_levels: mean signal of the dark current, levels
        dsnu_levels: standard deviation of the offset over the pixels, the same electrons in each
            frame, levels
        prnu: standard deviation of the sensitivity over the pixels, relative
        black: black level, DN: by so many levels noise can lower a sample below 0
        compression_levels: standard deviation of what the compression of a file, such as JPEG, adds
            to the brightness where there is contrast, levels of the response
        file: what it makes of noise; None: nothing
    """

    electrons_per_level: float
    read_noise_levels: float
    dark_levels: float = 0.0
    dsnu_levels: float = 0.0
    prnu: float = 0.0
    black: int = 0
    compression_levels: float = 0.0
    file: BlockRounding | None = None

    def in_levels(self, size: float) -> FrameNoise:
        """Return the same noise in levels that are `size` times as large."""
        return replace(
            self,
            electrons_per_level=self.electrons_per_level * size,
            read_noise_levels=self.read_noise_levels / size,
            dark_levels=self.dark_levels / size,
            dsnu_levels=self.dsnu_levels / size,
            compression_levels=self.compression_levels / size,
        )

    @property
    def is_none(self) -> bool:
        """Whether quantisation is all."""
        others = (self.read_noise_levels, self.dsnu_levels, self.prnu, self.compression_levels)
        return math.isinf(self.electrons_per_level) and not any(others) and self.file is None


@dataclass(frozen=True)
class NoiseModel:
    """The noise of a camera: what a simulated sensor states or a calibration has measured.

    Electrons are counted on the linear scale: full scale, white - black + 1 levels, is E = 1, and
    the camera's response maps it to brightness afterwards.

    Attributes:
        conversion_e_per_dn: K, electrons of one level at gain 1
        read_noise_e: (gain, read noise in electrons) pairs, gains ascending; between two gains it
            is interpolated over the logarithm of the gain, beyond them it is constant
        full_well_e: electrons that a pixel holds; None where this is unknown
        dark_current_e_s: electrons a pixel a second without light
        prnu: standard deviation of the sensitivity over the pixels, relative (EMVA 1288 PRNU)
        dsnu_e: standard deviation of the offset over the pixels, electrons (EMVA 1288 DSNU)
        dcnu_e_s: standard deviation of the dark current over the pixels, electrons a second (EMVA
            1288 DCNU)
        photon_noise: False for an ideal sensor, whose electrons do not vary

    Raises:
        UsageError: a number is negative or not finite, or gains are not ascending

    >>> noise = NoiseModel(10.0, ((1.0, 4.0), (4.0, 2.0)))
    >>> noise.frame(gain=4.0, time_s=0.01).read_noise_levels
    0.8
    """

    conversion_e_per_dn: float
    read_noise_e: tuple[tuple[float, float], ...] = ((1.0, 0.0),)
    full_well_e: float | None = None
    dark_current_e_s: float = 0.0
    prnu: float = 0.0
    dsnu_e: float = 0.0
    dcnu_e_s: float = 0.0
    photon_noise: bool = True

    def __post_init__(self) -> None:
        if not 0 < self.conversion_e_per_dn < math.inf:
            raise UsageError(
                f"invalid conversion gain {self.conversion_e_per_dn:g} electrons per level: "
                "expected a positive number"
            )
        if self.full_well_e is not None and not 0 < self.full_well_e < math.inf:
            raise UsageError(
                f"invalid full well {self.full_well_e:g}: expected a positive number of electrons"
            )
        for name in ("dark_current_e_s", "prnu", "dsnu_e", "dcnu_e_s"):
            value = getattr(self, name)
            if not 0 <= value < math.inf:
                raise UsageError(f"invalid {name} {value:g}: expected a finite number >= 0")
        gains = [gain for gain, _ in self.read_noise_e]
        if not gains or gains != sorted(set(gains)) or not 0 < gains[0] <= gains[-1] < math.inf:
            raise UsageError(
                f"invalid gains of the read noise {gains}: expected different ascending numbers"
            )
        if not all(0 <= noise < math.inf for _, noise in self.read_noise_e):
            raise UsageError("invalid read noise: expected finite numbers of electrons >= 0")

    @property
    def is_none(self) -> bool:
        """Whether this is a camera without any noise, as an ideal sensor is."""
        others = (self.dark_current_e_s, self.prnu, self.dsnu_e, self.dcnu_e_s)
        return not (self.photon_noise or any(others) or any(e for _, e in self.read_noise_e))

    def read_noise(self, gain: float) -> float:
        """Return the read noise at a linear gain, electrons."""
        gains, noises = zip(*self.read_noise_e, strict=True)
        return float(np.interp(math.log(gain), np.log(gains), noises))

    def frame(self, *, gain: float, time_s: float, black: int = 0) -> FrameNoise:
        """Return the noise of a frame.

        The patterns of offset and of dark current are treated as one pattern, which makes their
        part of a sum of frames too large where the two are of similar size.

        Args:
            gain: linear gain
            time_s: shutter time, s
            black: black level of the camera, DN
        """
        electrons = self.conversion_e_per_dn / gain
        dark_e = self.dark_current_e_s * time_s
        added_e = math.hypot(self.read_noise(gain), math.sqrt(dark_e))
        return FrameNoise(
            electrons if self.photon_noise else math.inf,
            added_e / electrons,
            dark_e / electrons,
            math.hypot(self.dsnu_e, self.dcnu_e_s * time_s) / electrons,
            self.prnu,
            black,
        )


@dataclass(frozen=True)
class MeasuredNoise:
    """The accuracy that the pixels themselves show, from the differences of the frames.

    Attributes:
        effective_levels: with the noise measured in the capture
        uncertainty: of the effective levels, one standard deviation
        electrons_per_level: at gain 1; None where no photon noise was found
        read_noise_levels: at gain 1
        samples: number of pixels that were compared
    """

    effective_levels: float
    uncertainty: float
    electrons_per_level: float | None
    read_noise_levels: float
    samples: int

    def contradicts(self, predicted: float) -> bool:
        """Return whether a prediction differs by more than 10 % and three uncertainties."""
        difference = abs(self.effective_levels - predicted)
        return difference > max(0.1 * predicted, 3 * self.uncertainty)
