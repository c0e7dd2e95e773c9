"""Pairs of frames with one setting, reduced to what the estimate of a camera's noise needs.

The difference of two frames with one setting is noise alone: the scene, the pixels' fixed pattern
and the vignetting cancel.  Its variance is taken in small patches, so that a change of the light
between the frames, in the whole picture or in bands as of a lamp under a rolling shutter, does not
count as noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.calibration.intervals import certain
from camctl.calibration.light import check_size
from camctl.calibration.limits import MOST_MOVED
from camctl.errors import DataError
from camctl.evidence.patches import Patches, sample_patches
from camctl.interface.controls import ExposureSetting, Layout
from camctl.model.response.camera import FloatArray

#: Samples of a patch that reach white, as a share, from which it counts as saturated.
_SATURATED = 0.5
#: Patches whose relative change has at most this standard error are asked for it.
_CERTAIN = 0.01
#: Noise that leaves at least this variance is looked at for correlation, DN squared.
_LEAST_VARIANCE = 0.5
#: Fewest rows and columns of a colour: patches have two samples on a side then.
_LEAST_SIDE = 8


@dataclass(frozen=True, eq=False)
class PairPatches:
    """The patches of one colour of one pair of frames, (patches,) each; brightness above black.

    Attributes:
        mean: of both frames, DN
        variance: of the noise of one frame, with its quantisation, DN squared
        spread: of the mean of both frames within the patch: the scene, the fixed pattern, and half
            of `variance`, whose random error is independent; DN squared
        pattern: covariance of the frames without a plane through the patch: the fixed pattern,
            where the light is smooth, DN squared
        freedom: degrees of freedom of `variance`
    """

    mean: FloatArray
    variance: FloatArray
    spread: FloatArray
    pattern: FloatArray
    freedom: FloatArray

    @classmethod
    def joined(cls, parts: Sequence[PairPatches]) -> PairPatches:
        """Return the patches of several pairs or colours as one."""
        return cls(
            *(
                np.concatenate([getattr(part, field.name) for part in parts])
                for field in fields(cls)
            )
        )

    def shifted(self, by: FloatArray) -> PairPatches:
        """Return the patches with another mean."""
        return replace(self, mean=self.mean + by)

    def part(self, rows: NDArray[np.bool_] | NDArray[np.intp]) -> PairPatches:
        """Return some of the patches."""
        return PairPatches(*(getattr(self, field.name)[rows] for field in fields(self)))


@dataclass(frozen=True, eq=False)
class FramePair:
    """A pair of frames with one setting.

    Attributes:
        setting: of both frames
        channels: patches of each channel; the two greens of a mosaic are one channel
        change: relative change of the light from the first frame to the second one
        moved_share: share of the other patches whose light differs by more than that
        saturated_share: share of the patches that are saturated
        correlation: of the noise of neighbouring samples; None where there is too little noise
    """

    setting: ExposureSetting
    channels: dict[str, PairPatches]
    change: float
    moved_share: float
    saturated_share: float
    correlation: float | None


def channel_names(layout: Layout) -> tuple[str, ...]:
    """Return the channel of each plane of `Layout.planes`, such as ("R", "G", "G", "B")."""
    return tuple({Layout.MONO: "Y", Layout.RGB: "RGB"}.get(layout, layout.upper()))


def reduce_pair(
    first: NDArray[Any],
    second: NDArray[Any],
    setting: ExposureSetting,
    layout: Layout,
    limits: tuple[int, int],
) -> FramePair:
    """Return what the noise of a pair of frames is estimated from.

    Args:
        first: (rows, columns) or (rows, columns, 3)
        second: of the same size, with the same setting
        setting: of both
        layout: pixel layout
        limits: black and white level, DN

    Raises:
        DataError: the frames have different sizes, or are the same frame
    """
    if min(min(plane.shape) for plane in layout.planes(first)) < _LEAST_SIDE:
        raise DataError(
            "the frames are too small to measure noise in them", hint="take at least 16 x 16 pixels"
        )
    name = f"frame of {setting.time_s:.4g} s"
    check_size(second.shape, first.shape, f"the second {name}", "the first one")
    black, white = limits
    channels: dict[str, list[PairPatches]] = {}
    saturated, changes, products = [], [], []
    names = channel_names(layout)
    colours = [
        np.split(sample_patches(layout.planes(frame), white), len(names))
        for frame in (first, second)
    ]
    for name, a, b in zip(names, *colours, strict=True):
        is_saturated = np.mean((a >= white) | (b >= white), axis=1) > _SATURATED
        saturated.append(is_saturated)
        patches, change, product = _reduce(a, b, black)
        channels.setdefault(name, []).append(patches)
        changes.append(change[~is_saturated])
        products.append(product[~is_saturated])
    change = np.concatenate(changes)
    change = change[change[:, 1] < _CERTAIN]
    common = float(np.median(change[:, 0])) if change.size else 0.0
    moved = np.abs(change[:, 0] - common) > MOST_MOVED + certain(len(change)) * change[:, 1]
    return FramePair(
        setting,
        {name: PairPatches.joined(parts) for name, parts in channels.items()},
        common,
        float(np.mean(moved)) if change.size else 0.0,
        float(np.mean(np.concatenate(saturated))),
        _correlation(np.concatenate(products)),
    )


def _correlation(products: FloatArray) -> float | None:
    """Return the correlation of neighbours from their mean product and variance in each patch."""
    lag, variance = products[products[:, 1] >= _LEAST_VARIANCE].T
    # The median, since an object that moves shows in neighbours alike.
    return float(np.median(lag / variance)) if variance.size else None


def _reduce(a: Patches, b: Patches, black: int) -> tuple[PairPatches, FloatArray, FloatArray]:
    """Return the patches, and for each its change and the noise of its neighbouring samples.

    The change is relative, with its standard error; of the noise, the mean product of neighbours
    and the variance are returned.
    """
    samples = a.shape[1]
    side = round(samples**0.5)
    first, second = a.astype(np.float64) - black, b.astype(np.float64) - black
    level = (first + second) / 2
    mean = level.mean(axis=1)
    difference = second - first
    shift = difference.mean(axis=1)
    change = shift / np.maximum(mean, 1.0)
    difference -= shift[:, None]
    # A change of the light is in proportion to the brightness.
    error = np.sqrt(np.square(difference).mean(axis=1) / samples)
    is_changed = np.abs(shift) > certain(mean.size) * error
    difference -= (change * is_changed)[:, None] * (level - mean[:, None])
    freedom = samples - 1.0
    variance = np.square(difference).sum(axis=1) / (2 * freedom)
    spread = level.var(axis=1, ddof=1)
    lit = [each - each.mean(axis=1)[:, None] for each in (first, second)]
    plane = _planes(side)
    flat = [each - (each @ plane) @ plane.T for each in lit]
    pattern = (flat[0] * flat[1]).sum(axis=1) / (samples - 3)
    grid = difference.reshape(-1, side, side)
    # A patch without its mean has neighbours with a product of -variance / samples, on average.
    lag = (grid[:, :, 1:] * grid[:, :, :-1]).mean(axis=(1, 2)) / 2 + variance / samples
    patches = PairPatches(mean, variance, spread, pattern, np.full(mean.size, freedom))
    changes = np.stack([change, error / np.maximum(mean, 1.0)], axis=1)
    return patches, changes, np.stack([lag, variance], axis=1)


def _planes(side: int) -> FloatArray:
    """Return (samples, 2): slopes along rows and columns of a patch, of length 1."""
    slope = np.arange(side) - (side - 1) / 2
    both = np.stack([np.repeat(slope, side), np.tile(slope, side)], axis=1)
    return np.asarray(both / np.sqrt(np.square(both).sum(axis=0)))
