"""The true ratios of exposures, estimated from the pixels of frames of one scene.

The logarithm of the light in patch p of frame k is x_k + z_p + b / L_kp: the logarithm of the
exposure, that of the patch's irradiance, and the error b of the black level.  All frames in which a
patch is well exposed count, not only neighbours.  The model is fitted by weighted least squares;
patches in which something moved lose their weight (Tukey's biweight).  A patch counts in a frame if
its mean is away from black and from saturation by the scatter of its samples: choosing
by the noisy value of a single sample would bias the ratio.  The exponent of a measured response has
an error that no frame shows: it stretches all x alike.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from camctl.errors import DataError
from camctl.evidence.patches import Patches, shared_rounding
from camctl.evidence.ratio_check import MOST
from camctl.evidence.ratio_fit import BLOCKS, RatioFit
from camctl.model.noise import FrameNoise
from camctl.model.quantiles import Z_95, median, student
from camctl.model.response.camera import FloatArray
from camctl.model.sensor import CLIPPING_SIGMAS, SensorModel
from camctl.system.picture_operations import looked_up

#: Fewer common patches do not connect two frames: with 16 a simulated bracket was refused whose
#: ratios 12 give within 0.3 %.
_LEAST_PATCHES = 12
#: Largest relative error of a patch from rounding in a curved response.
_LARGEST_BIAS = 5e-4
#: Relative error of a patch that neither noise nor rounding explain.
_FLOOR = 1e-3
#: Noise of a camera that does not state it, levels: more than rounding alone.
_UNKNOWN_NOISE = FrameNoise(math.inf, 1.0)
#: Scatter of the patches, over their predicted error, from which the scene counts as moving: it
#: is 1.0 to 1.2 at rest, and 22 to 153 where the estimates are wrong by 25 % and more (there, too).
_MOST_SCATTER = 20.0


@dataclass(frozen=True)
class RatioEstimates:
    """Estimated exposures of frames, relative to a reference frame.

    Attributes:
        exposures: of each frame, with the label of the reference frame
        low: lower ends of their 95 % confidence intervals relative to the reference
        high: upper ends
        reference: the frame that the others are compared with; its interval is empty
        moved: share of the patches that lost their weight, since something moved in them
        patches: number of patches that each frame shares with others
        half_widths: of the intervals of the logarithms, without the error of the exponent
        exponent_error: half the interval of the logarithm of a ratio of e, from the response's
    """

    exposures: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    reference: int
    moved: float
    patches: tuple[int, ...]
    half_widths: tuple[float, ...]
    exponent_error: float


def estimate_ratios(
    frames: Sequence[Patches],
    labels: Sequence[float],
    scale: SensorModel,
    noise: Sequence[FrameNoise] | None = None,
) -> RatioEstimates:
    """Estimate the exposures of frames of one scene.

    Args:
        frames: their patches, as `sample_patches` returns them
        labels: their stated exposures in any unit; only the reference's counts
        scale: the camera's
        noise: of each frame, in levels; None where it is unknown

    Raises:
        DataError: fewer than two frames, frames of different size, no light, nothing unsaturated,
            frames without common patches, or a scene that moved
    """
    return _estimated(_observed(frames, scale, noise), frames, labels, scale)


def estimate_comparable(
    frames: Sequence[Patches],
    labels: Sequence[float],
    scale: SensorModel,
    noise: Sequence[FrameNoise] | None = None,
) -> tuple[list[int], RatioEstimates]:
    """Return the positions of the frames that can be compared, in order, and their estimates.

    All are compared where none can be.  Arguments and errors as of `estimate_ratios`.
    """
    seen = _observed(frames, scale, noise)
    used = sorted(seen.comparable())
    if len(used) < 2:
        used = list(range(len(frames)))
    chosen = [frames[k] for k in used]
    return used, _estimated(seen.part(used), chosen, [labels[k] for k in used], scale)


def _observed(
    frames: Sequence[Patches], scale: SensorModel, noise: Sequence[FrameNoise] | None
) -> _Observations:
    """Return the light of the patches; `DataError` of one frame, or of frames of several sizes."""
    if len(frames) < 2:
        raise DataError("one frame has no exposure ratio", hint="take two frames at least")
    if len({frame.shape for frame in frames}) > 1:
        raise DataError("the frames have different sizes", hint="keep the camera's format fixed")
    return _Observations.of(frames, scale, noise)


def _estimated(
    seen: _Observations, frames: Sequence[Patches], labels: Sequence[float], scale: SensorModel
) -> RatioEstimates:
    """Return what `estimate_ratios` does, from the light of the patches."""
    weights = seen.weights(seen.light)
    _check_light(frames, weights, scale)
    logs = np.log(seen.light)
    reference, start = _connect(logs, weights > 0, labels)
    # Weights that follow the noise of a patch would bias its ratio: they come from the light that
    # all frames together predict.
    total = np.maximum(weights.sum(axis=1), 1e-300)
    predicted = np.exp(((logs - start) * weights).sum(axis=1) / total)[:, None] * np.exp(start)
    weights = seen.weights(predicted)
    fit = RatioFit(
        logs + seen.variance(predicted) / (2 * np.square(predicted)),
        weights,
        scale.level / predicted,
        reference,
    )
    differ = DataError(
        "the frames differ by more than their exposures: the scene, its light or the camera moved",
        hint="use a tripod, a scene that does not move, and light that does not flicker",
    )
    try:
        x, robust = fit.robust(start)
    except np.linalg.LinAlgError:  # no patch of a frame agrees with the other frames
        raise differ from None
    moved = float(np.mean(robust[fit.used] == 0))
    if moved > MOST or fit.scatter > _MOST_SCATTER:
        raise differ
    try:
        own = student(Z_95, BLOCKS - 1) * fit.standard_errors(robust)
    except np.linalg.LinAlgError:  # without one block of patches an exposure is unknown
        raise DataError(
            "a frame agrees with the others in one small place only: its exposure is not certain",
            hint="leave it out, or take frames whose exposures lie closer together",
        ) from None
    exponent = Z_95 * scale.exponent_error
    half = np.hypot(own, exponent * x)
    label = labels[reference]
    return RatioEstimates(
        exposures=tuple((label * np.exp(x)).tolist()),
        low=tuple((label * np.exp(x - half)).tolist()),
        high=tuple((label * np.exp(x + half)).tolist()),
        reference=reference,
        moved=moved,
        patches=tuple(np.count_nonzero(robust, axis=0).tolist()),
        half_widths=tuple(own.tolist()),
        exponent_error=exponent,
    )


def comparable_frames(
    frames: Sequence[Patches], scale: SensorModel, noise: Sequence[FrameNoise] | None = None
) -> set[int]:
    """Return the frames that can be compared with most others, directly or through others.

    Arguments as of `estimate_ratios`.
    """
    return _Observations.of(frames, scale, noise).comparable()


def _common_patches(usable: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return how many patches each two frames share, (frames, frames); 0 of a frame with itself."""
    common = usable.T.astype(np.int64) @ usable.astype(np.int64)
    np.fill_diagonal(common, 0)
    return common


