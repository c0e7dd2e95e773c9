"""The exact distribution of the sum of noisy frames at a known irradiance.

Photon noise and read noise are normal and arise before the camera's response and its quantiser: a
sample is at level k or above with the probability that the noisy irradiance is at or above level k.
Frames are clipped at black and white, and the distributions of the frames are convolved.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camctl.errors import UsageError
from camctl.model.convolution import LEAST_FOURIER, convolved
from camctl.model.effective import EffectiveCamera
from camctl.model.noise import FrameNoise
from camctl.model.response.camera import CameraResponse, FloatArray

MOST_LEVELS = 1024
"""Cameras of more levels are rated by fewer: the table of their sums would take seconds."""

_MOST_NOISE = 64.0
"""Largest read noise of a camera of up to `MOST_LEVELS`, levels; memory grows with it."""

MIN_ELECTRONS = 1e-3
"""Least electrons per level: far below any sensor, and its photon noise stays finite."""

NORMAL_REACH = 6.0
"""Standard deviations beyond which a normal probability counts as 0 (it is about 1e-9)."""

_NORMAL_STEPS = 1000
"""Steps of the table of normal probabilities for one standard deviation: errors are below 1e-7."""

_NORMAL_CDF = np.array(
    [
        0.5 * math.erfc(-x / math.sqrt(2))
        for x in (np.arange(2 * NORMAL_REACH * _NORMAL_STEPS + 2) / _NORMAL_STEPS - NORMAL_REACH)
    ]
)
_NORMAL_CDF[0], _NORMAL_CDF[-2:] = 0.0, 1.0
_NORMAL_RISE = np.diff(_NORMAL_CDF)

_LEAST_MERGED = 1.0
"""Noise in steps of the quantiser from which its phase no longer shows: frames with more of it, and
away from black and white, have a normal sum (the mean of a step is exact to 1e-9 of a step)."""

_MOST_TOGETHER = 1 << 16
"""Irradiances times frames that are looked at together: arrays of half a megabyte."""

_EVEN = 1e-6
"""Relative differences of the steps of a quantiser up to which they count as equal."""


def normal_cdf(x: FloatArray) -> FloatArray:
    """Return the normal distribution function, to 1e-7; 0 and 1 beyond `NORMAL_REACH`."""
    place = (x + NORMAL_REACH) * _NORMAL_STEPS
    np.minimum(np.maximum(place, 0, out=place), _NORMAL_RISE.size - 1, out=place)
    index = place.astype(np.intp)
    place -= index
    place *= _NORMAL_RISE[index]
    place += _NORMAL_CDF[index]
    return np.asarray(place)


def most_read_noise(response: CameraResponse) -> float:
    """Return the largest read noise of a camera in its levels.

    It is the same share of full scale for all cameras that are rated by `MOST_LEVELS`.
    """
    return _MOST_NOISE * max(1.0, (response.M + 1) / MOST_LEVELS)


def check_noise(noise: Sequence[FrameNoise], n: int, response: CameraResponse) -> None:
    """Raise `UsageError` unless there is a valid noise for each of `n` exposures."""
    if len(noise) != n:
        raise UsageError(
            f"invalid noise of {len(noise)} frames for {n} exposures: expected one for each"
        )
    most = most_read_noise(response)
    for frame in noise:
        if not 0 <= frame.read_noise_levels <= most:
            raise UsageError(
                f"invalid read noise of {frame.read_noise_levels:g} levels: expected 0 to {most:g}"
            )
        for name in ("dark_levels", "dsnu_levels", "prnu"):
            if not 0 <= getattr(frame, name) < math.inf:
                raise UsageError(
                    f"invalid {name} {getattr(frame, name):g}: expected a finite number >= 0"
                )
        if not frame.electrons_per_level >= MIN_ELECTRONS:
            raise UsageError(
                f"invalid number of electrons per level {frame.electrons_per_level:g}: expected at "
                f"least {MIN_ELECTRONS:g}"
            )


def quantiser_input(response: CameraResponse, E: FloatArray) -> FloatArray:
    """Return the analog signal at E in brightness levels: k at level k, linear in between."""
    levels, counts = response.steps
    height = np.cumsum(counts).astype(np.float64)
    if levels.size == 1:
        return np.asarray(height[0] * E / levels[0])
    first = (height[1] - height[0]) / (levels[1] - levels[0])
    last = (height[-1] - height[-2]) / (levels[-1] - levels[-2])
    inside = np.interp(E, levels, height)
    below = np.maximum(height[0] + first * (E - levels[0]), 0.0)
    above = height[-1] + last * (E - levels[-1])
    return np.where(levels[0] > E, below, np.where(levels[-1] < E, above, inside))


def deviation(response: CameraResponse, E: FloatArray, noise: FrameNoise) -> FloatArray:
    """Return the standard deviation of one frame in levels; E is at this frame's exposure."""
    full = response.M + 1
    of_light = np.sqrt(
        E / (noise.electrons_per_level * full) + (noise.read_noise_levels / full) ** 2
    )
    return response.slope(E) * of_light


