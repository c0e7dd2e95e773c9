"""The exposures that photographs state against those that their pixels say.

Most of the photographs of a set state the right exposure.  Before the response is known, pixels say
exposures up to an exponent, and three photographs that agree are needed to tell which one does not;
with a response two are.  Neighbours in brightness are compared, and only what differs by more than
shutters and responses do counts: small errors do not add up over a long series.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations, pairwise

import numpy as np

from camctl.calibration.response import estimate_response
from camctl.calibration.response_labels import label_errors
from camctl.calibration.response_series import Series
from camctl.errors import DataError
from camctl.evidence.patches import LightScale, Patches
from camctl.model.response.camera import FloatArray
from camctl.photographs.checks import SAME_EXPOSURE, swapped_error
from camctl.photographs.photograph import MOST_CORRECTED, Photograph
from camctl.photographs.ratios import pair_ratio
from camctl.system.number_text import time_text

#: Factor by which a label is wrong if exposures are not corrected from the pixels, and errors of an
#: estimated response are none of theirs.
_WRONG_EXACT = 1.1
#: Factor of a first guess from which the exposures are estimated.
_SUSPECT = 1.15
STEADY = 0.6
"""Of the logarithm of the factor that counts, the share by which neighbours may differ."""
#: Photographs that must agree: without a response, and with one.
_AGREE_WITHOUT, _AGREE_WITH = 3, 2
#: Labels are swapped, and several photographs differ alike, up to this error of a logarithm.
_ALIKE = 0.15


@dataclass(frozen=True)
class LabelErrors:
    """What is wrong with the exposures that photographs state.

    Attributes:
        factors: by position, what the pixels say over what is stated, where it is wrong
        notes: one line each
        facts: what cannot be checked, one line each
    """

    factors: dict[int, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    facts: list[str] = field(default_factory=list)


def doubted_labels(series: Series) -> dict[int, float]:
    """Return, by position, by which factors exposures are wrong; without a known response.

    Empty where all are right, or where it cannot be told which are not.

    Raises:
        DataError: the labels of two photographs are swapped
    """
    return _doubted(series) or {}


def _doubted(series: Series) -> dict[int, float] | None:
    """Return the same; None where it cannot be told which are wrong."""
    shown = series.connected()
    if len(shown) <= _AGREE_WITHOUT:
        return None
    free = series.part(shown)
    logs = np.log(free.exposures)
    is_seen = np.ones(logs.size, np.bool_)
    try:
        free.guess_exposures()
        errors = label_errors(logs, np.log(free.exposures), is_seen)
        if np.abs(errors).max() < math.log(_SUSPECT):
            return {}
        free.exposures_are_stated = False
        found = estimate_response(free, is_scene_checked=False).exposures
    except DataError:
        return None
    limit = math.log(MOST_CORRECTED)
    jumps = np.diff(label_errors(logs, np.log(found), is_seen))
    errors = steady_errors(jumps, [STEADY * limit] * jumps.size)
    wrong = np.flatnonzero(np.abs(errors) > limit).tolist()
    if logs.size - len(wrong) < max(_AGREE_WITHOUT, len(wrong) + 1):
        return None
    _check_swapped(free.names, logs, errors, wrong)
    return {shown[k]: math.exp(errors[k]) for k in wrong}


def check_doubted(
    photographs: Sequence[Photograph], doubted: Mapping[int, float], series: Series
) -> None:
    """Check that no label is so wrong that a longer exposure would be the darker one.

    Raises:
        DataError: one is; names the photograph, what it states, and what its pixels say, or the
            two whose labels are swapped
    """
    brightness = [float(np.mean(each)) for each in series.patches]
    for k, factor in doubted.items():
        reverse = [
            other
            for other, each in enumerate(photographs)
            if other not in doubted
            and (photographs[k].exposure - each.exposure) * (brightness[k] - brightness[other]) < 0
        ]
        if not reverse:
            continue
        if len(reverse) == 1 and _agree_when_swapped(series, k, reverse[0]):
            raise swapped_error(photographs[k].name, photographs[reverse[0]].name)
        raise DataError(
            _wrong_label(photographs, k, factor, len(photographs) - len(doubted)),
            hint="correct it with --times, one for each file, or leave the file out",
        )


def _agree_when_swapped(series: Series, one: int, other: int) -> bool:
    """Return whether all exposures are right if two photographs have each other's."""
    swapped = series.part(range(len(series.exposures)))
    exposures = swapped.exposures
    exposures[one], exposures[other] = exposures[other], exposures[one]
    return _doubted(swapped) == {}


