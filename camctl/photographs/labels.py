"""The exposures that photographs state, against what their pixels show.

Most of the photographs of a set state the right exposure.  Before the response is known, pixels say
exposures up to an exponent, and three photographs that agree are needed to tell which one does not;
with a response two are.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations, pairwise

import numpy as np

from camctl.calibration.response.estimate import estimate_response
from camctl.calibration.response.labels import label_errors
from camctl.calibration.response.series import Series
from camctl.errors import DataError
from camctl.evidence.patches import Patches
from camctl.findings import Detail, Finding
from camctl.model.response.camera import FloatArray
from camctl.model.sensor import FILE_OFFSET
from camctl.photographs.camera import Photograph, at, detailed
from camctl.photographs.ratios import (
    MOST_CORRECTED,
    SIGMAS,
    STEADY,
    RatiosToDarker,
    steady_errors,
)

#: Factor by which a label is wrong if exposures are not corrected from the pixels, and the response
#: is not estimated.
_WRONG_EXACT = 1.1
#: Factor of a first guess from which the exposures are estimated.
_SUSPECT = 1.15
#: Photographs that must agree: without a response, and with one.
_AGREE_WITHOUT, _AGREE_WITH = 3, 2
#: Labels are swapped, and several photographs differ alike, up to this error of a logarithm.
_ALIKE = 0.15
_TIE = "tie"
SAME_EXPOSURE = 1.05
"""Exposures that differ by less than this factor have no order."""


@dataclass(frozen=True)
class LabelErrors:
    """What is wrong with the exposures that photographs state.

    Attributes:
        factors: by position, what the pixels say over what is stated, where it is wrong
        unclear: of all photographs, where so many contradict each other that none is proved wrong:
            beside the darkest, and as stated where the pixels do not show it
        notes: findings of what is wrong
        facts: findings of what cannot be checked
    """

    factors: dict[int, float] = field(default_factory=dict)
    unclear: dict[int, float] = field(default_factory=dict)
    notes: list[Finding] = field(default_factory=list)
    facts: list[Finding] = field(default_factory=list)


def check_reversed(
    photographs: Sequence[Photograph], patches: Sequence[Patches], full: int
) -> None:
    """Check that exposures and brightness are not in opposite orders: then no label is right.

    Neighbours count whose brightness differs by more than the offsets of their files may.

    Args:
        photographs: with the exposures that they state
        patches: samples of each
        full: brightness of saturation, levels

    Raises:
        DataError: they are
    """
    means = [float(each.mean()) * 255 / full for each in patches]
    by_label = sorted(range(len(photographs)), key=lambda k: photographs[k].exposure)
    steps = [means[longer] - means[shorter] for shorter, longer in pairwise(by_label)]
    clear = [step for step in steps if abs(step) > SIGMAS * math.sqrt(2) * FILE_OFFSET]
    if len(clear) > 1 and max(clear) < 0:
        raise DataError(
            "the exposures of the photographs are in the reverse order: the longer they are, the "
            "darker is the picture",
            hint="give the exposure times in seconds (1/30, and not 30), one for each file",
            remedies={"times": None},
        )


def doubted_labels(series: Series) -> dict[int, float]:
    """Return, by position, by which factors exposures are wrong; without a known response.

    Empty where all are right, or where too few agree to tell the unit of the others.  Those that
    agree need not be most: for a response the exposures of some to the others suffice.
    """
    shown = series.connected()
    if len(shown) <= _AGREE_WITHOUT:
        return {}
    free = series.part(shown)
    logs = np.log(free.exposures)
    is_seen = np.ones(logs.size, np.bool_)
    try:
        free.guess_exposures()
        errors = label_errors(logs, np.log(free.exposures), is_seen)
        if np.abs(errors).max() < math.log(_SUSPECT):
            return {}
        free.exposures_are_stated = False
        found = estimate_response(free, is_scene_checked=False, is_rough=True).exposures
    except DataError:
        return {}
    limit = math.log(MOST_CORRECTED)
    jumps = _jumps(np.diff(logs), np.diff(np.log(found)))
    errors = steady_errors(jumps, [STEADY * limit] * jumps.size)
    wrong = np.flatnonzero(np.abs(errors) > limit).tolist()
    if logs.size - len(wrong) < _AGREE_WITHOUT:
        return {}
    return {shown[k]: math.exp(errors[k]) for k in wrong}


def _jumps(stated: FloatArray, found: FloatArray) -> FloatArray:
    """Return by how much steps from each photograph to the next differ from those stated.

    Steps are logarithms, and `found` is known up to a factor of all: the one of a step with which
    the sum of the square roots is least.  Photographs of which every second one is wrong have right
    steps, and exposures that no line joins.
    """
    slopes = [b / a for a, b in zip(stated.tolist(), found.tolist(), strict=True) if a * b > 0]
    jumps = [found / slope - stated for slope in slopes]
    return min(jumps, key=lambda each: float(np.sqrt(np.abs(each)).sum()), default=found - stated)


def wrong_labels(
    photographs: Sequence[Photograph],
    ratios: RatiosToDarker,
    *,
    is_exact: bool,
    is_known: bool,
    is_assumed: bool = False,
) -> LabelErrors:
    """Return which photographs' pixels contradict the exposures that they state.

    Args:
        photographs: with the exposures that are used
        ratios: of their light
        is_exact: the exposures were not corrected from the pixels
        is_known: the response is, and not estimated from the photographs with their exposures
        is_assumed: nothing says that the response is the right one: no photograph is named
    """
    limit = math.log(_WRONG_EXACT if is_exact and is_known else MOST_CORRECTED)
    least_agree = _AGREE_WITH if is_known else _AGREE_WITHOUT
    found = LabelErrors()
    runs = ratios.runs(photographs)
    if alone := tuple(sorted(run.members[0] for run in runs if len(run.members) == 1)):
        found.facts.append(Finding(code="label_unchecked", frames=alone))
    carried = 0.0
    for run in runs:  # from dark to bright
        found.unclear.update(dict.fromkeys(run.members, math.exp(carried)))
        errors = steady_errors(run.jumps, [max(STEADY * limit, each) for each in run.tolerances])
        wrong = np.flatnonzero(np.abs(errors) > limit).tolist()
        agree = len(run.members) - len(wrong)
        if not wrong:
            continue
        if is_assumed:
            found.notes.append(
                Finding(
                    code="labels_contradict",
                    frames=tuple(run.members),
                    remedies={"curve": None, "times": None},
                )
            )
            continue
        members = [photographs[k] for k in run.members]
        if agree < least_agree or agree <= len(wrong):
            why = _why_unknown(len(members), len(photographs), is_known=is_known)
            contradicting = _contradicting(members, run.jumps, limit, why)
            if why == _TIE:
                beside = errors - errors[0] + carried
                found.unclear.update(zip(run.members, np.exp(beside).tolist(), strict=True))
                carried = float(beside[-1])
        else:
            found.factors.update({run.members[k]: math.exp(errors[k]) for k in wrong})
            contradicting = _named(members, errors, wrong, is_exact=is_exact)
        found.notes.extend(at(each, run.members) for each in contradicting)
    return found


def _named(
    photographs: Sequence[Photograph], errors: FloatArray, wrong: Sequence[int], *, is_exact: bool
) -> list[Finding]:
    """Return a finding for each photograph that is wrong, or one where several differ alike."""
    count, values = len(photographs), errors[list(wrong)]
    is_end = set(wrong) in (set(range(len(wrong))), set(range(count - len(wrong), count)))
    if len(wrong) > 1 and is_end and float(np.ptp(values)) <= _ALIKE:
        return [
            Finding(
                code="light_differs",
                frames=tuple(wrong),
                value=math.exp(float(np.median(values))),
                details={"left_out": is_exact},
            )
        ]
    swapped = _swapped([each.exposure for each in photographs], errors, wrong)
    found = [
        Finding(code="labels_swapped", frames=pair, remedies={"times": None}) for pair in swapped
    ]
    found += [
        _wrong_label(photographs, k, math.exp(errors[k]), count - len(wrong))
        for k in wrong
        if not any(k in pair for pair in swapped)
    ]
    return [detailed(each, left_out=is_exact) for each in found]


def _wrong_label(
    photographs: Sequence[Photograph], position: int, factor: float, agree: int
) -> Finding:
    """Return the finding of one exposure, beside so many that agree."""
    photograph = photographs[position]
    details: dict[str, Detail] = {
        "stated_s": photograph.time_s,
        "pixels_s": photograph.time_s * factor,
        "agree": agree,
    }
    others = {each.iso for k, each in enumerate(photographs) if k != position}
    iso = others.pop() if len(others) == 1 else None
    # The ISO speed of all others would make the exposure right.
    off = math.log(photograph.iso * factor / iso) if iso and photograph.iso else math.inf
    if iso and photograph.iso and iso != photograph.iso and abs(off) <= _ALIKE:
        details |= {"iso": photograph.iso, "iso_of_others": iso}
    return Finding(
        code="label_wrong",
        frames=(position,),
        value=factor,
        details=details,
        remedies={"times": None},
    )


def _swapped(
    stated: Sequence[float], errors: FloatArray, wrong: Sequence[int]
) -> list[tuple[int, int]]:
    """Return the pairs of photographs that have each other's exposure."""
    logs = np.log(stated)
    found = []
    for one, other in combinations(wrong, 2):
        apart = float(logs[other] - logs[one])
        off = max(abs(float(errors[one]) - apart), abs(float(errors[other]) + apart))
        is_clear = abs(apart) >= math.log(SAME_EXPOSURE)
        if is_clear and off < _ALIKE * max(1.0, abs(apart)):
            found.append((one, other))
    return found


def _why_unknown(members: int, photographs: int, *, is_known: bool) -> str:
    """Return why so many members of a run do not show which of their exposures is wrong."""
    if members == 2:
        return "two" if photographs == 2 else "apart"
    return "response" if members <= _AGREE_WITHOUT and not is_known else _TIE


def _contradicting(
    photographs: Sequence[Photograph], jumps: Sequence[float], limit: float, why: str
) -> list[Finding]:
    """Return a finding for each pair of neighbours that differs."""
    remedies: dict[str, Detail | None] = {"curve": None} if why == "response" else {"times": None}
    if why == _TIE:  # exposures and response are estimated together then
        remedies["labels"] = "pixels"
    return [
        Finding(
            code="labels_contradict",
            frames=(k + 1, k),  # the brighter one first
            value=math.exp(jump),
            details={"exposure": bright.exposure / dark.exposure, "why": why},
            remedies=remedies,
        )
        for k, ((dark, bright), jump) in enumerate(zip(pairwise(photographs), jumps, strict=True))
        if abs(jump) > limit
    ]
