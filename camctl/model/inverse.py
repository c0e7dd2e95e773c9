"""The inverse of the noisy sum: what each value of the sum says about the irradiance.

By Bayes' rule the probability of an irradiance after a sum was observed is the probability of that
sum at the irradiance (`NoisySum`) times a prior.  The prior is flat in u, the desired response,
over its range; below e_min its density is constant, down to no light, and above E = 1 small, up to
where every frame is saturated.  Without noise the posterior is flat over the gap of the sum: its
mean is the midpoint in u, and its standard deviation is the width of the gap / sqrt(12).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from camctl.model.distribution import NORMAL_REACH, NoisySum
from camctl.model.effective import EffectiveCamera
from camctl.model.noise import FrameNoise
from camctl.model.response.camera import FloatArray
from camctl.model.response.desired import DesiredResponse

LEAST_CHUNK, MOST_CHUNK, CHUNKS = 64, 512, 32
"""Nodes computed at once: a `CHUNKS`-th of all, within these limits.  Neighbouring nodes have
nearly the same sums, distant ones do not, so that few are computed at once where there are few."""

_CELL = 2.0
"""Width of a cell of the integration, in standard deviations of the noise: with half of that, the
effective levels differ by at most 0.02 %."""

_COARSEST = 1 / 128
"""Largest cell of the integration over u, as a share of 0 to 1; of the part below or above of the
range, which a narrow range makes far longer than 1, as a share of it."""

_CELLS_PER_GAP, _MOST_CELLS = 4, 1 << 15
"""Cells of a gap that is wider than the noise; fewer where there would be more than `_MOST_CELLS`
of them."""

_WIDE_GAP = 4.0
"""A gap wider than the noise times this is integrated from one of its ends to the other."""

_ABOVE_RANGE = 0.1
"""Prior density above E = 1, as a share of the density below.  The shortest exposure is metered so
that little light is there.  With it, 67 % and 96 % of the irradiances from 0.97 to 1 lie within
0.994 and 1.96 standard deviations, whether the scene has light above 1 or not; with 1, 72 % and
96 % do."""

_LEAST_SLOPE = 1e-6
"""Least slope of u that is continued outside of the range."""

_GAUSS_LEGENDRE = np.array([-1.0, 1.0]) / np.sqrt(3.0)
#: Nodes and weights for a normal variable; exact up to its fifth power.
_GAUSS_HERMITE = ((-np.sqrt(3.0), 1 / 6), (0.0, 2 / 3), (np.sqrt(3.0), 1 / 6))

_LEAST_KNOWN = 1e-12
"""Probability of a sum from which its posterior mean is computed."""

_KEPT = 4
"""Posteriors that are kept: of the three colours of a plan, and of one that it is compared with.
Each has as many megabytes as its sum has tens of thousands of values."""

_MOST_KEPT_LEVELS = 500_000
"""Levels of a camera up to which so many are kept, 50 MB each; of larger ones only the last is."""

_FIRST_DARK = 8
"""Cells above the lower end of the range, 16 standard deviations of the noise, up to which nodes
are looked at first for what sums say that it is dark."""

_NOTABLE_DSNU = 0.01
"""Share of the variance in the dark from which the offsets of the pixels are integrated over."""


@dataclass(frozen=True, eq=False)
class ExtendedResponse:
    """A desired response, continued as a straight line outside of its range: v(E) = u(E) inside."""

    desired: DesiredResponse
    slopes: tuple[float, float] = field(init=False)

    def __post_init__(self) -> None:
        ends = np.array([max(self.desired.e_min, np.finfo(float).tiny), 1.0])
        low, high = np.maximum(self.desired.slope(ends), _LEAST_SLOPE).tolist()
        object.__setattr__(self, "slopes", (low, high))

    def v(self, E: FloatArray) -> FloatArray:
        """Return v at E >= 0."""
        below = np.minimum(E - self.desired.e_min, 0.0)
        above = np.maximum(E - 1.0, 0.0)
        return (
            self.desired.u(E)
            + np.where(below < 0, below, 0.0) * self.slopes[0]
            + (above * self.slopes[1])
        )

    def slope(self, E: FloatArray) -> FloatArray:
        """Return dv/dE at E >= 0."""
        inside = self.desired.slope(np.clip(E, max(self.desired.e_min, np.finfo(float).tiny), 1.0))
        below, above = self.desired.e_min > E, E > 1
        return np.where(below, self.slopes[0], np.where(above, self.slopes[1], inside))

    def inverse(self, v: FloatArray) -> FloatArray:
        """Return E with v(E) = v."""
        inside = self.desired.inverse(np.clip(v, 0.0, 1.0))
        below = self.desired.e_min + v / self.slopes[0]
        return np.where(v < 0, below, np.where(v > 1, 1 + (v - 1) / self.slopes[1], inside))


@dataclass(frozen=True, eq=False)
class Inverse:
    """What each value of the sum says; arrays (top + 1,) are indexed by it, black included.

    Attributes:
        u: posterior mean of u for a prior within the range: the value of least mean square error
        E: irradiance at the posterior mean of u, for the prior that extends beyond the range
        deviation: root mean square error of `E`, irradiance
        dark: whether the light is below the desired range, or none is shown
        mse: mean square error of `u` over the range
    """

    u: FloatArray
    E: FloatArray
    deviation: FloatArray
    dark: NDArray[np.bool_]
    mse: float

    @property
    def effective_levels(self) -> float:
        """L = (12 mse)^(-1/2): the number of equal steps of u that would be as accurate."""
        return float((12 * self.mse) ** -0.5)


class Posterior:
    """The joint distribution of irradiance and noisy sum.

    Args:
        camera: the effective camera
        desired: the desired response, in which the prior is flat
        noise: noise of each frame, in the order of `camera.exposures`

    Raises:
        UsageError: there is not one noise for each exposure, or one is out of range
    """

    def __init__(
        self, camera: EffectiveCamera, desired: DesiredResponse, noise: Sequence[FrameNoise]
    ) -> None:
        self.sum = NoisySum(camera, noise)
        self.desired = desired
        self._response = ExtendedResponse(desired)
        self._prnu = max(frame.prnu for frame in noise)
        dsnu = sum(frame.dsnu_levels for frame in noise) ** 2
        other = sum(frame.read_noise_levels**2 + 1 / 12 for frame in noise)
        self._offsets = _GAUSS_HERMITE if dsnu > _NOTABLE_DSNU * other else ((0.0, 1.0),)

    @cached_property
    def _cells(self) -> FloatArray:
        """Edges of the cells of the integration, in v, ascending.

        They are as wide as the noise; a gap that is much wider has whole cells.
        """
        frames, levels = self.sum.frames, self.sum.camera.distinct
        least = min(frames, key=lambda frame: frame.exposure)
        white = np.array([least.thresholds[-1] / least.exposure])
        brightest = white + NORMAL_REACH * least.deviation(white) / least.exposure
        ends = np.array([0.0, self._response.desired.e_min, 1.0, max(1.0, float(brightest[0]))])
        E = _distinct([levels, ends])
        v = self._response.v(E)
        gap, middle = np.diff(v), (E[1:] + E[:-1]) / 2
        noise = np.maximum(_deviation(self.sum, middle), 1e-300) * gap / np.diff(E)
        per_gap = int(np.clip(_MOST_CELLS // E.size, 1, _CELLS_PER_GAP))
        wide = gap > _WIDE_GAP * noise
        count = np.where(wide, float(per_gap), 0.0)  # 0 in a gap that v does not resolve
        np.divide(gap, _CELL * noise, out=count, where=~wide & (noise > 0))
        # By E and not by v, which rounding puts beside 0 and 1 at the ends of a very narrow range.
        is_below, is_above = E[1:] <= self._response.desired.e_min, E[:-1] >= 1
        outside = np.where(is_below, -v[0], np.where(is_above, v[-1] - 1, 1.0))
        coarsest = _COARSEST * np.maximum(outside, 1.0)
        density = np.concatenate([[0.0], np.cumsum(np.maximum(count, gap / coarsest))])
        steps = np.linspace(0.0, density[-1], int(np.ceil(density[-1])) + 1)
        keep = np.zeros(E.size, dtype=bool)
        keep[:-1] |= wide
        keep[1:] |= wide
        edges = [np.interp(steps, density, v), v[keep], self._response.v(ends)]
        return _distinct(edges)

    @cached_property
    def _nodes(self) -> tuple[FloatArray, FloatArray]:
        """Nodes of v and their weights: two of Gauss and Legendre in each cell."""
        edges = self._cells
        half = np.diff(edges) / 2
        nodes = (edges[:-1] + half)[:, np.newaxis] + half[:, np.newaxis] * _GAUSS_LEGENDRE
        v = nodes.ravel()
        return v, np.repeat(half, 2) * np.where(v > 1, _ABOVE_RANGE, 1.0)

    def _joint(self, v: FloatArray) -> Iterator[tuple[slice, NDArray[np.intp], FloatArray]]:
        """Yield some nodes, sums (W, nodes) that each may have, and their probabilities."""
        chunk = int(np.clip(v.size // CHUNKS, LEAST_CHUNK, MOST_CHUNK))
        E = self._response.inverse(v)
        changes = np.flatnonzero(np.diff(self.sum.clips_widely(E))) + 1
        firsts = np.unique(np.append(np.arange(0, v.size, chunk), changes))
        ends = [*firsts[1:].tolist(), v.size]
        for z, weight in self._offsets:
            found = self.sum.probabilities(E, firsts, z)
            for first, last, (start, probability) in zip(firsts.tolist(), ends, found, strict=True):
                columns = start + np.arange(len(probability))[:, np.newaxis]
                yield slice(first, last), np.minimum(columns, self.sum.top), weight * probability

    def _totals(self, weights: FloatArray, v: FloatArray) -> FloatArray:
        """Return the sums of (m, nodes) weights x probability for each sum, (m, top + 1)."""
        found = np.zeros((len(weights), self.sum.top + 1))
        # Not as a product of dense matrices: they are nearly empty, and their product, which runs
        # on several cores, takes several times as much processor time.
        for part, columns, probability in self._joint(v):
            low = int(columns[0].min())
            places = (columns - low).ravel()
            for weight, total in zip(weights[:, part], found[:, low:], strict=True):
                added = np.bincount(places, (weight * probability).ravel())
                total[: added.size] += added
        return found

    @cached_property
    def _spread(self) -> FloatArray:
        """Mean square of v at each node that the sensitivities of the pixels add."""
        v, _ = self._nodes
        E = self._response.inverse(v)
        return np.asarray((self._prnu * E * self._response.slope(E)) ** 2)

    @cached_property
    def mse(self) -> float:
        """Mean square error of `Inverse.u` over the range, without the rest of the inverse."""
        if "inverse" in vars(self):
            return self.inverse.mse
        v, weight = self._nodes
        inside = (v > 0) & (v < 1)
        v, weight = v[inside], weight[inside]
        known, mean = self._totals(np.stack([weight, weight * v]), v)
        square = float(np.sum(weight * (v**2 + self._spread[inside])))
        within = known > _LEAST_KNOWN
        return square - float(np.sum(mean[within] ** 2 / known[within]))

    @cached_property
    def inverse(self) -> Inverse:
        """The inverse of the sum."""
        v, weight = self._nodes
        E = self._response.inverse(v)
        inside = np.where((v > 0) & (v < 1), weight, 0.0)
        square = weight * (1 + self._prnu**2) * E**2
        parts = [inside, inside * v, weight, weight * v, weight * E, square]
        found = self._totals(np.stack(parts), v)
        known = found[2] > _LEAST_KNOWN
        mean_v, mean_E, square_E = found[3:, known] / found[2, known]
        sums = np.arange(self.sum.top + 1)
        best = self._response.inverse(mean_v)
        variance = square_E - 2 * best * mean_E + best**2
        u = np.interp(sums, sums[known], np.clip(mean_v, 0.0, 1.0))
        within = found[0] > _LEAST_KNOWN
        u[within] = found[1, within] / found[0, within]
        E = np.interp(sums, sums[known], best)
        return Inverse(
            u=u,
            E=E,
            dark=(self.desired.e_min > E) | (sums <= self.sum.black),
            deviation=np.sqrt(np.maximum(np.interp(sums, sums[known], variance), 0.0)),
            mse=float(np.sum(inside * (v**2 + self._spread)) - np.sum(u * found[1])),
        )

    @cached_property
    def dark(self) -> NDArray[np.bool_]:
        """Which sums say that the light is below the desired range, or show none."""
        return self._darkness[0]

    @cached_property
    def _darkness(self) -> tuple[NDArray[np.bool_], float]:
        """The sums that are dark, and an irradiance from which none of them occurs.

        Without the rest of the inverse: light at v and more cannot have less than the least sum at
        v, so that what lower sums say follows from the darker nodes alone.
        """
        if self.sum.is_exact:
            return self._dark_gaps
        v, weight = self._nodes
        last = float(self._cells[int(np.searchsorted(self._cells, 0.0)) + _FIRST_DARK])
        while last < 1 and "inverse" not in vars(self):
            E = self._response.inverse(np.array([last]))
            least = self._least_sum(E)
            below = v < last
            known, mean = self._totals(np.stack([weight, weight * v])[:, below], v[below])
            sums = np.flatnonzero(known[:least] > _LEAST_KNOWN)
            lit = sums[mean[sums] >= 0]
            if lit.size and sums[-1] == lit[-1]:
                values = np.interp(np.arange(least), sums, mean[sums] / known[sums])
                found = np.zeros(self.sum.top + 1, np.bool_)
                found[:least] = values < 0
                found[: self.sum.black + 1] = True
                return found, float(E[0])
            last *= 2
        return self.inverse.dark, np.inf

    @property
    def _dark_gaps(self) -> tuple[NDArray[np.bool_], float]:
        """`_darkness` without noise: each sum says a gap, whose middle in v is below the range."""
        levels = self.sum.camera.distinct
        v = self._response.v(np.append(0.0, levels))
        last = max(int(np.searchsorted(v[1:] + v[:-1], 0.0)) - 1, 0)
        count = int(np.searchsorted(self.sum.camera.levels, levels[last]))
        return np.arange(self.sum.top + 1) <= self.sum.black + count, float(levels[last])

    def _least_sum(self, E: FloatArray) -> int:
        """Return the least sum that occurs at an irradiance, (1,)."""
        first = np.zeros(1, np.intp)
        found = (next(self.sum.probabilities(E, first, z))[0] for z, _ in self._offsets)
        return min(int(start[0]) for start in found)

    def dark_shares(self, E: FloatArray) -> FloatArray:
        """Return the probability at each ascending irradiance (Q,) that the sum is dark."""
        mask, lit = self._darkness
        shares, below = np.zeros(E.size), lit > E
        if below.any():
            shares[below] = self.shares(E[below], mask)
        return shares

    def errors(self, u: FloatArray) -> FloatArray:
        """Return the mean square error of `Inverse.u` at each of `u`, within 0 to 1, (Q,).

        Their mean over the range is `Inverse.mse`.
        """
        E = self.desired.inverse(u)
        found = np.asarray((self._prnu * E * self.desired.slope(E)) ** 2)
        for part, columns, probability in self._joint(u):
            difference = self.inverse.u[columns] - u[part]
            found[part] += np.sum(probability * difference**2, axis=0)
        return found

    def shares(self, E: FloatArray, marked: NDArray[np.bool_]) -> FloatArray:
        """Return the probability at each irradiance that the sum is one of those marked.

        Args:
            E: ascending irradiances, (Q,)
            marked: for each value of the sum, (top + 1,)
        """
        found = np.zeros(E.size)
        for part, columns, probability in self._joint(self._response.v(E)):
            found[part] += np.sum(probability * marked[columns], axis=0)
        return found


@dataclass(frozen=True)
class _Case:
    """What a posterior depends on: equal cases have equal posteriors."""

    levels: bytes
    exposures: tuple[float, ...]
    response: tuple[str, float]
    noise: tuple[FrameNoise, ...]
    camera: EffectiveCamera = field(compare=False)
    desired: DesiredResponse = field(compare=False)


@lru_cache(maxsize=_KEPT)
def _posterior(case: _Case) -> Posterior:
    return Posterior(case.camera, case.desired, case.noise)


@lru_cache(maxsize=1)
def _large_posterior(case: _Case) -> Posterior:
    return Posterior(case.camera, case.desired, case.noise)


def posterior_of(
    camera: EffectiveCamera, desired: DesiredResponse, noise: Sequence[FrameNoise]
) -> Posterior:
    """Return `Posterior(camera, desired, noise)`; the last ones are kept, with what they computed.

    A capture needs the same one for its plan, its verdict and its pictures.
    """
    is_large = camera.levels_total > _MOST_KEPT_LEVELS
    return (_large_posterior if is_large else _posterior)(
        _Case(
            levels=camera.response.levels.tobytes(),
            exposures=camera.exposures,
            response=(desired.key, desired.dynamic_range),
            noise=tuple(noise),
            camera=camera,
            desired=desired,
        )
    )


def _distinct(parts: list[FloatArray]) -> FloatArray:
    """Return the different numbers of ascending parts, ascending."""
    merged = np.concatenate(parts)
    merged.sort(kind="stable")  # merges sorted runs
    return np.asarray(merged[np.append(True, merged[1:] != merged[:-1])])


def _deviation(total: NoisySum, E: FloatArray) -> FloatArray:
    """Return the standard deviation of E by noise alone, from the frames not saturated at E.

    A frame is left out where its mean is 4 deviations above white.
    """
    rows = []
    for frame, count in zip(total.frames, total.counts.tolist(), strict=True):
        photon = 1 / (frame.noise.electrons_per_level * frame.full)
        read, white = (frame.noise.read_noise_levels / frame.full) ** 2, frame.thresholds[-1]
        # Where (x - white)^2 = 16 (photon x + read).
        last = white + 8 * photon + np.sqrt(64 * photon**2 + 16 * (photon * white + read))
        rows.append((last / frame.exposure, count * frame.exposure, photon, count * read))
    last, slope, photon, read = np.array(sorted(rows)).T
    sums = np.cumsum(np.stack([slope, slope * photon, read])[:, ::-1], axis=1)[:, ::-1]
    from_slope, from_photons, from_read = np.pad(sums, ((0, 0), (0, 1)))
    used = np.searchsorted(last, E, "right")
    slopes = np.where(used < last.size, from_slope[used], total.frames[0].exposure)
    return np.asarray(np.sqrt(from_photons[used] * E + from_read[used]) / slopes)
