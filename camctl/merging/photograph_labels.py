"""The exposures that photographs state against those that their pixels say.

Most of the photographs of a set state the right exposure.  Before the response is known, pixels say
exposures up to an exponent, and three photographs that agree are needed to tell which one does not;
with a response two are.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations, pairwise

import numpy as np

from camctl.calibration.response import estimate_response
from camctl.calibration.response_labels import label_errors
from camctl.calibration.response_series import Series
from camctl.captures.exposure_check import NeighbourCheck, lamp_factor
from camctl.captures.photograph_checks import SAME_EXPOSURE, swapped_error
from camctl.captures.photographs import MOST_CORRECTED, Photograph
from camctl.errors import DataError
from camctl.exposure.patches import LightScale, Patches
from camctl.exposure.ratios import estimate_ratios
from camctl.number_text import time_text
from camctl.response.camera import FloatArray

#: Factor by which a label is wrong if exposures are not corrected from the pixels.
_WRONG_EXACT = 1.1
#: Factor of a first guess from which the exposures are estimated.
_SUSPECT = 1.15
#: Photographs that must agree: without a response, and with one.
_AGREE_WITHOUT, _AGREE_WITH = 3, 2
#: Labels are swapped, and several photographs differ alike, up to this error of a logarithm.
_ALIKE = 0.15


def doubted_labels(series: Series) -> dict[int, float]:
    """Return, by position, by which factors exposures are wrong; without a known response.

    Empty where all are right, or where it cannot be told which are not.

    Raises:
        DataError: the labels of two photographs are swapped
    """
    if len(series.exposures) <= _AGREE_WITHOUT:
        return {}
    logs = np.log(series.exposures)
    free = replace(series, exposures=list(series.exposures), notes=[])
    is_seen = np.ones(logs.size, np.bool_)
    try:
        free.guess_exposures()
        errors = label_errors(logs, np.log(free.exposures), is_seen)
        if np.abs(errors).max() < math.log(_SUSPECT):
            return {}
        free.exposures_are_stated = False
        found = estimate_response(free, is_scene_checked=False).exposures
    except DataError:
        return {}
    errors = label_errors(logs, np.log(found), is_seen)
    wrong = np.flatnonzero(np.abs(errors) > math.log(MOST_CORRECTED)).tolist()
    if logs.size - len(wrong) < max(_AGREE_WITHOUT, len(wrong) + 1):
        return {}
    _check_swapped(series.names, logs, errors, wrong)
    return {k: math.exp(errors[k]) for k in wrong}


def check_doubted(
    photographs: Sequence[Photograph], doubted: Mapping[int, float], patches: Sequence[Patches]
) -> None:
    """Check that no label is so wrong that a longer exposure would be the darker one.

    Raises:
        DataError: one is; names the photograph, what it states, and what its pixels say
    """
    brightness = [float(np.mean(each)) for each in patches]
    for k, factor in doubted.items():
        for other, each in enumerate(photographs):
            longer = photographs[k].exposure - each.exposure
            if other not in doubted and longer * (brightness[k] - brightness[other]) < 0:
                count = len(photographs) - len(doubted)
                raise DataError(
                    _wrong_label(photographs[k], factor, count),
                    hint="correct it with --times, one for each file, or leave the file out",
                )


def wrong_labels(
    photographs: Sequence[Photograph],
    patches: Sequence[Patches],
    scale: LightScale,
    check: NeighbourCheck,
    *,
    is_exact: bool,
    is_known: bool,
) -> list[str]:
    """Return a line for each photograph whose pixels contradict the exposure that it states.

    Args:
        photographs: with the exposures that are used
        patches: samples of each
        scale: of the camera's response
        check: likewise
        is_exact: the exposures were not corrected from the pixels
        is_known: the response is, and not estimated from the photographs with their exposures

    Raises:
        DataError: the labels of two photographs are swapped
    """
    stated = np.array([each.exposure for each in photographs])
    try:
        found = np.log(estimate_ratios(patches, stated.tolist(), scale).exposures / stated)
    except DataError:
        return _wrong_pairs(photographs, patches, check)
    # Where most labels are right, their unit gives the least sum of the errors' square roots.
    unit = min(found.tolist(), key=lambda each: float(np.sqrt(np.abs(found - each)).sum()))
    errors = found - unit
    limit = math.log(_WRONG_EXACT if is_exact else MOST_CORRECTED)
    wrong = np.flatnonzero(np.abs(errors) > limit).tolist()
    agree = len(photographs) - len(wrong)
    if not wrong:
        return []
    if agree < (_AGREE_WITH if is_known else _AGREE_WITHOUT) or agree <= len(wrong):
        return _wrong_pairs(photographs, patches, check) or [
            f"the exposures of {', '.join(each.name for each in photographs)} contradict their "
            "pixels: one is wrong, or the light has changed (the set does not show which)"
        ]
    _check_swapped([each.name for each in photographs], np.log(stated), errors, wrong)
    if group := _changed_light(photographs, errors, wrong):
        return [group]
    return [
        f"{_wrong_label(photographs[k], math.exp(errors[k]), agree)}: correct it with --times, or "
        "leave the file out (or the light was different in it)"
        for k in wrong
    ]


def _wrong_label(photograph: Photograph, factor: float, agree: int) -> str:
    says = time_text(photograph.time_s * factor)
    much = f"{factor:.3g} times as long" if factor > 1 else f"{1 / factor:.3g} times as short"
    return (
        f"the exposure of {photograph.name} is wrong: it says {time_text(photograph.time_s)}, and "
        f"beside the {agree} photographs that agree its pixels say {says}, {much}"
    )


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
    order = sorted(range(len(photographs)), key=lambda k: photographs[k].exposure)
    is_end = set(order[: len(wrong)]) == set(wrong) or set(order[-len(wrong) :]) == set(wrong)
    values = errors[list(wrong)]
    if len(wrong) < 2 or not is_end or float(np.ptp(values)) > _ALIKE:
        return ""
    names = ", ".join(photographs[k].name for k in order if k in wrong)
    return (
        f"{names} are all about {math.exp(float(np.median(values))):.3g} times as bright as their "
        "exposures say beside the others: the light or the aperture changed, or their exposures "
        "are wrong"
    )


def _wrong_pairs(
    photographs: Sequence[Photograph], patches: Sequence[Patches], check: NeighbourCheck
) -> list[str]:
    """Return a line for each pair of neighbours whose brightness contradicts their exposures."""
    order = sorted(range(len(photographs)), key=lambda k: photographs[k].exposure)
    found = []
    for one, other in pairwise(order):
        before, after = photographs[one], photographs[other]
        result = check.compare(
            patches[one],
            patches[other],
            after.exposure / before.exposure,
            lamp_factor((before.time_s, after.time_s), None),
        )
        if result.contradicts and result.is_of_whole_picture and result.measured is not None:
            found.append(
                f"{after.name} is {result.measured:.3g} times as bright as {before.name}, and its "
                f"exposure is {result.expected:.3g} times as long: one of the two exposures is "
                "wrong, or the light has changed (the set does not show which)"
            )
    return found