@dataclass(frozen=True, eq=False)
class NoisyFrame:
    """One frame of a sum.

    Attributes:
        exposure: relative exposure
        noise: its noise
        full: levels of the linear scale at E = 1
        thresholds: irradiance of each step of a sample, from its lowest possible value up
        step: distance between neighbouring thresholds; 0 where they are not evenly spaced
    """

    exposure: float
    noise: FrameNoise
    full: float
    thresholds: FloatArray
    step: float

    @classmethod
    def of(cls, response: CameraResponse, exposure: float, noise: FrameNoise) -> NoisyFrame:
        """Return the frame; below its first level, thresholds continue at the first distance."""
        levels = response.levels
        first = levels[1] - levels[0] if levels.size > 1 else levels[0]
        below = levels[0] - first * np.arange(noise.black, 0, -1)
        thresholds = np.concatenate([below, levels])
        steps = np.diff(thresholds)
        even = steps.size > 0 and np.ptp(steps) <= _EVEN * steps[0]
        return cls(exposure, noise, response.M + 1.0, thresholds, float(even and steps.mean()))

    def signal(self, E: FloatArray, z: float) -> FloatArray:
        """Return the mean signal as irradiance, for an offset of `z` times the DSNU."""
        offset = self.noise.dark_levels + z * self.noise.dsnu_levels
        return self.exposure * E + offset / self.full

    def deviation(self, E: FloatArray) -> FloatArray:
        """Return the standard deviation of the signal."""
        photon = self.exposure * E / (self.noise.electrons_per_level * self.full)
        return np.sqrt(photon + (self.noise.read_noise_levels / self.full) ** 2)


