"""Parts of a sensor that a plain one does not have: lens, dark signal, pixels, read-out.

Every parameter that is left out, 0 or None means that its effect is absent.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

_BINS = 1 << 14


@dataclass(frozen=True, eq=False)
class Curve:
    """Levels of a non-linear response, found by a bin and then by comparing: exact and fast."""

    levels_below: NDArray[np.uint16]
    next_level: NDArray[np.float32]
    most_in_bin: int

    @classmethod
    def of(cls, levels: NDArray[np.float64]) -> Curve:
        """Return the curve of `levels`, (M,) irradiances in ascending order."""
        edges = np.arange(_BINS + 1) / _BINS
        # float32 levels here and float32 irradiance there: one rounding decides on both sides.
        rounded = levels.astype(np.float32)
        below = np.searchsorted(rounded, edges.astype(np.float32), side="right")
        ahead = np.append(rounded, np.float32(np.inf))
        return cls(below[:-1].astype(np.uint16), ahead, int(np.diff(below).max()))

    def brightness(self, irradiance: NDArray[np.float32]) -> NDArray[np.uint16]:
        """Return how many levels are <= each irradiance (clipped to 0..1)."""
        inside = np.clip(irradiance, 0, np.float32(1))
        place = np.minimum((inside * np.float32(_BINS)).astype(np.intp), _BINS - 1)
        count = self.levels_below[place]
        for _ in range(self.most_in_bin):
            count += inside >= self.next_level[count]
        return count


Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]

_PHOTONS_PER_LUX_S_UM2 = 4091.0
"""Photons of 555 nm a second and square micrometre in one lux: 1 lx = 1/683 W/m^2 there, over
h c / wavelength = 3.579e-19 J, times 1e-12 m^2."""


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Lens(_Part):
    """What the light goes through before it is a photon in a pixel.

    Attributes:
        f_number, transmission: illuminance on the sensor is ``pi L T / (4 N^2)`` for luminance L
        vignetting: share of the light that the far corner loses; falls with the square of the
            distance from the middle (the first term of cos^4)
        glare: share of the light that is scattered widely, as in ISO 9358's veiling glare index
        glare_width: standard deviation of that scatter, share of the picture's longer side
        blur_px: standard deviation of the point spread, pixels
    """

    f_number: Positive = 4.0
    transmission: Annotated[float, Field(gt=0, le=1)] = 0.9
    vignetting: Annotated[float, Field(ge=0, lt=1)] = 0.0
    glare: Annotated[float, Field(ge=0, le=0.5)] = 0.0
    glare_width: Annotated[float, Field(gt=0, le=0.5)] = 0.06
    blur_px: Annotated[float, Field(ge=0, le=8)] = 0.0


class Dark(_Part):
    """Charge that comes without light.

    Attributes:
        current_e_s: electrons a pixel a second at `reference_c`
        temperature_c: of the sensor, degrees Celsius
        reference_c: where the rates below were measured
        doubling_k: the current doubles every so many kelvin (about 8 in silicon)
        hot_share: share of pixels that are hot
        hot_rate_e_s: largest rate of a hot pixel at `reference_c`; they are spread evenly below
    """

    current_e_s: NotNegative = 0.0
    temperature_c: Annotated[float, Field(ge=-200, le=150)] = 25.0
    reference_c: Annotated[float, Field(ge=-200, le=150)] = 25.0
    doubling_k: Positive = 8.0
    hot_share: Annotated[float, Field(ge=0, le=0.1)] = 0.0
    hot_rate_e_s: NotNegative = 0.0

    @property
    def warmth(self) -> float:
        """How many times the reference rates the rates at `temperature_c` are."""
        return math.exp2((self.temperature_c - self.reference_c) / self.doubling_k)

    @model_validator(mode="after")
    def _is_finite(self) -> Self:
        if abs(self.temperature_c - self.reference_c) / self.doubling_k > 100:
            raise ValueError("dark: temperature_c is more than 100 doublings from reference_c")
        return self


class Pixels(_Part):
    """Differences between pixels, and what passes from one to another.

    Attributes:
        pitch_um: side of a pixel, micrometres
        prnu: standard deviation of the sensitivity over the pixels (EMVA 1288 PRNU), share
        dsnu_e: standard deviation of the offset over the pixels (EMVA 1288 DSNU), electrons
        crosstalk: share of a pixel's light that goes to each of its four neighbours
        blooming: share of the charge beyond the well that flows along the column, half each way
        blooming_px: pixels that it reaches
        smear_s: seconds for which a pixel looks at its whole column's mean while charge is moved
        lag: share of the last frame's charge that is left in the pixel
    """

    pitch_um: Positive = 3.45
    prnu: Annotated[float, Field(ge=0, le=0.1)] = 0.0
    dsnu_e: NotNegative = 0.0
    crosstalk: Annotated[float, Field(ge=0, le=0.2)] = 0.0
    blooming: Share = 0.0
    blooming_px: Annotated[int, Field(ge=1, le=64)] = 12
    smear_s: NotNegative = 0.0
    lag: Annotated[float, Field(ge=0, le=0.5)] = 0.0


class ReadOut(_Part):
    """What reading adds to a frame, beside the read noise of each pixel.

    Attributes:
        row_noise_e: standard deviation of each row's offset, new in every frame, electrons
        column_noise_e: standard deviation of each column's offset, always the same, electrons
        row_s: seconds from the exposure of one row to that of the next; 0 is a global shutter
        nonlinearity_dn: bow of the ADC in the middle of its range, DN
        cosmic_rate_s: hits on a million pixels a second (0.002 at sea level for 3.45 um)
        cosmic_e: mean charge of a hit, electrons
    """

    row_noise_e: NotNegative = 0.0
    column_noise_e: NotNegative = 0.0
    row_s: NotNegative = 0.0
    nonlinearity_dn: NotNegative = 0.0
    cosmic_rate_s: NotNegative = 0.0
    cosmic_e: Positive = 1500.0


Matrix = tuple[
    tuple[NotNegative, NotNegative, NotNegative],
    tuple[NotNegative, NotNegative, NotNegative],
    tuple[NotNegative, NotNegative, NotNegative],
]


def photons_per_candela(lens: Lens, pixels: Pixels) -> float:
    """Return photons a pixel a second for a luminance of 1 cd/m^2 (as 555 nm light).

    Illuminance of a distant scene in the picture is ``pi L T / (4 N^2)`` lux.
    """
    illuminance = math.pi * lens.transmission / (4 * lens.f_number**2)
    return illuminance * _PHOTONS_PER_LUX_S_UM2 * pixels.pitch_um**2
