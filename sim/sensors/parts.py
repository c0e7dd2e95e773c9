"""Parts of a sensor beside its pixels' charge: lens, dark signal, pixel differences, reading.

The effect of a parameter that is left out or 0 is absent.
"""

from __future__ import annotations

import math
from typing import Annotated, Self

from pydantic import Field, model_validator

from camctl.sim.data_files import FileModel, NotNegative, NotTiny, Positive, Share

_MOST_DOUBLINGS = 60.0  # of a dark rate between two temperatures: 1e9 x 2^60 stays finite


class Lens(FileModel):
    """What changes the light in front of the sensor.

    Attributes:
        f_number, transmission: illuminance on the sensor is ``pi L T / (4 N^2)`` for luminance L
        vignetting: share of the light that the corner farthest from the middle loses; the loss
            grows with the square of the distance (the first term of cos^4)
        glare: share of the light that is scattered widely, as in ISO 9358's veiling glare index
        glare_width: standard deviation of that scatter, share of the picture's longer side
        blur_px: standard deviation of the point spread, pixels
        diffraction: whether the aperture spreads each point to an Airy disk, whose size follows
            from `f_number` and the pixels' pitch
        lateral_colour: share by which red is drawn larger than green, and blue smaller
    """

    f_number: Annotated[Positive, Field(ge=0.1, le=1e3)] = 4.0
    transmission: Annotated[float, Field(gt=0, le=1)] = 0.9
    vignetting: Annotated[float, Field(ge=0, lt=1)] = 0.0
    glare: Annotated[float, Field(ge=0, le=0.5)] = 0.0
    glare_width: Annotated[float, Field(ge=1e-6, le=0.5)] = 0.06
    blur_px: Annotated[NotNegative, Field(le=8), NotTiny] = 0.0
    diffraction: bool = False
    lateral_colour: Annotated[float, Field(ge=0, le=0.05)] = 0.0


class Dark(FileModel):
    """Charge that comes without light.

    Attributes:
        current_e_s: electrons a pixel a second at `reference_c`
        temperature_c: of the sensor, degrees Celsius
        reference_c: temperature at which the rates were measured, degrees Celsius
        doubling_k: the rates double every so many kelvin (about 8 in silicon)
        hot_share: share of pixels that are hot
        hot_rate_e_s: largest rate of a hot pixel at `reference_c`, electrons a second; the rates
            are spread evenly from 0 to it, or evenly in the logarithm
        hot_decades: over so many decades below the largest rate; 0 for evenly from 0
        dcnu_e_s: standard deviation of the rates over the pixels (EMVA 1288 DCNU) at `reference_c`,
            electrons a second
    """

    current_e_s: Annotated[NotNegative, Field(le=1e9)] = 0.0
    temperature_c: Annotated[float, Field(ge=-200, le=150)] = 25.0
    reference_c: Annotated[float, Field(ge=-200, le=150)] = 25.0
    doubling_k: Positive = 8.0
    hot_share: Annotated[float, Field(ge=0, le=0.1)] = 0.0
    hot_rate_e_s: Annotated[NotNegative, Field(le=1e9)] = 0.0
    hot_decades: Annotated[float, Field(ge=0, le=9)] = 0.0
    dcnu_e_s: Annotated[NotNegative, Field(le=1e9)] = 0.0

    @property
    def rate_factor(self) -> float:
        """Rates at `temperature_c` over the rates at `reference_c`."""
        return math.exp2((self.temperature_c - self.reference_c) / self.doubling_k)

    @model_validator(mode="after")
    def _check_doublings(self) -> Self:
        doublings = abs(self.temperature_c - self.reference_c) / self.doubling_k
        if doublings > _MOST_DOUBLINGS:
            raise ValueError(
                f"temperature_c is {doublings:g} doublings from reference_c: expected at most"
                f" {_MOST_DOUBLINGS:g}"
            )
        return self


class Pixels(FileModel):
    """Differences between pixels, and what passes from one to another.

    Attributes:
        pitch_um: side of a pixel, micrometres
        prnu: standard deviation of the sensitivity over the pixels (EMVA 1288 PRNU), share
        dsnu_e: standard deviation of the offset over the pixels (EMVA 1288 DSNU), electrons
        crosstalk: share of a pixel's light that goes to each of its four neighbours
        blooming: share of the charge beyond the well that flows along the column, half each way,
            and fills the wells that it meets; an anti-blooming drain takes the rest
        smear_s: seconds for which a pixel sees the mean of its column while charge is moved; CCDs
            only, since a CMOS sensor moves no charge
        lag: share of the charge of the frame before that stays in the pixel
    """

    pitch_um: Annotated[float, Field(ge=1e-3, le=1e4)] = 3.45
    prnu: Annotated[float, Field(ge=0, le=0.1)] = 0.0
    dsnu_e: Annotated[NotNegative, Field(le=1e9)] = 0.0
    crosstalk: Annotated[float, Field(ge=0, le=0.2)] = 0.0
    blooming: Share = 0.0
    smear_s: Annotated[NotNegative, Field(le=1e5)] = 0.0
    lag: Annotated[float, Field(ge=0, le=0.5)] = 0.0


class ReadOut(FileModel):
    """What reading adds to a frame, beside the read noise of each pixel.

    Attributes:
        row_noise_e: standard deviation of each row's offset, new in every frame, electrons
        column_noise_e: standard deviation of each column's offset, always the same, electrons
        pink_share: share of the variance of both that is 1/f noise along rows or columns; the rest
            is white
        adc_noise_e: standard deviation of the noise behind the amplifier, electrons at gain 1
        rts_share: share of pixels with a random telegraph signal
        rts_e: largest step of such a signal, electrons; the steps are spread evenly from 0 to it
        reset_s: seconds from the reset of a pixel to the reading of its reset level, for which
            light as bright as the sun fills that level; CMOS sensors only
        row_s: seconds from the exposure of one row to the next row; 0 is a global shutter
        nonlinearity_dn: bow of the ADC in the middle of its range, DN
        cosmic_rate_s: hits on a million pixels a second (0.002 at sea level for 3.45 um)
        cosmic_e: mean charge of a hit, electrons
    """

    row_noise_e: Annotated[NotNegative, Field(le=1e9)] = 0.0
    column_noise_e: Annotated[NotNegative, Field(le=1e9)] = 0.0
    pink_share: Share = 0.0
    adc_noise_e: Annotated[NotNegative, Field(le=1e9)] = 0.0
    rts_share: Annotated[float, Field(ge=0, le=0.1)] = 0.0
    rts_e: Annotated[NotNegative, Field(le=1e9)] = 0.0
    reset_s: Annotated[NotNegative, Field(le=1e-3)] = 0.0
    row_s: Annotated[NotNegative, Field(le=1e5)] = 0.0
    nonlinearity_dn: NotNegative = 0.0
    cosmic_rate_s: Annotated[NotNegative, Field(le=1e5)] = 0.0
    cosmic_e: Annotated[float, Field(gt=0, le=1e9)] = 1500.0