def wrong_labels(
    photographs: Sequence[Photograph],
    patches: Sequence[Patches],
    scale: LightScale,
    *,
    is_exact: bool,
    is_known: bool,
    is_assumed: bool = False,
) -> LabelErrors:
    """Return which photographs' pixels contradict the exposures that they state.

    Args:
        photographs: with the exposures that are used
        patches: samples of each
        scale: of the camera's response
        is_exact: the exposures were not corrected from the pixels
        is_known: the response is, and not estimated from the photographs with their exposures
        is_assumed: nothing says that the response is the right one: no photograph is named

    Raises:
        DataError: the labels of two photographs are swapped
    """
    limit = math.log(_WRONG_EXACT if is_exact and is_known else MOST_CORRECTED)
    least_agree = _AGREE_WITH if is_known else _AGREE_WITHOUT
    found = LabelErrors()
    for run in _runs(photographs, patches, scale):
        if len(run.members) == 1:
            found.facts.append(
                f"the exposure of {photographs[run.members[0]].name} is not checked: no part of it "
                "is well exposed in the photograph of the next brightness, too"
            )
        errors = steady_errors(run.jumps, [max(STEADY * limit, each) for each in run.tolerances])
        wrong = np.flatnonzero(np.abs(errors) > limit).tolist()
        agree = len(run.members) - len(wrong)
        members = [photographs[k] for k in run.members]
        if not wrong:
            continue
        if is_assumed:
            found.notes.append(
                f"the exposures of {', '.join(each.name for each in members)} contradict their "
                "pixels if the response is srgb, as is assumed: give --curve, or correct them"
            )
            continue
        names, stated = [each.name for each in members], [each.exposure for each in members]
        if is_known or agree >= least_agree:
            _check_swapped(names, np.log(stated), errors, wrong)
        if agree < least_agree or agree <= len(wrong):
            why = _why_unknown(len(members), len(photographs), is_known=is_known)
            found.notes.extend(_unknown(members, run.jumps, limit, why))
            continue
        found.factors.update({run.members[k]: math.exp(errors[k]) for k in wrong})
        found.notes.extend(_named(members, errors, wrong, is_exact=is_exact))
    return found


def neighbours_differ(
    photographs: Sequence[Photograph], patches: Sequence[Patches], scale: LightScale
) -> float:
    """Return by how much neighbours in brightness differ from their exposures, in all.

    It is the sum of the magnitudes of logarithms.  Arguments are those of `wrong_labels`.
    """
    jumps = [jump for run in _runs(photographs, patches, scale) for jump in run.jumps]
    return float(np.abs(jumps).sum())


@dataclass(frozen=True)
class Run:
    """Photographs of ascending brightness of which neighbours can be compared.

    Attributes:
        members: their positions
        jumps: logarithm of the ratio of light over that of exposures of each one and the one before
        tolerances: largest errors of these from rounding and black level
    """

    members: list[int]
    jumps: list[float] = field(default_factory=list)
    tolerances: list[float] = field(default_factory=list)


def _runs(
    photographs: Sequence[Photograph], patches: Sequence[Patches], scale: LightScale
) -> list[Run]:
    order = sorted(range(len(photographs)), key=lambda k: float(np.mean(patches[k])))
    runs = [Run(order[:1])]
    for dark, bright in pairwise(order):
        ratio = pair_ratio(patches[dark], patches[bright], scale)
        if ratio is None:
            runs.append(Run([bright]))
            continue
        stated = math.log(photographs[bright].exposure / photographs[dark].exposure)
        runs[-1].members.append(bright)
        runs[-1].jumps.append(ratio.log - stated)
        runs[-1].tolerances.append(ratio.error)
    return runs


def _named(
    photographs: Sequence[Photograph], errors: FloatArray, wrong: Sequence[int], *, is_exact: bool
) -> list[str]:
    """Return a line for each photograph that is wrong, or one where several differ alike."""
    if group := _changed_light(photographs, errors, wrong):
        return [f"{group}: {'they are left out' if is_exact else 'that is used'}"]
    agree = len(photographs) - len(wrong)
    what = "it is left out" if is_exact else "that is used"
    return [
        f"{_wrong_label(photographs, k, math.exp(errors[k]), agree)}: {what}; correct it with "
        "--times (or the light was different in it)"
        for k in wrong
    ]


