"""Which photographs do not show what the others show: another view or scene, or less sharp.

The fine structure of two photographs is compared within small patches, where it is the same
whatever their exposures are: the brightness of the longer exposure is turned into that of the
shorter one by equal ranks in their histograms, as in `camctl.evidence.alignment`.  A photograph out
of focus has less of the fine structure than of the coarse structure.  A thing that moved has other
structure, and another brightness, but only in its place: of another view no part of the picture has
the brightness of the others, but by chance.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.explanation import NEAR
from camctl.evidence.patch_errors import LEAST_PATCHES, weighted_quantile
from camctl.evidence.patches import Patches
from camctl.evidence.ratio_check import MOST, SIGNIFICANCE
from camctl.evidence.unknown_response import deviating_patches
from camctl.findings import Finding
from camctl.model.quantiles import median
from camctl.model.sensor import FILE_OFFSET, JPEG_ERROR
from camctl.system.picture_operations import looked_up

#: Samples on each side of a square that is averaged, against noise.
_POOLED = 2
#: Standard deviation of the brightness within a patch that is structure, share of full scale.
_STRUCTURE = 4 / 255
#: Of another view nothing rests, and of the same one most: the limit is in the middle.
_LEAST_RESTING = MOST / 2
#: Photographs are equally sharp up to this factor between their contrasts.
_SHARPER = 1.15

_Floats = NDArray[np.float64]


class Likeness(NamedTuple):
    """How much the fine structure of a darker photograph resembles a brighter one.

    Attributes:
        common: contrast of the coarse structure of the brighter one that is in both, over that in
            it, as most patches show it: 0 where they show different structure
        sharpness: of the darker one over that of the brighter one, by the contrast of fine
            structure over that of coarse structure, and by this where it is above 1; NaN where
            patches that rest show none
        resting: share of the picture that has the brightness of the other one, and not by chance
    """

    common: float
    sharpness: float
    resting: float

    @property
    def is_same(self) -> bool:
        """Whether most of the picture rests, equally sharp."""
        return self.resting > MOST and 1 / _SHARPER <= self.sharpness <= _SHARPER

    @property
    def is_other(self) -> bool:
        """Whether they show another view, or another scene."""
        return self.resting < _LEAST_RESTING


Likenesses = dict[tuple[int, int], Likeness]
"""Those of the pairs of photographs that can be compared: darker and brighter one, by position."""


def likenesses(patches: Sequence[Patches], colours: int, black: int, white: int) -> Likenesses:
    """Return how much each photograph is like those of the next brightness.

    Args:
        patches: of each photograph, see `sample_patches`
        colours: planes that they are of
        black: brightness without light, DN
        white: brightness from which samples are saturated, DN
    """
    if not patches or math.isqrt(patches[0].shape[1]) < 2 * _POOLED:
        return {}  # too small to show structure
    order = sorted(range(len(patches)), key=lambda k: float(patches[k].mean()))
    planes = [
        [_Plane.of(plane, white) for plane in np.array_split(each, colours)] for each in patches
    ]
    found = {}
    for place, dark in enumerate(order):
        for bright in order[place + 1 : place + 1 + NEAR]:
            contrasts = _Contrasts.of(planes[dark], planes[bright], white)
            if contrasts.size < LEAST_PATCHES:
                continue
            alike = Likeness(contrasts.common, contrasts.sharpness(), 1.0)
            if not (contrasts.is_common() and alike.is_same):
                deviates = partial(
                    deviating_patches, patches[dark], colours=colours, black=black, white=white
                )
                moved = deviates(patches[bright])
                resting = _resting(planes[dark], planes[bright], moved, deviates)
                # Of patches that agree by chance the structure has nothing in common.
                by_chance = max(1 - resting / (1 - moved.mean()), 0.0) if resting else 1.0
                short, long = ([each.part(~moved) for each in planes[k]] for k in (dark, bright))
                sharpness = _Contrasts.of(short, long, white).sharpness(by_chance)
                alike = alike._replace(sharpness=sharpness, resting=resting)
            found[dark, bright] = alike
    return found


def _resting(
    dark: Sequence[_Plane],
    bright: Sequence[_Plane],
    moved: NDArray[np.bool_],
    deviates: Callable[[Patches], NDArray[np.bool_]],
) -> float:
    """Return the share of runs of patches in which none deviates, of as many as chance has not.

    Args:
        dark: planes of a photograph
        bright: of a brighter one
        moved: patches that deviate
        deviates: returns the patches that deviate in the darker photograph from others
    """
    lit = np.any([each.is_lit for each in dark], axis=0)
    unsaturated = np.any([each.is_unsaturated for each in bright], axis=0)
    half = moved.size // 2
    elsewhere = deviates(np.concatenate([np.roll(each.patches, half, axis=0) for each in bright]))
    seen = elsewhere[lit & np.roll(unsaturated, half)]
    chance = float(seen.mean()) if seen.size else 0.0
    compared = moved[lit & unsaturated]
    length = math.ceil(math.log(SIGNIFICANCE) / math.log1p(-chance)) if 0 < chance < 1 else 1
    runs = compared.size // length
    if not chance or not runs:
        return 1.0
    return 1 - float(compared[: runs * length].reshape(runs, length).any(axis=1).mean())


def unlike_others(found: Likenesses, count: int) -> dict[int, Finding]:
    """Return by position how photographs differ that do not show what most of `count` show.

    None does where it cannot be told which ones are right: more than half must be alike.
    """
    result = {}
    for k in range(count):
        others = [pair for pair, each in found.items() if each.is_same and k not in pair]
        alike = _largest_group(count, others)
        against = {pair: each for pair, each in found.items() if k in pair and alike & {*pair}}
        if len(alike) <= count / 2 or not against:
            continue
        common, resting = (
            float(np.mean([getattr(each, name) for each in against.values()]))
            for name in ("common", "resting")
        )
        sharpness = _sharpness(k, against)
        if resting < _LEAST_RESTING and common < MOST:
            result[k] = Finding(code="other_view", frames=(k,), value=resting)
        elif sharpness is not None and sharpness < 1 / _SHARPER:
            result[k] = Finding(code="blurred", frames=(k,), value=sharpness)
    return result


def _sharpness(k: int, against: Likenesses) -> float | None:
    """Return the sharpness of photograph `k` over that of the others of its pairs, at most.

    Brighter photographs decide where there are: in darker ones noise hides what they have more.
    """
    brighter = [each.sharpness for pair, each in against.items() if pair[0] == k]
    darker = [each for pair, each in against.items() if pair[1] == k]
    if brighter and any(each.is_same for each in darker):
        return None
    found = brighter or [1 / each.sharpness for each in darker]
    return None if any(map(math.isnan, found)) else max(found)


def unlike_each_other(found: Likenesses, count: int) -> tuple[int, int] | None:
    """Return two of `count` photographs that differ, where most do not show what others show."""
    alike = _largest_group(count, [pair for pair, each in found.items() if each.is_same])
    if len(alike) > count / 2:
        return None
    # Those that have a part in common with one of a view show it, too, whatever moves in it.
    view = _largest_group(count, [pair for pair, each in found.items() if not each.is_other])
    others = [pair for pair, each in found.items() if each.is_other and len(view & {*pair}) < 2]
    return min(others, key=lambda pair: found[pair].resting, default=None)


def _largest_group(count: int, links: Iterable[tuple[int, int]]) -> set[int]:
    """Return the most of `count` members that are linked to each other, one by one."""
    groups = [{each} for each in range(count)]
    for pair in links:
        first, second = (next(group for group in groups if k in group) for k in pair)
        if first is not second:
            first |= second
            groups = [group for group in groups if group is not second]
    return max(groups, key=len)


@dataclass(frozen=True, eq=False)
class _Plane:
    """Patches of one colour of a photograph, and what each of its comparisons needs.

    Attributes:
        patches: of it
        is_lit, is_unsaturated: whether all samples of a patch are
        ranks: of each brightness, see `_ranks`
        structure: of each patch, see `_structure`
        white: brightness from which samples are saturated, DN
    """

    patches: Patches
    is_lit: NDArray[np.bool_]
    is_unsaturated: NDArray[np.bool_]
    ranks: _Floats
    structure: tuple[_Floats, _Floats]
    white: int

    @classmethod
    def of(cls, patches: Patches, white: int) -> _Plane:
        """Return those of patches."""
        return cls(
            patches,
            patches.min(axis=1) > FILE_OFFSET / 255 * white,
            patches.max(axis=1) < (1 - JPEG_ERROR) * white,
            _ranks(patches, white),
            _structure(patches),
            white,
        )

    def part(self, kept: NDArray[np.bool_]) -> _Plane:
        """Return some of the patches."""
        return _Plane.of(self.patches[kept], self.white)


@dataclass(frozen=True, eq=False)
class _Contrasts:
    """Contrast of the patches of a photograph over that in a brighter one, by size of structure.

    Attributes:
        fine, coarse: of each patch that has such structure: the contrast, the variance of the
            structure in the brighter photograph, and that in this one, (3, N)
    """

    fine: _Floats
    coarse: _Floats

    @classmethod
    def of(cls, dark: Sequence[_Plane], bright: Sequence[_Plane], white: int) -> _Contrasts:
        """Compare the planes of two photographs."""
        found: list[list[_Floats]] = [[], []]
        for short, long in zip(dark, bright, strict=True):
            usable = np.flatnonzero(long.is_unsaturated & short.is_lit)
            matched = np.interp(long.ranks, short.ranks, np.arange(white + 1))
            expected = _structure(looked_up(matched, long.patches[usable]))
            for size, (one, other) in enumerate(zip(short.structure, expected, strict=True)):
                variance = np.mean(other**2, axis=(1, 2, 3, 4))
                # Structure that only the darker one has may be its noise.
                has = variance > (_STRUCTURE * white) ** 2
                seen = one[usable]
                both, own = (np.mean(seen * each, axis=(1, 2, 3, 4)) for each in (other, seen))
                found[size].append(np.array((both[has] / variance[has], variance[has], own[has])))
        return cls(*(np.concatenate(size, axis=1) for size in found))

    @property
    def size(self) -> int:
        """The least number of patches of a size of structure."""
        return min(len(self.fine.T), len(self.coarse.T))

    @cached_property
    def common(self) -> float:
        """The median contrast of coarse structure."""
        return median(self.coarse[0])

    def is_common(self) -> bool:
        """Return whether most of the variance of both is common to them, in most patches."""
        shares = []
        for contrast, variance, own in (self.fine, self.coarse):
            explained = np.square(contrast) * variance / np.maximum(own, 1e-12)
            shares.append(median(np.where(contrast > 0, explained, 0)))
        return min(shares) > MOST

    def sharpness(self, unlike: float = 0.0) -> float:
        """Return the contrast of fine structure over that of coarse structure, of 1 at most.

        Args:
            unlike: share of the patches of which the structure has nothing in common, 0 to 1
        """
        if self.size < LEAST_PATCHES or not 0 <= unlike < 1:
            return math.nan
        # Noise is the smaller a part of the structure, the more of it there is.
        fine, coarse = (
            weighted_quantile(each[0], each[1], (1 + unlike) / 2)
            for each in (self.fine, self.coarse)
        )
        more = max(self.common, 1.0)
        return max(fine, 0.0) / coarse * more if coarse > 0 else math.nan


def _ranks(samples: Patches, white: int) -> _Floats:
    """Return the rank of each brightness among the samples, 0 to 1: the middle of equal ones."""
    counts = np.bincount(samples.ravel(), minlength=white + 1)
    return (np.cumsum(counts) - counts / 2) / max(samples.size, 1)


def _structure(patches: NDArray[Any]) -> tuple[_Floats, _Floats]:
    """Return means of small squares without those of large ones, and these without the patch's.

    Both have the shape (patches, rows, small rows, columns, small columns) of squares.
    """
    side = math.isqrt(patches.shape[1])
    count = side // (2 * _POOLED)
    cut = 2 * _POOLED * count
    squares = patches.reshape(-1, side, side)[:, :cut, :cut]
    small = np.zeros((len(squares), 2 * count, 2 * count))
    for row in range(_POOLED):
        for column in range(_POOLED):
            small += squares[:, row::_POOLED, column::_POOLED]
    small = small.reshape(-1, count, 2, count, 2) / _POOLED**2
    pairs = small[..., :1] + small[..., 1:]  # `mean` along both axes takes 20 times as long
    large = (pairs[:, :, :1] + pairs[:, :, 1:]) / 4
    return small - large, large - large.mean(axis=(1, 3), keepdims=True)
