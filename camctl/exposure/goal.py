"""What a search minimises: the objective, with noise and exposure errors where they are stated."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from camctl.errors import UsageError, unknown_name
from camctl.exposure.desired import DesiredResponse
from camctl.exposure.effective import check_exposures, union_of_levels
from camctl.exposure.objective import check_objective, xi
from camctl.exposure.real import FloatArray, RealResponse

NOISE_KINDS: tuple[str, ...] = ("paper", "time", "aperture", "gain")
JITTER_DRAWS = 8


@dataclass(frozen=True)
class NoiseTerm:
    """The paper's equation 4: `weight` times V is added to xi.

    Attributes:
        sigma: standard deviation of one frame at exposure 1, in irradiance (1 is full scale)
        weight: c, in the unit of xi per squared irradiance
        kind: which V, for exposures e_1 = 1 <= e_2 ...:
            "paper": sigma^2 sum 1/e_j, as printed for a linear camera
            "time", "aperture": n sigma^2 / (sum e_j)^2, the variance that read noise leaves in the
            irradiance when light grows with e and read noise does not
            "gain": sigma^2 sum e_j^2 / (sum e_j)^2, where gain raises noise with the signal
    """

    sigma: float
    weight: float = 1.0
    kind: str = "paper"

    def __post_init__(self) -> None:
        if self.kind not in NOISE_KINDS:
            raise unknown_name("noise term", self.kind, NOISE_KINDS)
        for name in ("sigma", "weight"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise UsageError(f"noise {name} {value:g}", hint="give a number >= 0")

    def cost(self, exposures: FloatArray) -> FloatArray:
        """Return c V, (B,) from (B, n) exposures."""
        n = exposures.shape[1]
        if self.kind == "paper":
            share = (1 / exposures).sum(axis=1)
        elif self.kind == "gain":
            share = (exposures**2).sum(axis=1) / exposures.sum(axis=1) ** 2
        else:
            share = n / exposures.sum(axis=1) ** 2
        return np.asarray(self.weight * self.sigma**2 * share)


@dataclass(frozen=True)
class Goal:
    """The whole objective.

    Attributes:
        levels_wanted: G
        p: the norm, >= 1
        noise: the term c V, or None
        jitter: relative standard deviation with which exposures come out; xi is then the mean over
            `JITTER_DRAWS` fixed Gaussian draws in opposite pairs
    """

    levels_wanted: float
    p: float = 1.0
    noise: NoiseTerm | None = None
    jitter: float = 0.0

    def __post_init__(self) -> None:
        check_objective(self.levels_wanted, self.p)
        if not (math.isfinite(self.jitter) and 0 <= self.jitter <= 0.2):
            raise UsageError(
                f"exposure jitter {self.jitter:g}", hint="give a fraction from 0 to 0.2"
            )

    def draws(self, n: int) -> FloatArray:
        """Return (J, n) factors on the exposures to average over; (1, n) ones without jitter.

        The first exposure is the unit and stays; a common factor would only shift the base.
        """
        if self.jitter == 0:
            return np.ones((1, n))
        half = np.random.default_rng(20030616).standard_normal((JITTER_DRAWS // 2, 16))[:, :n]
        factors = np.exp(self.jitter * np.concatenate([half, -half]))
        return np.asarray(factors / factors[:, :1])

    def score(
        self, response: RealResponse, exposures: Sequence[float], desired: DesiredResponse
    ) -> float:
        """Return the objective exactly (float64); `exposures` ascending from 1."""
        values = np.array(check_exposures(exposures))
        factors = self.draws(values.size)
        total = sum(
            xi(
                union_of_levels(response.levels, values * factor),
                desired,
                self.levels_wanted,
                p=self.p,
            )
            for factor in factors
        )
        noise = 0.0 if self.noise is None else float(self.noise.cost(values[np.newaxis])[0])
        return total / len(factors) + noise