@dataclass(frozen=True)
class _Observations:
    """The light of patches in frames, and its noise; arrays are (patches, frames).

    Attributes:
        light: mean of each patch, > 0
        usable: whether the patch is neither dark nor saturated in a frame
        least: least light that is not dark
        fixed: variance of `light` without photon noise
        shared: variance of the rounding error that patches share
        photons: variance of `light` per light, (frames,)
    """

    light: FloatArray
    usable: NDArray[np.bool_]
    least: FloatArray
    fixed: FloatArray
    shared: FloatArray
    photons: FloatArray

    @classmethod
    def of(
        cls, frames: Sequence[Patches], scale: SensorModel, noise: Sequence[FrameNoise] | None
    ) -> _Observations:
        """Return the light of all patches."""
        columns, photons = [], []
        limit = scale.light[scale.highest(None)] if noise is None else scale.full
        for frame, each in zip(frames, noise or [_UNKNOWN_NOISE] * len(frames), strict=True):
            values, mean = looked_up(scale.light, frame), frame.mean(axis=1)
            light = values.mean(axis=1)
            middle = np.clip(np.rint(mean).astype(np.intp), 0, scale.white)
            gap = np.maximum(scale.gap[middle], scale.level / 1000)
            read = (each.read_noise_levels * scale.level) ** 2
            photons.append(scale.level / each.electrons_per_level)
            sample = read + photons[-1] * np.maximum(light, 0.0)
            margin = CLIPPING_SIGMAS * np.maximum(values.std(axis=1), np.sqrt(sample))
            curved = scale.curvature[middle] * (sample / gap**2 + 1 / 12) / 2
            least = np.full(len(light), 4 * scale.level)
            if not scale.black:
                least = margin + 1.5 * scale.gap[1]
            usable = (
                (light + margin <= limit)
                & (light >= least / 2)
                & (mean - CLIPPING_SIGMAS * frame.std(axis=1) > 0)
                & (curved <= _LARGEST_BIAS * light)
            )
            fixed = (read + gap**2 / 12) / frame.shape[1]
            shared = shared_rounding(frame, middle, sample, gap)
            columns.append((np.where(usable, light, 1.0), usable, least, fixed, shared))
        light, usable, least, fixed, shared = (
            np.stack(column, axis=1) for column in zip(*columns, strict=True)
        )
        return cls(light, usable, least, fixed, shared, np.array(photons) / frames[0].shape[1])

    def part(self, frames: Sequence[int]) -> _Observations:
        """Return those of some of the frames."""
        if len(frames) == len(self.photons):
            return self
        used = list(frames)
        names = (each.name for each in fields(self))
        return _Observations(*(getattr(self, name)[..., used] for name in names))

    def comparable(self) -> set[int]:
        """Return the frames that can be compared with most others, see `comparable_frames`."""
        common = _common_patches(self.weights(self.light) > 0)
        found: set[int] = set()
        added = {int(np.argmax(common.max(axis=0)))}
        while added:
            found |= added
            near = np.flatnonzero((common[sorted(added)] >= _LEAST_PATCHES).any(axis=0))
            added = set(near.tolist()) - found
        return found

    def variance(self, light: FloatArray) -> FloatArray:
        """Return the variance of the mean of patches with this light, without shared errors."""
        return self.fixed + self.photons * light

    def weights(self, light: FloatArray) -> FloatArray:
        """Return 1 / variance of the logarithm of patches with this light; 0: not usable."""
        variance = (self.variance(light) + self.shared) / np.square(light) + _FLOOR**2
        return np.where(self.usable & (light >= self.least), 1 / variance, 0.0)