def steady_errors(jumps: Sequence[float] | FloatArray, least: Sequence[float]) -> FloatArray:
    """Return the errors of neighbours whose differences are given.

    What differs from an earlier error by no more than `least` is equal to it: so small differences
    do not add up.  Where most labels are right, their unit gives the least sum of the errors'
    square roots.
    """
    errors = [0.0]
    for jump, step in zip(jumps, least, strict=True):
        error = errors[-1] + jump
        near = min((errors[-1], *errors), key=lambda each: abs(each - error))
        errors.append(near if abs(near - error) <= step else error)
    unit = min(errors, key=lambda each: float(np.sqrt(np.abs(np.subtract(errors, each))).sum()))
    return np.asarray(errors) - unit


def _wrong_label(
    photographs: Sequence[Photograph], position: int, factor: float, agree: int
) -> str:
    photograph = photographs[position]
    says = time_text(photograph.time_s * factor)
    much = f"{factor:.3g} times as long" if factor > 1 else f"{1 / factor:.3g} times as short"
    return (
        f"the exposure of {photograph.name} is wrong: it says {time_text(photograph.time_s)}, and "
        f"beside the {agree} photographs that agree its pixels say {says}, {much}"
        f"{_odd_iso(photographs, position, factor)}"
    )


def _odd_iso(photographs: Sequence[Photograph], position: int, factor: float) -> str:
    """Return what to say where the ISO speed of all others would make an exposure right."""
    photograph = photographs[position]
    others = {each.iso for k, each in enumerate(photographs) if k != position}
    if photograph.iso is None or len(others) != 1 or (iso := others.pop()) is None:
        return ""
    if iso == photograph.iso or abs(math.log(photograph.iso * factor / iso)) > _ALIKE:
        return ""
    return f", as with ISO {iso:g}, which the others state, in place of its ISO {photograph.iso:g}"


def _check_swapped(
    names: Sequence[str], logs: FloatArray, errors: FloatArray, wrong: Sequence[int]
) -> None:
    for one, other in combinations(wrong, 2):
        apart = float(logs[other] - logs[one])
        if abs(apart) < math.log(SAME_EXPOSURE):
            continue
        off = max(abs(float(errors[one]) - apart), abs(float(errors[other]) + apart))
        if off < _ALIKE * max(1.0, abs(apart)):
            raise swapped_error(names[one], names[other])


def _changed_light(
    photographs: Sequence[Photograph], errors: FloatArray, wrong: Sequence[int]
) -> str:
    """Return what to say where several photographs at one end differ alike; empty: they do not."""
    count = len(photographs)
    is_end = set(wrong) in (set(range(len(wrong))), set(range(count - len(wrong), count)))
    values = errors[list(wrong)]
    if len(wrong) < 2 or not is_end or float(np.ptp(values)) > _ALIKE:
        return ""
    names = ", ".join(photographs[k].name for k in wrong)
    return (
        f"{names} are all about {math.exp(float(np.median(values))):.3g} times as bright as their "
        "exposures say beside the others: the light or the aperture changed, or their exposures "
        "are wrong"
    )


def _why_unknown(members: int, photographs: int, *, is_known: bool) -> str:
    """Return why so many members of a run do not show which of their exposures is wrong."""
    if members == 2:
        others = "" if photographs == 2 else "they share no well exposed part with others, and "
        return f"{others}two photographs do not show which"
    if members <= _AGREE_WITHOUT and not is_known:
        return (
            "three photographs do not show which while the response is estimated from them: add "
            "some, or give --curve"
        )
    return "the set does not show which: as many say the one as the other"


def _unknown(
    photographs: Sequence[Photograph], jumps: Sequence[float], limit: float, why: str
) -> list[str]:
    """Return a line for each pair of neighbours that differs."""
    return [
        f"{bright.name} is {ratio * math.exp(jump):.3g} times as bright as {dark.name}, and its "
        f"exposure is {ratio:.3g} times as long: one of the two exposures is wrong, or the light "
        f"has changed ({why})"
        for (dark, bright), jump in zip(pairwise(photographs), jumps, strict=True)
        if abs(jump) > limit and (ratio := bright.exposure / dark.exposure)
    ]
