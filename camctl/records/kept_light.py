"""The metered light of a capture or a series that is not complete: advice is asked for later."""

from __future__ import annotations

import math
from typing import Annotated, Self

import numpy as np
from pydantic import Field, PositiveFloat, model_validator

from camctl.evidence.ratio_check import ReportModel
from camctl.exposure.light import Light, Metering
from camctl.interface.controls import ExposureSetting

#: Steps of the histogram in a stop: 2.2 % each, far below the step of metering, 1 of 8 levels.
_STEPS = 32
#: Entries at most: the light of 64 stops.
_MOST = 64 * _STEPS


class KeptLight(ReportModel):
    """A `camctl.exposure.light.Light` in a report: irradiance in steps, and their shares."""

    metering: Metering
    last: ExposureSetting | None
    darkest: PositiveFloat
    brightest: PositiveFloat
    has_shadows: bool
    irradiance: Annotated[tuple[PositiveFloat, ...], Field(min_length=1, max_length=_MOST)]
    shares: tuple[Annotated[float, Field(ge=0, le=1)], ...]

    @model_validator(mode="after")
    def _check(self) -> Self:
        if len(self.shares) != len(self.irradiance) or not math.isclose(
            sum(self.shares), 1.0, rel_tol=1e-6
        ):
            raise ValueError("the shares of a histogram do not add up to 1")
        if any(np.diff(self.irradiance) <= 0):
            raise ValueError("the irradiance of a histogram does not ascend")
        return self

    @classmethod
    def of(cls, light: Light | None) -> Self | None:
        """Return a light as it is kept; None: there is none."""
        if light is None:
            return None
        step = np.floor(_STEPS * np.log2(light.irradiance)).astype(np.intp)
        step = np.maximum(step - step.max() + _MOST - 1, 0)
        shares = np.bincount(step, light.shares)
        irradiance = np.bincount(step, light.shares * light.irradiance)
        filled = shares > 0
        return cls(
            metering=light.metering,
            last=light.last,
            darkest=light.darkest,
            brightest=light.brightest,
            has_shadows=light.has_shadows,
            irradiance=tuple((irradiance[filled] / shares[filled]).tolist()),
            shares=tuple(shares[filled].tolist()),
        )

    @property
    def light(self) -> Light:
        """The light itself."""
        return Light(
            self.metering,
            np.array(self.irradiance),
            np.array(self.shares),
            self.darkest,
            self.brightest,
            self.last,
            self.has_shadows,
        )