def _check_light(frames: Sequence[Patches], weights: FloatArray, scale: SensorModel) -> None:
    """Raise `DataError` if no frame is well exposed anywhere."""
    if np.count_nonzero(weights.any(axis=1)) >= _LEAST_PATCHES:
        return
    brightest = max(float(frame.mean()) for frame in frames)
    darkest = min(float(frame.mean()) for frame in frames)
    if (brightest - scale.black) < 0.01 * (scale.white - scale.black):
        raise DataError("the frames are black", hint="take the lens cap off, or expose longer")
    if darkest > scale.highest(None):
        raise DataError(
            "the frames are saturated everywhere", hint="expose shorter, or close the aperture"
        )
    raise DataError(
        "no part of the frames is well exposed", hint="point the camera at an evenly lit surface"
    )


def _connect(
    logs: FloatArray, usable: NDArray[np.bool_], labels: Sequence[float]
) -> tuple[int, FloatArray]:
    """Return the reference frame, and first estimates of the logarithms of all exposures.

    Frames are connected one by one, each through the most patches that it shares with one already
    connected.
    """
    common = _common_patches(usable)
    reference = int(np.argmax(common.max(axis=0)))
    x = np.zeros(len(labels))
    connected = [reference]
    while len(connected) < len(labels):
        rest = [k for k in range(len(labels)) if k not in connected]
        one, other = max(((i, k) for i in connected for k in rest), key=lambda pair: common[pair])
        if common[one, other] < _LEAST_PATCHES:
            other = min(rest, key=lambda k: abs(math.log(labels[k] / labels[one])))
            one = min(connected, key=lambda i: abs(math.log(labels[i] / labels[other])))
            raise DataError(
                f"frames {one + 1} and {other + 1} have no common pixels that are well exposed: "
                f"their exposures are {labels[one]:.4g} and {labels[other]:.4g}",
                hint="add exposures between them",
            )
        both = usable[:, one] & usable[:, other]
        x[other] = x[one] + median(logs[both, other] - logs[both, one])
        connected.append(other)
    return reference, x
