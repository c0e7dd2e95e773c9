"""The exposures that are stated for a series, against what its pixels show.

Pixels give exposures up to a power (see `camctl.calibration.response.fit`): their logarithms lie
on a line over the logarithms of the stated ones.  A distance from it is an error of a label, of the
shutter, or of the light.  The line passes through two of the points, so that the sum of the square
roots of the distances is least: a few wrong labels do not bend it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camctl.calibration.response.exponent import STEEP, expected_exponent
from camctl.calibration.response.fit import ResponseFit
from camctl.errors import DataError
from camctl.findings import Finding
from camctl.messages.calibration import contradiction_hint, exposures_contradict
from camctl.model.quantiles import Z_95, student
from camctl.model.response.camera import FloatArray

#: Relative errors of the exposures from which there is a note, and from which there is no result:
#: film at long exposures (reciprocity failure) can be 25 % darker.
_NOTED, _REFUSED = 0.02, 0.35
#: One label is wrong if the others are right within `_NOTED`, or this share of its error.
_OTHERS = 0.15
#: Errors are a smooth function of the exposure, and no flicker, if a parabola explains this share
#: of their variance, in so many frames or more.
_SMOOTH, _LEAST_SMOOTH = 0.85, 5
#: Flatness of responses: the exponent that makes them as steep as sRGB at 5 % of full scale.  Of 96
#: measured ones (tests/bench/bench_response.py) a tenth is beyond the first numbers, which
#: is worth a word; all have 0.65 to 4.03: beyond the second is no camera's.
_USUAL, _POSSIBLE = (0.8, 2.2), (0.5, 5.0)
#: Degrees of freedom that three frames count as: they have one, which would refuse nearly all.
_LEAST_FREEDOM = 2
#: Exposures that are printed.
_MOST_PRINTED = 8


@dataclass(frozen=True, eq=False)
class LabelCheck:
    """What the pixels say about the exposures that are stated.

    Attributes:
        corrections: (channels, J) factors of the stated exposures; all 1 where these are right
        exponent_error: relative standard deviation of the exponent of the curve, from the scatter
            of the labels
        finding: what is wrong; None where the labels are right
    """

    corrections: FloatArray
    exponent_error: float = 0.0
    finding: Finding | None = None


def check_labels(
    names: Sequence[str],
    exposures: FloatArray,
    channels: Sequence[str],
    fits: Sequence[ResponseFit],
    judged: NDArray[np.bool_],
    *,
    is_shot: bool = False,
) -> LabelCheck:
    """Compare the stated exposures of frames with what the pixels show.

    Args:
        names: of the frames
        exposures: (J,) as stated
        channels: names of the channels
        fits: of each channel, when the exposures are estimated, too
        judged: (channels, J) whether a channel shows the exposure of a frame
        is_shot: camctl has shot the frames: there are no labels of the user's to correct

    Raises:
        DataError: the labels contradict the pixels; says which, and what the pixels say
    """
    logs = np.log(exposures)
    found = np.log([fit.exposures for fit in fits])
    # A frame that has nothing in common with others may have any exposure, and the curve any slope.
    every = np.ones(logs.size, np.bool_)
    is_proven = all(np.abs(label_errors(logs, each, every)).max() < _REFUSED for each in found)
    trend = _unusual_trend(exposures, fits, is_shot=is_shot, is_proven=is_proven)
    errors = np.array([label_errors(logs, *each) for each in zip(found, judged, strict=True)])
    worst = np.abs(errors).argmax(axis=0)
    error = errors[worst, np.arange(logs.size)]
    size = np.abs(error)
    shown = np.any(judged, axis=0)
    if not size.max() > _NOTED:
        return LabelCheck(np.ones(errors.shape), _standard_error(logs[shown], error[shown]), trend)
    order = np.argsort(-size)
    first = int(order[0])
    is_single = shown.sum() > 3 and size[order[1]] <= max(_NOTED, _OTHERS * size[first])
    bow = _bow(logs[shown], error[shown])
    is_smooth = not is_single and bow > 0
    if is_single:
        apart = np.ptp(errors[judged[:, first], first]) > _NOTED
        channel = channels[worst[first]] if apart else ""
        finding = _wrong_label(first, names[first], exposures[first], error[first], channel)
    elif shown.sum() <= 3:
        finding = Finding(
            code="exposures_contradict",
            value=size[first],
            details={"kind": "few", "stated": _numbers(exposures)},
        )
    elif is_smooth or size[first] > math.log1p(_REFUSED):
        finding = _contradiction(exposures, fits)
    else:  # of errors at random the line of least squares is the better one
        errors = np.array([_scatter(logs, *each) for each in zip(found, judged, strict=True)])
        error = errors[worst, np.arange(logs.size)]
        finding = _flicker(names, error)
    finding = _with_remedies(finding, is_shot=is_shot)
    if size[first] > math.log1p(_REFUSED):
        raise contradiction_error(finding)
    right = shown & (size <= _NOTED) if is_single else shown
    spread = bow if is_smooth else _standard_error(logs[right], error[right])
    return LabelCheck(np.exp(errors), spread, finding)


def contradiction_error(finding: Finding, what: str = "") -> DataError:
    """Return the error for exposures that contradict the pixels, and what follows from it."""
    return DataError(
        exposures_contradict(finding) + what,
        hint=contradiction_hint(finding),
        remedies=finding.remedies,
    )


def _with_remedies(finding: Finding, *, is_shot: bool) -> Finding:
    """Return the finding with what helps; the user has no labels where camctl shot the frames."""
    remedies = {"calibrate_response": None} if is_shot else {}
    return finding.model_copy(
        update={
            "details": {**finding.details, "is_shot": is_shot},
            "remedies": {**remedies, "estimate_ratios": True},
        }
    )


def _unusual_trend(
    exposures: FloatArray, fits: Sequence[ResponseFit], *, is_shot: bool, is_proven: bool
) -> Finding | None:
    """Return what is wrong with the exposures if they make a response unusually flat or steep.

    Raises:
        DataError: they make it as no camera's is
    """
    values = [expected_exponent(fit).value for fit in fits]
    if _USUAL[0] <= min(values) and max(values) <= _USUAL[1]:
        return None
    finding = _with_remedies(_contradiction(exposures, fits), is_shot=is_shot)
    if not is_proven:
        return finding
    for fit, flatness in zip(fits, values, strict=True):
        # Where frames have no brightness in common the curve is not known, nor is its flatness.
        ends = fit.deviation[-1], np.interp(STEEP * fit.edges[-1], fit.edges, fit.deviation)
        error = Z_95 * math.hypot(*ends) / -fit.log_at(STEEP)
        if flatness * (1 + error) < _POSSIBLE[0] or flatness > _POSSIBLE[1] * (1 + error):
            raise contradiction_error(
                finding,
                f": by the stated ones the response would be {flatness:.2g} times as flat as sRGB, "
                "as no camera's is",
            )
    return finding


def label_errors(logs: FloatArray, found: FloatArray, judged: NDArray[np.bool_]) -> FloatArray:
    """Return ln(exposure that the pixels say / stated one) of each frame; 0 where not judged."""
    used = np.flatnonzero(judged)
    best, errors = math.inf, np.zeros(logs.size)
    for a in used:
        for b in used[logs[used] > logs[a] + 1e-6]:
            slope = (found[b] - found[a]) / (logs[b] - logs[a])
            if slope <= 0:
                continue
            deviations = ((found - found[a]) / slope - (logs - logs[a])) * judged
            if (total := float(np.sqrt(np.abs(deviations)).sum())) < best:
                best, errors = total, deviations
    return errors


def _scatter(logs: FloatArray, found: FloatArray, judged: NDArray[np.bool_]) -> FloatArray:
    """Return the like of `label_errors` from a line of least squares."""
    if judged.sum() < 2:
        return np.zeros(logs.size)
    slope, start = np.polyfit(logs[judged], found[judged], 1)
    return np.asarray(((found - start) / slope - logs) * judged)


def _bow(logs: FloatArray, errors: FloatArray) -> float:
    """Return how the slope of the labels changes (standard deviation) where errors are a parabola.

    0 where they are not, or where frames are too few to tell.
    """
    if logs.size < _LEAST_SMOOTH:
        return 0.0
    line, bow = (np.polyfit(logs, errors, degree) for degree in (1, 2))
    left = [float(np.var(errors - np.polyval(each, logs))) for each in (line, bow)]
    if left[1] >= (1 - _SMOOTH) * left[0]:
        return 0.0
    return float(abs(bow[0]) * np.ptp(logs)) / math.sqrt(3)


def _standard_error(logs: FloatArray, errors: FloatArray) -> float:
    """Return the standard error of the slope of the labels, for 95 % intervals of few frames."""
    spread = float(np.sum(np.square(logs - logs.mean())))
    if logs.size < 3 or spread == 0:
        return 0.0
    scatter = float(np.sum(np.square(errors - np.polyval(np.polyfit(logs, errors, 1), logs))))
    wider = student(Z_95, max(_LEAST_FREEDOM, logs.size - 2)) / Z_95
    return wider * math.sqrt(scatter / (logs.size - 2) / spread)


def _wrong_label(frame: int, name: str, exposure: float, error: float, channel: str) -> Finding:
    return Finding(
        code="exposures_contradict",
        frames=(frame,),
        value=math.expm1(error),
        details={
            "kind": "label",
            "name": name,
            "channel": channel,
            "stated": exposure,
            "said": exposure * math.exp(error),
        },
    )


def _flicker(names: Sequence[str], error: FloatArray) -> Finding:
    low, high = int(error.argmin()), int(error.argmax())
    return Finding(
        code="exposures_contradict",
        value=math.expm1(float(error[np.abs(error).argmax()])),
        details={
            "kind": "flicker",
            "least": math.expm1(error[low]),
            "darkest": names[low],
            "most": math.expm1(error[high]),
            "brightest": names[high],
        },
    )


def _contradiction(exposures: FloatArray, fits: Sequence[ResponseFit]) -> Finding:
    """Return what the pixels say of the exposures if the camera is about as steep as sRGB."""
    logs = np.mean([expected_exponent(fit).value * np.log(fit.exposures) for fit in fits], axis=0)
    said = exposures[0] * np.exp(logs - logs[0])
    ratios = said / exposures
    return Finding(
        code="exposures_contradict",
        value=float(ratios[np.abs(np.log(ratios)).argmax()]) - 1,
        details={"kind": "trend", "stated": _numbers(exposures), "said": _numbers(said, 2)},
    )


def _numbers(values: FloatArray, digits: int = 4) -> str:
    """Return some of the numbers, the last one included."""
    texts = [f"{float(each):.{digits}g}" for each in values]
    if len(texts) > _MOST_PRINTED:
        texts[_MOST_PRINTED - 2 : -1] = ["..."]
    return ", ".join(texts)
