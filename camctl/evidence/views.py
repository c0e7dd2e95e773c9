"""Which photographs do not show what the others show: another view or scene, or less sharp.

The fine structure of two photographs is compared within small patches, where it is the same
whatever their exposures are: the brightness of the longer exposure is turned into that of the
shorter one by equal ranks in their histograms, as in `camctl.evidence.alignment`, and
correlated with it.  A thing that moved has other structure, too, but only in its place: of another
view nearly all of the picture has another brightness, and of one out of focus none.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.patch_errors import LEAST_PATCHES
from camctl.evidence.patches import Patches
from camctl.evidence.unknown_response import deviating_patches
from camctl.findings import Finding
from camctl.model.sensor import JPEG_ERROR

#: Brightness up to which a sample of a photograph may be black, as a share of full scale.
_BLACK = 0.01
#: Samples on each side of a square that is averaged, against noise.
_POOLED = 2
#: Standard deviation of the brightness within a patch that is structure, share of full scale.
_STRUCTURE = 4 / 255
#: Two photographs show the same if the median correlation of their patches is at least this.
_SAME = 0.9
#: They show different views if not even a quarter of them have this one: three quarters may have
#: moved.
_BEST_OF_OTHER = 0.75
#: A photograph is less sharp if a brighter one has this factor of its contrast in three quarters of
#: their patches, or a darker one in half of them.
_SHARPER = 1.15
#: Where much is blurred, brightness deviates, too, but not even a quarter of the patches has the
#: first correlation with a brighter photograph, or the second one with a darker one, whose noise
#: makes it small: patches that no moving thing covers have it.
_BEST_WITH_BRIGHTER, _BEST_WITH_DARKER = 0.9, 0.95
#: Neighbouring patches that are one part of the picture, and how many of them can be compared.
_PART, _OF_PART = 6, 4
#: Share of the parts that have the expected brightness in another view, at most, and share of the
#: patches that do not where only the sharpness differs.
_AGREEING, _DEVIATING = 0.5, 0.03
#: Each photograph is compared with so many of the next brightness.
_NEXT = 4

_Floats = NDArray[np.float64]


class Likeness(NamedTuple):
    """How much the fine structure of a darker photograph resembles a brighter one.

    Attributes:
        correlation: median over the patches
        best: correlation that a quarter of them exceed
        contrast: quartiles of the contrast of patches over their contrast in the brighter one
        deviating: share of the patches that have another brightness than most; 0 where both show
            the same
        agreeing: share of the parts of the picture in which no patch has; likewise 1
    """

    correlation: float
    best: float
    contrast: tuple[float, float, float]
    deviating: float
    agreeing: float

    @property
    def is_same(self) -> bool:
        """Whether both show the same, equally sharp."""
        return self.correlation >= _SAME and self.contrast[1] <= _SHARPER

    @property
    def is_other(self) -> bool:
        """Whether they show different structure."""
        return self.best < _BEST_OF_OTHER

    @property
    def is_darker_less_sharp(self) -> bool:
        """Whether the darker one has less contrast all over it."""
        return self.contrast[2] < 1 / _SHARPER and self.deviating < _DEVIATING

    @property
    def is_brighter_less_sharp(self) -> bool:
        """Whether the brighter one has less contrast all over it."""
        return self.contrast[1] > _SHARPER and self.deviating < _DEVIATING


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
    order = sorted(range(len(patches)), key=lambda k: float(patches[k].mean()))
    planes = [
        [_Plane.of(plane, white) for plane in np.array_split(each, colours)] for each in patches
    ]
    found = {}
    for place, dark in enumerate(order):
        for bright in order[place + 1 : place + 1 + _NEXT]:
            compared = [
                _compared(*each, white) for each in zip(planes[dark], planes[bright], strict=True)
            ]
            deviations = partial(_deviations, patches[dark], patches[bright], colours, black, white)
            alike = _likeness(np.concatenate(compared, axis=1), deviations)
            if alike is not None:
                found[dark, bright] = alike
    return found


def unlike_others(found: Likenesses, count: int) -> dict[int, Finding]:
    """Return by position how photographs differ that do not show what most of `count` show.

    None does where it cannot be told which ones are right: more than half must be alike.
    """
    alike = _largest_group(count, [pair for pair, each in found.items() if each.is_same])
    if len(alike) <= count / 2:
        return {}
    result = {}
    for k in range(count):
        against = {pair: each for pair, each in found.items() if k in pair and alike & {*pair}}
        if k in alike or not against:
            continue
        agreeing = float(np.mean([each.agreeing for each in against.values()]))
        if agreeing < _AGREEING and all(each.is_other for each in against.values()):
            result[k] = Finding(code="other_view", frames=(k,), value=agreeing)
        elif _is_less_sharp(k, against):
            contrasts = (
                each.contrast[1] if pair[0] == k else 1 / max(each.contrast[1], 1e-9)
                for pair, each in against.items()
            )
            result[k] = Finding(code="blurred", frames=(k,), value=float(np.mean([*contrasts])))
    return result


def unlike_each_other(found: Likenesses, count: int) -> tuple[int, int] | None:
    """Return two of `count` photographs that differ, where most do not show what others show."""
    alike = _largest_group(count, [pair for pair, each in found.items() if each.is_same])
    if len(alike) > count / 2:
        return None
    # Those that have a part in common with one of a view show it, too, whatever moves in it.
    view = _largest_group(count, [pair for pair, each in found.items() if not each.is_other])
    others = [
        pair
        for pair, each in found.items()
        if each.agreeing < _AGREEING and len(view & {*pair}) < 2
    ]
    return min(others, key=lambda pair: found[pair].correlation, default=None)


def _is_less_sharp(k: int, against: Likenesses) -> bool:
    """Return whether photograph `k` is less sharp than the others of its pairs."""
    if all(
        each.is_darker_less_sharp if pair[0] == k else each.is_brighter_less_sharp
        for pair, each in against.items()
    ):
        return True
    brighter = [each for pair, each in against.items() if pair[0] == k]
    darker = [each for pair, each in against.items() if pair[1] == k]
    return (
        bool(brighter)
        and all(each.contrast[2] < 1 / _SHARPER for each in brighter)
        and all(each.best < _BEST_WITH_BRIGHTER for each in brighter)
        and all(each.best < _BEST_WITH_DARKER for each in darker)
        and all(each.contrast[0] > 0 for each in against.values())
    )


def _largest_group(count: int, links: Iterable[tuple[int, int]]) -> set[int]:
    """Return the most of `count` members that are linked to each other, one by one."""
    groups = [{each} for each in range(count)]
    for pair in links:
        first, second = (next(group for group in groups if k in group) for k in pair)
        if first is not second:
            first |= second
            groups = [group for group in groups if group is not second]
    return max(groups, key=len)


def _likeness(compared: _Floats, deviations: Callable[[], tuple[float, float]]) -> Likeness | None:
    """Return how much two photographs are alike; None: they show no fine structure in common.

    Args:
        compared: correlation and contrast of their patches, (2, patches)
        deviations: returns the shares of what deviates in brightness, and of what does not
    """
    correlations, contrasts = compared
    if correlations.size < LEAST_PATCHES:
        return None
    correlation, best = np.quantile(correlations, (0.5, 0.75)).tolist()
    low, middle, high = np.quantile(contrasts, (0.25, 0.5, 0.75)).tolist()
    alike = Likeness(correlation, best, (low, middle, high), 0.0, 1.0)
    if alike.is_same and high >= 1 / _SHARPER:
        return alike  # nothing is asked of the brightness of such a pair
    deviating, agreeing = deviations()
    return alike._replace(deviating=deviating, agreeing=agreeing)


def _deviations(
    dark: Patches, bright: Patches, colours: int, black: int, white: int
) -> tuple[float, float]:
    """Return the shares of patches that deviate, and of parts of the picture where none does."""
    deviating = deviating_patches(dark, bright, colours, black, white)
    means = [each.mean(axis=1).reshape(colours, -1).mean(axis=0) for each in (dark, bright)]
    seen = (means[0] > black + _BLACK * (white - black)) & (means[1] < (1 - JPEG_ERROR) * white)
    whole = seen.size - seen.size % _PART
    parts = [(each & seen)[:whole].reshape(-1, _PART).sum(axis=1) for each in (seen, deviating)]
    compared = parts[0] >= _OF_PART
    agreeing = parts[1][compared] == 0
    shares = [each.mean() if each.size else 0.0 for each in (deviating[seen], agreeing)]
    return float(shares[0]), float(shares[1])


@dataclass(frozen=True, eq=False)
class _Plane:
    """Patches of one colour of a photograph, and what each of its comparisons needs.

    Attributes:
        patches: of it
        is_lit, is_unsaturated: whether all samples of a patch are
        ranks: of each brightness, see `_ranks`
        structure: of each patch, see `_structure`
    """

    patches: Patches
    is_lit: NDArray[np.bool_]
    is_unsaturated: NDArray[np.bool_]
    ranks: _Floats
    structure: _Floats

    @classmethod
    def of(cls, patches: Patches, white: int) -> _Plane:
        """Return those of patches."""
        return cls(
            patches,
            patches.min(axis=1) > _BLACK * white,
            patches.max(axis=1) < (1 - JPEG_ERROR) * white,
            _ranks(patches, white),
            _structure(patches),
        )


def _compared(dark: _Plane, bright: _Plane, white: int) -> _Floats:
    """Return correlation and contrast of each patch that has structure, (2, patches)."""
    usable = bright.is_unsaturated & dark.is_lit
    if not usable.any():
        return np.empty((2, 0))
    matched = np.interp(bright.ranks, dark.ranks, np.arange(white + 1))
    seen, expected = dark.structure[usable], _structure(matched.take(bright.patches[usable]))
    variances = [np.mean(each**2, axis=1) for each in (seen, expected)]
    # Structure that only the darker one has may be its noise.
    has = variances[1] > (_STRUCTURE * white) ** 2
    common = np.mean(seen * expected, axis=1)[has]
    of_seen, of_expected = (each[has] for each in variances)
    size = np.sqrt(np.maximum(of_seen * of_expected, np.finfo(np.float64).tiny))
    return np.array((common / size, common / of_expected))


def _ranks(samples: Patches, white: int) -> _Floats:
    """Return the rank of each brightness among the samples, 0 to 1: the middle of equal ones."""
    counts = np.bincount(samples.ravel(), minlength=white + 1)
    return (np.cumsum(counts) - counts / 2) / samples.size


def _structure(patches: NDArray[Any]) -> _Floats:
    """Return means of small squares of each patch, without the mean of the patch."""
    side = math.isqrt(patches.shape[1])
    cut = side - side % _POOLED
    squares = patches.reshape(-1, side, side)[:, :cut, :cut]
    small = np.zeros((len(squares), cut // _POOLED, cut // _POOLED))
    for row in range(_POOLED):
        for column in range(_POOLED):
            small += squares[:, row::_POOLED, column::_POOLED]
    small = small.reshape(len(small), -1) / _POOLED**2
    return np.asarray(small - small.mean(axis=1, keepdims=True))
