"""Which option would let a picture hold its light: each is tried on the metered light first."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace

from camctl.exposure.goal import AUTO, CURVE, XI
from camctl.interface.controls import ExposureControls
from camctl.records.capture_plan import CapturePlan
from camctl.records.request import CaptureRequest
from camctl.records.scene_light import LAMP_SHARE
from camctl.system.number_text import time_text

MUCH = 0.05
"""Share of the samples outside the range from which a capture gets a warning."""

LOG = "log"

#: Metered share from which so many samples may be brighter than the range in the picture.
_NEARLY_MUCH = 0.03
#: Fewest effective levels that are advised: with fewer a picture shows steps.
_LEAST_LEVELS = 16.0
#: An advice that leaves more than `MUCH` outside helps if it leaves this part of it, at most.
_HELPS = 0.7
#: The advised picture has this part of the effective levels at least, where they are few.
_FEWER = 0.6
#: Where metering shows no light, an option may help that shows light darker by this factor.
_DEEPER = 4.0
#: Numbers of exposures, percentages that clip and factors of the range that are tried.
_COUNTS, _CLIPS, _FACTORS = (3, 6), (1.0, 2.0, 3.0, 4.0), (2, 4, 16)
#: A camera's longest time is used from this part of it on.
_NEARLY = 0.99

Predict = Callable[[CaptureRequest], CapturePlan | None]
"""Returns what a request would give with the light that was metered; None: it cannot be met."""


@dataclass(frozen=True)
class _Trial:
    """An advice, the request of one who follows it, and its plan where that is known."""

    text: str
    request: CaptureRequest
    plan: CapturePlan | None = None


@dataclass(frozen=True)
class _Tried:
    """A trial with its plan, and the share of the samples that the plan leaves dark."""

    text: str
    request: CaptureRequest
    plan: CapturePlan
    dark: float


def dark_advice(
    request: CaptureRequest, plan: CapturePlan, controls: ExposureControls, predict: Predict
) -> str | None:
    """Return what to do where the light is darker than the range; None where it is not.

    It is an option that brings the share below `MUCH`, or else the one that leaves least, with the
    predicted share.

    Args:
        request: what was asked for
        plan: of it
        controls: of the camera
        predict: plans another request for the same light
    """
    light = plan.light
    if light is None or request.response == CURVE or request.ratios is not None:
        return None
    if light.dark > MUCH:
        best = _most_shown(request, plan, predict)
        if best is not None and best.dark <= _HELPS * light.dark:
            best = best if best.dark <= MUCH else _with_another(request, best, predict)
            return best.text if best.dark <= MUCH else _partly(best.text, best.dark)
    elif light.unseen <= MUCH:
        return None
    if light.unseen > MUCH:
        return _unseen_text(request, plan, controls, predict)
    return "open the aperture, or light the scene; no option shows it"


def _tried(request: CaptureRequest, plan: CapturePlan, predict: Predict) -> Iterator[_Tried]:
    """Yield the trials that give a picture with enough levels in which no more clips."""
    assert plan.light is not None  # asked for by the callers
    for trial in _trials(request, plan, predict):
        predicted = trial.plan or predict(trial.request)
        if predicted is None or predicted.light is None:
            continue
        if predicted.effective_levels < min(_LEAST_LEVELS, _FEWER * plan.effective_levels):
            continue
        if predicted.light.clips <= max(MUCH, plan.light.clips):
            yield _Tried(trial.text, trial.request, predicted, predicted.light.dark)


def _most_shown(request: CaptureRequest, plan: CapturePlan, predict: Predict) -> _Tried | None:
    """Return the first trial that leaves little dark, or else the one that leaves least."""
    best = None
    for trial in _tried(request, plan, predict):
        if best is None or trial.dark < best.dark:
            best = trial
        if best.dark <= MUCH:
            break
    return best


def _with_another(request: CaptureRequest, first: _Tried, predict: Predict) -> _Tried:
    """Return an advice with the one that helps most beside it, or alone if none does."""
    second = _most_shown(first.request, first.plan, predict)
    if second is None or second.dark > _HELPS * first.dark:
        return first
    if _changed(request, first.request) & _changed(first.request, second.request):
        return second  # it replaces the first
    return replace(second, text=f"{first.text}, and also {second.text}")


def _changed(request: CaptureRequest, other: CaptureRequest) -> set[str]:
    """Return the names of the fields that differ."""
    names = (field.name for field in fields(request))
    return {name for name in names if getattr(request, name) != getattr(other, name)}


def bright_advice(request: CaptureRequest, plan: CapturePlan, predict: Predict) -> str | None:
    """Return the like of `dark_advice` where the light is brighter than the range."""
    light = plan.light
    if light is None or light.clips <= _NEARLY_MUCH:
        return None
    best = math.inf, ""
    for trial in _shorter_trials(request):
        predicted = predict(trial.request)
        if predicted is None or predicted.light is None:
            continue
        best = min(best, (predicted.light.clips, trial.text))
        if best[0] <= min(MUCH, _HELPS * light.clips):
            break
    share, text = best
    if share > _HELPS * light.clips:
        return None
    return text if share <= MUCH else _partly(text, share)


def _shorter_trials(request: CaptureRequest) -> Iterator[_Trial]:
    """Yield what shortens the exposures, in the order in which it is advised."""
    shift, share = "the compensation (--compensation)", "the share that may clip (--clip)"
    if request.compensation_stops > 0:
        yield _Trial(f"leave {shift} out", replace(request, compensation_stops=0.0))
    if request.clip:
        yield _Trial(f"leave {share} out", replace(request, clip_percent=None))
    if request.compensation_stops > 0 and request.clip:
        text = f"leave {shift} and {share} out"
        yield _Trial(text, replace(request, compensation_stops=0.0, clip_percent=None))


def _partly(text: str, share: float) -> str:
    return f"{text}, after which {share:.0%} still is by the metered light"


def _reach(plan: CapturePlan, controls: ExposureControls) -> float:
    """Return the least light that the exposures of a plan, and its range, can show."""
    exposures = [setting.exposure for setting in plan.settings]
    level = float(controls.levels.levels[0])
    return max(plan.desired.e_min / min(exposures), level / max(exposures))


def _unseen_text(
    request: CaptureRequest, plan: CapturePlan, controls: ExposureControls, predict: Predict
) -> str:
    """Return what to say of light that the metering frames could not tell from black."""
    longest_s = max(setting.time_s for setting in plan.settings)
    text = "metering shows no light there"
    reach = _reach(plan, controls) / _DEEPER
    for trial in _tried(request, plan, predict):
        if trial.dark <= MUCH and _reach(trial.plan, controls) <= reach:
            return f"{text}; if there is some, this may show it: {trial.text}"
    if longest_s >= _NEARLY * controls.time_s.maximum:
        return (
            f"{text}, and {time_text(longest_s)} is the camera's longest exposure; open the "
            f"aperture, or light the scene"
        )
    return f"{text}; if there is some, open the aperture, or light the scene"


def _trials(request: CaptureRequest, plan: CapturePlan, predict: Predict) -> Iterator[_Trial]:
    """Yield what may help, in the order in which it is advised."""
    is_auto = request.dynamic_range == AUTO
    if not is_auto:
        text = "let the light decide the range (--range auto)"
        yield _Trial(text, replace(request, dynamic_range="auto"))
    if request.compensation_stops < 0:
        text = "leave the compensation (--compensation) out"
        yield _Trial(text, replace(request, compensation_stops=0.0))
    if request.clip is not None and request.clip < LAMP_SHARE:
        text = "let lamps and reflections clip; leave the share that may (--clip) out"
        yield _Trial(text, replace(request, clip_percent=None))
    if request.time_budget_s is not None:
        yield from _more_time(request, predict)
    if request.count is not None or request.time_budget_s is None:
        for count in _COUNTS:
            # For the objective xi, solving more exposures may take minutes.
            if count > request.most_exposures and (plan.objective != XI or count == _COUNTS[0]):
                yield _Trial(f"take more exposures (-n {count})", replace(request, count=count))
    yield from _less_accuracy(request, plan)
    if request.clip is None:
        for percent in _CLIPS:
            text = f"let the brightest part clip (--clip {percent:g})"
            yield _Trial(text, replace(request, clip_percent=percent))
    if plan.desired.name != LOG:
        text = (
            f"the {plan.desired.name} response has few levels for it; take constant contrast "
            f"(--response log)"
        )
        yield _Trial(text, replace(request, response=LOG, gamma=None))


def _more_time(request: CaptureRequest, predict: Predict) -> Iterator[_Trial]:
    """Yield the picture without a time budget, and how long it takes.

    With a budget of that time it may be another one, of a smaller range.
    """
    free_request = replace(request, time_budget_s=None)
    free = predict(free_request)
    if free is None or free.wall_s is None:
        return
    text = (
        f"the time allowed is too short; leave it (--time-budget) out, and the picture takes "
        f"{time_text(free.wall_s)}"
    )
    yield _Trial(text, free_request, free)


def _less_accuracy(request: CaptureRequest, plan: CapturePlan) -> Iterator[_Trial]:
    """Yield larger ranges, and fewer levels: light that the camera holds less accurately."""
    if request.accuracy is not None:
        text = "leave the accuracy (--accuracy) out"
        yield _Trial(text, replace(request, accuracy=None))
    if request.dynamic_range != AUTO or plan.objective == XI:
        return
    assert plan.light is not None  # asked for by the caller
    levels = math.floor(plan.light.needed_levels or 0.0)
    if levels >= _LEAST_LEVELS and request.accuracy is None:
        text = f"the camera holds all of the light with less accuracy (--accuracy {levels})"
        yield _Trial(text, replace(request, accuracy=float(levels)))
    for factor in _FACTORS:
        larger = plan.dynamic_range * factor
        text = f"ask for a larger range, with less accuracy (--range {larger:.0f})"
        yield _Trial(text, replace(request, dynamic_range=larger))
