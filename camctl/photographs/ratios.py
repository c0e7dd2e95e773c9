"""Ratios of the light in photographs, and what they say of exposures and of colours.

The brightest patches that neither of two photographs saturates say how many times as bright one is
as the other: in dark ones rounding and the lowest levels of a response make errors.  Neighbours in
brightness are compared, and only what differs by more than shutters and responses do counts, so
that small errors do not add up over a long series.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camctl.calibration.limits import DARK
from camctl.errors import DataError
from camctl.evidence.patches import Patches
from camctl.evidence.ratios import estimate_comparable
from camctl.findings import Detail, Finding
from camctl.model.quantiles import median
from camctl.model.response.camera import FloatArray
from camctl.model.sensor import (
    BLACK_ERROR_LEVELS,
    ESTIMATED_RESPONSE_ERROR,
    FILE_OFFSET,
    SensorModel,
)
from camctl.photographs.camera import Photograph
from camctl.system.picture_operations import looked_up

#: Standard deviation of an error that patches of one brightness share, relative, lest one cell
#: decides.
_SCATTER = 0.02
#: Share of the expected variance that remains however well the cells agree: so large that the sky
#: of taipei, whose red changes by 2 levels between photographs, is no other white balance.
_LEAST_SHOWN = 0.2
#: Width of a cell of brightness, stops; fewest patches; standard deviations of the largest error,
#: which one of 2,000 comparisons exceeds.
_CELL, _LEAST, SIGMAS = 0.5, 12, 3.5
#: Patches agree within this logarithm of a ratio and their error; of those compared so many do.
_ALIKE, _MAJORITY = 0.15, 0.6
#: Exposures are corrected by up to this factor, and a correction above the second number is named.
MOST_CORRECTED, _NOTABLE = 1.3, 0.03
STEADY = 0.6
"""Of the logarithm of the factor that counts, the share by which neighbours may differ."""
#: Largest error of a ratio of colours, logarithm, with which it says anything; and with which it
#: says that colours change halfway.
_MOST_UNSURE, _SURE = 0.875, 0.14
#: Planes of the colours that are compared with green, and its plane.
_COLOURS, _GREEN = {"red": 0, "blue": 2}, 1
#: Photographs whose colours must agree for each one whose do not.
_AGREE = 2


class _Errors(NamedTuple):
    """Errors of photographs.

    Attributes:
        own: standard deviation of what patches of one brightness share, levels of 255
        offset: that of what all patches of a photograph share, levels of 255
        darkest: brightness from which on patches count, share of full scale
    """

    own: float
    offset: float
    darkest: float


_OF_LIGHT = _Errors(1.0, FILE_OFFSET, DARK)
#: Below, JPEG files of low quality change a colour by 3 to 4 levels (taipei, street2), a tenth of
#: it.
_OF_COLOURS = _OF_LIGHT._replace(darkest=1 / 8)


class PairRatio(NamedTuple):
    """The ratio of the light in two photographs.

    Attributes:
        log: logarithm of the light in the second over the light in the first
        error: largest error of it from rounding and black level
        of_curve: largest error of it from the response
    """

    log: float
    error: float
    of_curve: float


class _Seen(NamedTuple):
    """What the patches of a photograph show, (patches,) each.

    Attributes:
        brightness: above black, levels of 255
        is_whole: whether no sample is saturated
        log: logarithm of the light
        slope: d ln(light) / d(brightness), per level of 255
        of_curve: error of the logarithm from the response
    """

    brightness: FloatArray
    is_whole: NDArray[np.bool_]
    log: FloatArray
    slope: FloatArray
    of_curve: FloatArray

    @classmethod
    def of(cls, patches: Patches, scale: SensorModel) -> _Seen:
        """Look at patches, see `sample_patches`, by the irradiance of each brightness."""
        unit = (scale.white - scale.black) / 255
        mean = patches.mean(axis=1)
        light = np.maximum(looked_up(scale.light, patches).mean(axis=1), scale.level / 1000)
        level = np.rint(mean).astype(np.intp)
        return cls(
            (mean - scale.black) / unit,
            patches.max(axis=1) <= scale.highest(None),
            np.log(light),
            scale.gap[level] * unit / light,
            scale.deviation[level],
        )


def _pair_ratio(first: _Seen, second: _Seen, errors: _Errors) -> PairRatio | None:
    """Return the ratio of the light in most patches of two photographs; None: they do not show it.

    An offset b of the darker photograph changes the logarithm of the ratio of patches of one
    brightness (a cell) by b g, g = d ln(light) / d(brightness): cells of several brightnesses
    determine the ratio and b, and their scatter says how well.

    Args:
        first: one photograph
        second: the other
        errors: of both
    """
    dim = np.minimum(first.brightness, second.brightness)
    use = first.is_whole & second.is_whole & (dim > 255 * errors.darkest)
    if np.count_nonzero(use) < _LEAST:
        return None
    logs = (second.log - first.log)[use]
    slopes, of_curve = (
        np.hypot(*pair)[use]
        for pair in ((first.slope, second.slope), (first.of_curve, second.of_curve))
    )
    cell = np.log2(dim[use] / 255) // _CELL
    cells = [cell == each for each in np.unique(cell)]
    cells = [each for each in cells if np.count_nonzero(each) >= _LEAST / 2]
    if not cells:
        return None
    means, g = (np.array([median(each[of]) for of in cells]) for each in (logs, slopes))
    rows = np.stack([np.ones(g.size), g], axis=1)
    weights = 1 / (np.square(errors.own * g) + _SCATTER**2)
    prior = np.diag([0.0, errors.offset**-2.0])
    covariance = np.linalg.inv((rows.T * weights) @ rows + prior)
    found = covariance @ (rows.T @ (weights * means))
    residual = float(weights @ np.square(means - rows @ found))
    # What the cells show of their own errors, beside what is expected, which counts as a cell; a
    # sky of one colour has the same error in all of them.
    shown = max(_LEAST_SHOWN, (1 + residual) / g.size)
    covariance = np.linalg.inv((rows.T * weights / shown) @ rows + prior)
    log, error = float(found[0]), SIGMAS * math.sqrt(float(covariance[0, 0]))
    is_one = np.mean(np.abs(logs - log) < _ALIKE + 2 * errors.offset * slopes) >= _MAJORITY
    return PairRatio(log, error, SIGMAS * median(of_curve)) if is_one else None


@dataclass(frozen=True)
class Run:
    """Photographs of ascending brightness of which neighbours can be compared.

    Attributes:
        members: their positions
        jumps: by how much the logarithm of the ratio of each one and the one before differs from
            the expected one
        tolerances: largest errors of these from rounding and black level
    """

    members: list[int]
    jumps: list[float] = field(default_factory=list)
    tolerances: list[float] = field(default_factory=list)


_Jump = tuple[float, float] | None


def _ascending(patches: Sequence[Patches]) -> list[int]:
    """Return the positions of photographs, the darkest first."""
    return sorted(range(len(patches)), key=lambda k: float(np.mean(patches[k])))


def _neighbour_ratios(
    order: Sequence[int], patches: Sequence[Patches], scale: SensorModel, errors: _Errors
) -> list[PairRatio | None]:
    """Return the ratio of the light in each photograph but the first and the one before it."""
    seen = (_Seen.of(patches[k], scale) for k in order)
    return [_pair_ratio(dark, bright, errors) for dark, bright in pairwise(seen)]


def _runs(order: Sequence[int], jumps: Iterable[_Jump]) -> list[Run]:
    """Return the runs of photographs.

    Args:
        order: their positions, the darkest first
        jumps: jump and tolerance of each but the first against the one before; None: the two cannot
            be compared
    """
    runs = [Run([order[0]])]
    for bright, found in zip(order[1:], jumps, strict=True):
        if found is None:
            runs.append(Run([bright]))
            continue
        runs[-1].members.append(bright)
        runs[-1].jumps.append(found[0])
        runs[-1].tolerances.append(found[1])
    return runs


@dataclass(frozen=True)
class RatiosToDarker:
    """The light of photographs compared with that of the next darker one.

    Attributes:
        order: their positions, the darkest first
        ratios: of each but the first
    """

    order: list[int]
    ratios: list[PairRatio | None]

    @classmethod
    def of(cls, patches: Sequence[Patches], scale: SensorModel) -> RatiosToDarker:
        """Compare photographs.

        Args:
            patches: samples of each, see `sample_patches`
            scale: irradiance of each brightness
        """
        order = _ascending(patches)
        return cls(order, _neighbour_ratios(order, patches, scale, _OF_LIGHT))

    def runs(self, photographs: Sequence[Photograph]) -> list[Run]:
        """Return the runs of photographs, whose light is expected to grow as their exposures."""
        exposures = [photographs[k].exposure for k in self.order]

        def jump(ratio: PairRatio | None, dark: float, bright: float) -> _Jump:
            # Where the response is not known for most of what is compared, neither is the ratio.
            if ratio is None or not math.isfinite(ratio.of_curve):
                return None
            return ratio.log - math.log(bright / dark), ratio.error

        return _runs(self.order, map(jump, self.ratios, exposures, exposures[1:]))

    def differ(self, photographs: Sequence[Photograph]) -> float:
        """Return by how much neighbours differ from their exposures: the sum of the logarithms."""
        jumps = [jump for run in self.runs(photographs) for jump in run.jumps]
        return float(np.abs(jumps).sum())


def steady_errors(jumps: Sequence[float] | FloatArray, least: Sequence[float]) -> FloatArray:
    """Return the errors of neighbours whose differences are given.

    What differs from an earlier error by no more than `least` is equal to it: so small differences
    do not add up.  Where most are right, their unit gives the least sum of the errors' square
    roots.
    """
    errors = [0.0]
    for jump, step in zip(jumps, least, strict=True):
        error = errors[-1] + jump
        near = min((errors[-1], *errors), key=lambda each: abs(each - error))
        errors.append(near if abs(near - error) <= step else error)
    unit = min(errors, key=lambda each: float(np.sqrt(np.abs(np.subtract(errors, each))).sum()))
    return np.asarray(errors) - unit


def corrected_exposures(
    photographs: Sequence[Photograph],
    patches: Sequence[Patches],
    scale: SensorModel,
    most: float = MOST_CORRECTED,
) -> tuple[list[Photograph], list[Finding]]:
    """Return photographs with exposures estimated from their pixels, and what was changed.

    Shutters are not exact, and film is less sensitive in long exposures.  An exposure is changed
    where the stated one lies outside the 95 % interval of the estimate, by the factor `most` at
    most: what differs by more has a wrong label.

    Args:
        photographs: with their exposures
        patches: samples of each, see `sample_patches`
        scale: irradiance of each brightness
        most: the largest factor
    """
    result, factors = list(photographs), dict[int, float]()
    try:
        shown, found = estimate_comparable(patches, [each.exposure for each in photographs], scale)
    except DataError:
        return result, []
    stated = [photographs[k].exposure for k in shown]
    # The unit is the median one: two that contradict are not averaged.
    changes = np.array(found.exposures) / stated
    unit = float(np.sort(changes)[(changes.size - 1) // 2])
    for k, position in enumerate(shown):
        photograph, factor = photographs[position], float(changes[k]) / unit
        is_stated = found.low[k] <= stated[k] * unit <= found.high[k]
        if is_stated or abs(math.log(factor)) > math.log(most):
            continue
        result[position] = replace(photograph, time_s=photograph.time_s * factor)
        if abs(factor - 1) > _NOTABLE:
            factors[position] = factor
    if not factors:
        return result, []
    names = ", ".join(f"{photographs[k].name} {factor:.2f}" for k, factor in factors.items())
    value, details = _largest(factors), {"factors": names}
    return result, [
        Finding(code="exposure_corrected", frames=tuple(factors), value=value, details={**details})
    ]


def odd_colours(
    patches: Sequence[Patches], scales: Sequence[SensorModel], *, are_exact: bool = False
) -> tuple[set[int], list[Finding]]:
    """Return the positions of photographs whose colours differ from most others; findings.

    The light of neighbours has the ratio of their exposures, in each colour.  Where it is
    larger in one colour than in green, one of the two has more of that colour: another white
    balance, or the light had another colour.  Where the set does not show which are right, there
    is a finding alone.

    Args:
        patches: of each photograph, of red, green and blue
        scales: irradiance of each brightness of these
        are_exact: they are no JPEG files, and their response is stated
    """
    expected = _errors_of_numbers(scales[_GREEN]) if are_exact else _OF_COLOURS
    odd: dict[int, dict[str, float]] = {}
    notes = []
    order = _ascending(patches)
    planes = [np.array_split(each, len(scales)) for each in patches]
    ratios = [
        _neighbour_ratios(order, [each[plane] for each in planes], scale, expected)
        for plane, scale in enumerate(scales)
    ]
    for colour, plane in _COLOURS.items():
        is_alike = scales[plane] is scales[_GREEN]
        jumps = (
            _colour_jump(*each, is_alike=is_alike)
            for each in zip(ratios[plane], ratios[_GREEN], strict=True)
        )
        for run in _runs(order, jumps):
            errors = steady_errors(run.jumps, run.tolerances)
            wrong = np.flatnonzero(errors).tolist()
            remaining = np.abs(run.jumps - np.diff(errors))
            if not wrong or np.any(remaining > ESTIMATED_RESPONSE_ERROR):
                continue  # colours of a response that is not quite right differ everywhere
            if len(run.members) - len(wrong) >= _AGREE * len(wrong):
                if _are_certain(errors, run.tolerances):
                    for k in wrong:
                        odd.setdefault(run.members[k], {})[colour] = math.exp(float(errors[k]))
                    continue
            elif max(run.tolerances) > _SURE:
                continue  # dark ones have the colours of JPEG's errors
            ends = run.members[0], run.members[-1]
            most = math.exp(float(np.ptp(errors)))
            notes.append(_other_white_balance(ends, {colour: most}))
    certain = [_other_white_balance((k,), factors) for k, factors in odd.items()]
    return set(odd), certain + notes


def _are_certain(errors: FloatArray, tolerances: Sequence[float]) -> bool:
    """Return whether no neighbour of photographs at an end has the error instead of them.

    It would differ as much from the neighbour on its other side, which the tolerance must show.

    >>> errors = np.array([0.0, 0.0, -0.02])
    >>> _are_certain(errors, [0.015, 0.018]), _are_certain(errors, [0.022, 0.018])
    (True, False)
    """
    both = (errors, tolerances), (errors[::-1], tolerances[::-1])
    firsts = [(each, least, int(np.argmax(each == 0))) for each, least in both]
    return all(least[k] < abs(each[k - 1]) for each, least, k in firsts if 0 < k < len(least))


def _errors_of_numbers(scale: SensorModel) -> _Errors:
    """Return the errors of photographs whose numbers are rounded, as is their black level."""
    level = BLACK_ERROR_LEVELS * 255 / (scale.white - scale.black)
    return _Errors(level, level, DARK)


def _other_white_balance(frames: tuple[int, ...], factors: dict[str, float]) -> Finding:
    details: dict[str, Detail] = {**factors}
    return Finding(
        code="other_white_balance", frames=frames, value=_largest(factors), details=details
    )


def _largest(factors: Mapping[Any, float]) -> float:
    """Return the factor that is farthest from 1."""
    return max(factors.values(), key=lambda factor: abs(math.log(factor)))


def _colour_jump(
    of_colour: PairRatio | None, of_green: PairRatio | None, *, is_alike: bool
) -> _Jump:
    """Return by how much the light of a colour grows more than green does, and the tolerance.

    Args:
        of_colour: its ratio in two photographs; None: they do not show it
        of_green: that of green
        is_alike: whether both have one curve: else each has errors of its own
    """
    if of_colour is None or of_green is None:
        return None
    error = math.hypot(of_colour.error, of_green.error)
    if not is_alike:
        error = math.hypot(error, of_colour.of_curve, of_green.of_curve)
    if error > _MOST_UNSURE:
        return None
    difference = of_colour.log - of_green.log
    return difference if abs(difference) > error else 0.0, error
