"""Ratios of the light in photographs, and what they say of exposures and of colours.

The brightest patches that neither of two photographs saturates say how many times as bright one is
as the other: in dark ones rounding and the lowest levels of a response make errors.  Neighbours in
brightness are compared, and only what differs by more than shutters and responses do counts, so
that small errors do not add up over a long series.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camctl.errors import DataError
from camctl.evidence.patches import Patches
from camctl.evidence.ratios import comparable_frames, estimate_ratios
from camctl.findings import Detail, Finding
from camctl.model.response.camera import FloatArray
from camctl.model.sensor import SensorModel
from camctl.photographs.camera import Photograph

#: Brightness that a patch has at least in the darker photograph, as shares of full scale: the first
#: one that leaves so large a share of the patches as one of the second numbers; and fewest patches.
_BRIGHT, _SHARES, _LEAST = (1 / 8, 1 / 16, 1 / 32, 1 / 64, 1 / 100), (0.1, 0.03, 0.005), 12
#: Error of the mean brightness of a patch, levels of 8 bits: rounding, black level, JPEG.
_ERROR = 0.5
#: Patches agree within this logarithm of a ratio and their error; of those compared so many do.
_ALIKE, _MAJORITY = 0.15, 0.6
#: Exposures are corrected by up to this factor, and a correction above the second number is named.
MOST_CORRECTED, _NOTABLE = 1.3, 0.03
STEADY = 0.6
"""Of the logarithm of the factor that counts, the share by which neighbours may differ."""
#: Factor of one colour against green from which it is another white balance.
_OTHER_COLOUR = 1.05
#: Largest error of a ratio of colours, logarithm: darker ones do not count, and with more than the
#: first one only a difference that is larger than the error does.
_SURE, _MOST_UNSURE = 0.08, 0.2
#: Planes of the colours that are compared with green, and its plane.
_COLOURS, _GREEN = {"red": 0, "blue": 2}, 1
#: Photographs whose colours must agree for each one whose do not.
_AGREE = 2


class PairRatio(NamedTuple):
    """The ratio of the light in two photographs.

    Attributes:
        log: logarithm of the light in the second over the light in the first
        error: largest error of it from rounding and black level
    """

    log: float
    error: float


def pair_ratio(first: Patches, second: Patches, scale: SensorModel) -> PairRatio | None:
    """Return the ratio of the light in most patches of two photographs; None: they do not show it.

    Args:
        first: patches of one photograph, see `sample_patches`
        second: of the other
        scale: irradiance of each brightness
    """
    span = scale.white - scale.black
    dim = np.full(len(first), np.inf)
    logs: NDArray[np.float64] = np.zeros(len(first))
    errors = np.zeros(len(first))
    for patches, sign in ((first, -1), (second, 1)):
        is_whole = patches.max(axis=1) <= scale.highest(None)
        mean = patches.mean(axis=1)
        dim = np.where(is_whole, np.minimum(dim, (mean - scale.black) / span), -1.0)
        light = np.maximum(scale.light[patches].mean(axis=1), scale.level / 1000)
        logs += sign * np.log(light)
        slope = scale.gap[np.rint(mean).astype(np.intp)] * span / 255
        errors += _ERROR * slope / light
    sets = [dim >= least for least in _BRIGHT]
    needed = [max(_LEAST, share * dim.size) for share in _SHARES]
    found = [use for least in needed for use in sets if np.count_nonzero(use) >= least]
    if not found:
        return None
    use = found[0]
    log, error = float(np.median(logs[use])), float(np.median(errors[use]))
    is_one = np.mean(np.abs(logs[use] - log) < _ALIKE + error) >= _MAJORITY
    return PairRatio(log, error) if is_one else None


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


def _runs(patches: Sequence[Patches], jump: Callable[[int, int], _Jump]) -> list[Run]:
    """Return the runs of photographs; `jump` returns jump and tolerance of a darker and a brighter.

    It returns None where the two cannot be compared.
    """
    order = sorted(range(len(patches)), key=lambda k: float(np.mean(patches[k])))
    runs = [Run(order[:1])]
    for dark, bright in pairwise(order):
        found = jump(dark, bright)
        if found is None:
            runs.append(Run([bright]))
            continue
        runs[-1].members.append(bright)
        runs[-1].jumps.append(found[0])
        runs[-1].tolerances.append(found[1])
    return runs


def exposure_runs(
    photographs: Sequence[Photograph], patches: Sequence[Patches], scale: SensorModel
) -> list[Run]:
    """Return the runs of photographs, whose light is expected to grow as their exposures.

    Args:
        photographs: with their exposures
        patches: samples of each, see `sample_patches`
        scale: irradiance of each brightness
    """

    def jump(dark: int, bright: int) -> _Jump:
        ratio = pair_ratio(patches[dark], patches[bright], scale)
        stated = math.log(photographs[bright].exposure / photographs[dark].exposure)
        return None if ratio is None else (ratio.log - stated, ratio.error)

    return _runs(patches, jump)


def neighbours_differ(
    photographs: Sequence[Photograph], patches: Sequence[Patches], scale: SensorModel
) -> float:
    """Return by how much neighbours in brightness differ from their exposures, in all.

    It is the sum of the magnitudes of logarithms.  Arguments as of `exposure_runs`.
    """
    jumps = [jump for run in exposure_runs(photographs, patches, scale) for jump in run.jumps]
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
    photographs: Sequence[Photograph], patches: Sequence[Patches], scale: SensorModel
) -> tuple[list[Photograph], list[Finding]]:
    """Return photographs with exposures estimated from their pixels, and what was changed.

    Shutters are not exact, and film is less sensitive in long exposures.  An exposure is changed
    where the stated one lies outside the 95 % interval of the estimate, by `MOST_CORRECTED` at
    most: what differs by more has a wrong label.  Arguments as of `exposure_runs`.
    """
    result, factors = list(photographs), dict[int, float]()
    shown = sorted(comparable_frames(patches, scale))
    stated = [photographs[k].exposure for k in shown]
    try:
        found = estimate_ratios([patches[k] for k in shown], stated, scale)
    except DataError:
        return result, []
    # The unit is the median one: two that contradict are not averaged.
    changes = np.array(found.exposures) / stated
    unit = float(np.sort(changes)[(changes.size - 1) // 2])
    for k, position in enumerate(shown):
        photograph, factor = photographs[position], float(changes[k]) / unit
        is_stated = found.low[k] <= stated[k] * unit <= found.high[k]
        if is_stated or abs(math.log(factor)) > math.log(MOST_CORRECTED):
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
    patches: Sequence[Patches], scales: Sequence[SensorModel]
) -> tuple[set[int], list[Finding]]:
    """Return the positions of photographs whose colours differ from most others; findings.

    The light of neighbours has the ratio of their exposures, in each colour.  Where it is
    larger in one colour than in green, one of the two has more of that colour: another white
    balance, or the light had another colour.  Where the set does not show which are right, there
    is a finding alone.

    Args:
        patches: of each photograph, of red, green and blue
        scales: irradiance of each brightness of these
    """
    limit = math.log(_OTHER_COLOUR)
    odd: dict[int, dict[str, float]] = {}
    notes = []
    for colour, plane in _COLOURS.items():
        for run in _colour_runs(patches, plane, scales):
            least = [max(STEADY * limit, each) for each in run.tolerances]
            errors = steady_errors(run.jumps, least)
            wrong = np.flatnonzero(np.abs(errors) > limit).tolist()
            remaining = np.abs(run.jumps - np.diff(errors))
            if not wrong or np.any(remaining > STEADY * limit):
                continue  # colours of a response that is not quite right differ everywhere
            if len(run.members) - len(wrong) >= _AGREE * len(wrong):
                for k in wrong:
                    odd.setdefault(run.members[k], {})[colour] = math.exp(float(errors[k]))
                continue
            ends = run.members[0], run.members[-1]
            most = math.exp(float(np.ptp(errors)))
            notes.append(_other_white_balance(ends, {colour: most}))
    certain = [_other_white_balance((k,), factors) for k, factors in odd.items()]
    return set(odd), certain + notes


def _other_white_balance(frames: tuple[int, ...], factors: dict[str, float]) -> Finding:
    details: dict[str, Detail] = {**factors}
    return Finding(
        code="other_white_balance", frames=frames, value=_largest(factors), details=details
    )


def _largest(factors: Mapping[Any, float]) -> float:
    """Return the factor that is farthest from 1."""
    return max(factors.values(), key=lambda factor: abs(math.log(factor)))


def _colour_runs(
    patches: Sequence[Patches], plane: int, scales: Sequence[SensorModel]
) -> list[Run]:
    """Return the runs of photographs, of which one colour is expected to grow as green does."""

    def jump(dark: int, bright: int) -> _Jump:
        both = [np.array_split(patches[k], len(scales)) for k in (dark, bright)]
        of_colour, of_green = (
            pair_ratio(both[0][each], both[1][each], scales[each]) for each in (plane, _GREEN)
        )
        if of_colour is None or of_green is None:
            return None
        error = of_colour.error + of_green.error
        if error > _MOST_UNSURE:
            return None
        difference = of_colour.log - of_green.log
        return difference if error <= _SURE or abs(difference) > error else 0.0, error

    return _runs(patches, jump)