class NoisySum:
    """The sum of noisy frames, black levels included: 0 is the least sum, `top` the largest.

    Args:
        camera: the effective camera
        noise: noise of each frame, in the order of `camera.exposures`

    Attributes:
        frames: those that differ
        counts: (F,) how many there are of each

    Raises:
        UsageError: there is not one noise for each exposure, or one is out of range
    """

    def __init__(self, camera: EffectiveCamera, noise: Sequence[FrameNoise]) -> None:
        check_noise(noise, len(camera.exposures), camera.response)
        self.camera = camera
        kinds = Counter(zip(camera.exposures, noise, strict=True))
        self.frames = [NoisyFrame.of(camera.response, *kind) for kind in kinds]
        self.counts = np.array(list(kinds.values()))
        self.black = sum(frame.black for frame in noise)
        self.top = camera.levels_total + self.black

    @property
    def is_exact(self) -> bool:
        """Whether no frame has noise: an irradiance has one sum."""
        return all(
            math.isinf(each.electrons_per_level)
            and not (each.read_noise_levels or each.dsnu_levels or each.dark_levels)
            for each in (frame.noise for frame in self.frames)
        )

    def clips_widely(self, E: FloatArray) -> NDArray[np.bool_]:
        """Return at which E (Q,) a wide distribution of a frame ends at black or at white.

        It is then convolved as a whole; elsewhere it counts as normal, at next to no cost.
        """
        found = np.zeros(E.size, dtype=bool)
        for frame in self.frames:
            x, reach = frame.signal(E, 0.0), NORMAL_REACH * frame.deviation(E)
            is_wide = 2 * reach > LEAST_FOURIER * frame.step
            for end in frame.thresholds[[0, -1]] if frame.step else ():
                found |= is_wide & (np.abs(x - end) < reach)
        return found

    def probabilities(
        self, E: FloatArray, firsts: NDArray[np.intp], z: float = 0.0
    ) -> Iterator[tuple[NDArray[np.intp], FloatArray]]:
        """Yield the smallest possible sum at each E of a part (q,), and the probabilities from it.

        The latter are (W, q), where W is the number of sums that the widest distribution needs:
        neighbouring E should be similar.

        Args:
            E: irradiances (Q,)
            firsts: where each part of them begins, ascending from 0
            z: the pixel's offset in units of the DSNU
        """
        together = max(1, _MOST_TOGETHER // len(self.frames))
        ends = np.append(firsts[1:], E.size)
        place = 0
        while place < firsts.size:
            begin = int(firsts[place])
            after = max(place + 1, int(np.searchsorted(ends, begin + together, "right")))
            yield from self._some(E[begin : ends[after - 1]], firsts[place:after] - begin, z)
            place = after

    def _some(
        self, E: FloatArray, firsts: NDArray[np.intp], z: float
    ) -> Iterator[tuple[NDArray[np.intp], FloatArray]]:
        """Yield what `probabilities` does, for all parts at once where frames need no convolution.

        A frame that is black or white in a part, or far from each threshold, adds its one value;
        the means and variances of frames whose quantiser is dithered add up.
        """
        x = np.array([frame.signal(E, z) for frame in self.frames])
        sigma = np.array([np.maximum(f.deviation(E), 1e-9 / f.full) for f in self.frames])
        low, high = (
            np.array(
                [
                    np.searchsorted(frame.thresholds, each, "right")
                    for frame, each in zip(self.frames, ends, strict=True)
                ]
            )
            for ends in (x - NORMAL_REACH * sigma, x + NORMAL_REACH * sigma)
        )
        step = np.array([[frame.step] for frame in self.frames])
        last = np.array([[frame.thresholds.size] for frame in self.frames])
        width = np.maximum.reduceat(high - low, firsts, axis=1) + 1
        unclipped = (np.minimum.reduceat(low, firsts, axis=1) > 0) & (
            np.maximum.reduceat(high, firsts, axis=1) < last
        )
        dithered = np.minimum.reduceat(sigma, firsts, axis=1) >= _LEAST_MERGED * step
        merged = (width > 1) & unclipped & (step > 0) & dithered
        sizes = np.diff(np.append(firsts, E.size))
        start = self.counts @ (low * np.repeat(width == 1, sizes, axis=1))
        weight = np.repeat(merged, sizes, axis=1) / np.where(step > 0, step, 1.0)
        first = np.array([[frame.thresholds[0]] for frame in self.frames])
        mean = self.counts @ ((x - first) * weight + 0.5 * (weight > 0))
        variance = self.counts @ (sigma * weight) ** 2
        variance += np.repeat(self.counts @ merged - 1, sizes) / 12
        for part, begin in enumerate(firsts.tolist()):
            q = slice(begin, begin + int(sizes[part]))
            at, found, counts = start[q], [np.ones((1, int(sizes[part])))], [1]
            for frame in np.flatnonzero((width[:, part] > 1) & ~merged[:, part]).tolist():
                ends = low[frame, q], high[frame, q]
                found.append(self._single(frame, x[frame, q], sigma[frame, q], *ends))
                counts.append(int(self.counts[frame]))
                at = at + counts[-1] * low[frame, q]
            if merged[:, part].any():
                least, single = _rounded_normal(mean[q], np.sqrt(variance[q]))
                at = at + least
                found.append(single)
                counts.append(1)
            least_sum, probability = convolved(found, counts)
            yield at + least_sum, probability

    def _single(
        self,
        place: int,
        x: FloatArray,
        sigma: FloatArray,
        low: NDArray[np.intp],
        high: NDArray[np.intp],
    ) -> FloatArray:
        """Return the probabilities of a frame's values from `low` to `high`, (W, q)."""
        thresholds = self.frames[place].thresholds
        index = low + np.arange(int((high - low).max()) + 2)[:, np.newaxis]
        next_threshold = thresholds[np.minimum(np.maximum(index - 1, 0), thresholds.size - 1)]
        above = normal_cdf((x - next_threshold) / sigma)
        above[0] = 1.0
        above[index > high] = 0.0
        return np.asarray(above[:-1] - above[1:])


def _rounded_normal(mean: FloatArray, sigma: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
    """Return the smallest integer (Q,) and the probabilities from it (W, Q) of rounded normals."""
    low = np.floor(mean - NORMAL_REACH * sigma).astype(np.intp)
    size = int(np.ceil(2 * NORMAL_REACH * sigma.max())) + 2
    edges = low - 0.5 + np.arange(size + 1)[:, np.newaxis]
    above = normal_cdf((mean - edges) / sigma)
    return low, above[:-1] - above[1:]
