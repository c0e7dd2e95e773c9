"""Which photographs serve a picture, and why the others do not."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise

import numpy as np

from camctl.captures.plan import plan_capture
from camctl.errors import CaptureError, UsageError
from camctl.evidence.patches import Patches
from camctl.exposure.evaluation import evaluate
from camctl.exposure.goal import CaptureRequest
from camctl.exposure.objective import Objective
from camctl.exposure.search.settings import relative_exposures, search_choices
from camctl.interface.controls import ExposureSetting
from camctl.model.effective import MAX_EXPOSURES, EffectiveCamera
from camctl.model.inverse import posterior_of
from camctl.model.sensor import SensorModel
from camctl.photographs.camera import PhotographCamera
from camctl.pictures.render import DARK, sum_mask
from camctl.records.capture_plan import CapturePlan

#: Another photograph is used if it adds more than this share of effective levels.
_WORTH = 0.05
#: Share of the light of a scene that is below its range: the deepest dark.
_SHADOWS = 0.005
#: Dynamic ranges that a picture gets without being asked for.
_LEAST_RANGE, _MOST_RANGE = 16.0, 1e6


def darkest_light(camera: PhotographCamera, patches: Sequence[Patches]) -> float:
    """Return the darkest light in photographs but for the deepest dark, E = 1 at full scale in 1 s.

    Each sample counts by the longest exposure in which it is not saturated.

    Args:
        camera: of the photographs
        patches: samples of each photograph, see `sample_patches`
    """
    controls, times = camera.controls, camera.times_s
    scales = [SensorModel(each, controls.black) for each in controls.plane_levels]
    found = []
    for plane, scale in enumerate(scales):
        parts = [np.array_split(each, len(scales))[plane] for each in patches]
        light = np.full(parts[0].size, np.nan)
        for position in np.argsort(times)[::-1].tolist():
            brightness = np.minimum(parts[position], scale.white).ravel()
            seen = scale.light[brightness]
            use = np.isnan(light) & (brightness <= scale.highest(None))
            light[use] = np.maximum(seen[use], scale.level / 2) / times[position]
        light[np.isnan(light)] = scale.full / min(times)
        found.append(light / scale.full)
    return float(np.quantile(np.concatenate(found), _SHADOWS))


def plan_photographs(
    camera: PhotographCamera, request: CaptureRequest, darkest: float | None = None
) -> tuple[CapturePlan, CaptureRequest]:
    """Return the plan of the photographs to use, and the request that it is made from.

    Every set of photographs is compared, as for a camera with a list of shutter times.  Where the
    request leaves their number open, it is the least from which another photograph raises the
    effective levels by no more than 5 %.

    Args:
        camera: of the photographs
        request: what the user asks for
        darkest: light that the dynamic range is to reach, see `darkest_light`; None: the request
            says the range

    Raises:
        UsageError, CaptureError: as `plan_capture`
    """
    if request.ratios is not None and darkest is None:
        return plan_capture(camera, request), request
    metering = plan_capture(camera, replace(request, count=1, ratios=None)).metering
    assert metering is not None  # no base exposure is given
    limit_s = metering.limit_s * 2.0**request.compensation_stops
    if request.count is not None and request.base_s is None:
        # So many were asked for: where too few are as long as the metered one, shorter ones serve.
        limit_s = min(limit_s, sorted(camera.times_s)[-min(request.count, len(camera.times_s))])
    if darkest is not None:
        # The shortest photograph of a set is the longest one up to the limit.
        base_s = max((t for t in camera.times_s if t <= limit_s), default=min(camera.times_s))
        request = replace(request, dynamic_range=_rounded_range(1 / (base_s * darkest)))
        if request.ratios is not None:
            return plan_capture(camera, request), request
    desired, controls = request.desired, camera.controls
    assert desired is not None  # the range is a number, and no response is automatic
    most = min(len(camera.photographs), MAX_EXPOSURES)
    found: list[tuple[float, tuple[ExposureSetting, ...]]] = []
    for count in range(1, most + 1) if request.count is None else (request.count,):
        try:
            settings = search_choices(controls, request, desired, count, limit_s)
        except (CaptureError, UsageError):
            if not found:
                raise
            break  # fewer photographs are as long as the metered one
        exposures = relative_exposures(settings)
        quality = evaluate(controls.levels, desired, exposures, objective=Objective())
        found.append((quality.effective_levels, settings))
    chosen = found[-1][1]
    for (levels, settings), (more, _) in pairwise(found):
        if more <= (1 + _WORTH) * levels:
            chosen = settings
            break
    asked = replace(request, count=None, ratios=relative_exposures(chosen))
    plan = None
    with suppress(CaptureError):  # from the longest possible photograph on there are too few
        plan = plan_capture(camera, asked)
    if plan is None or plan.settings != chosen:  # the chosen set begins below that one
        base_s = chosen[0].time_s
        asked = replace(asked, base_s=base_s, compensation_stops=0.0, clip_percent=None)
        plan = plan_capture(camera, asked)
    return plan, asked


def with_dark_share(
    camera: PhotographCamera, plan: CapturePlan, patches: Sequence[Patches]
) -> CapturePlan:
    """Return a plan whose light says which share is too dark in the sums of the patches.

    Where the noise of photographs is unknown, the histogram of their light does not say how often
    a sample is black in all of them.

    Args:
        camera: of the photographs
        plan: which of them are used
        patches: samples of each photograph, see `sample_patches`
    """
    if plan.light is None:
        return plan
    controls = camera.controls
    planes = controls.plane_levels
    used = [patches[position].astype(np.intp) for position in camera.chosen(plan.settings)]
    total = np.sum(used, axis=0)
    exposures, noise = relative_exposures(plan.settings), controls.frame_noise(plan.settings)
    masks = {
        each: sum_mask(posterior_of(EffectiveCamera.of(each, exposures), plan.desired, noise))
        for each in dict.fromkeys(planes)
    }
    count = sum(
        int((masks[each][part] == DARK).sum())
        for each, part in zip(planes, np.array_split(total, len(planes)), strict=True)
    )
    dark = count / total.size
    unseen = min(plan.light.unseen, dark)  # what another photograph shows is seen
    return replace(plan, light=replace(plan.light, dark=dark, unseen=unseen))


def _rounded_range(value: float) -> float:
    """Return a dynamic range that a picture can have, rounded up to two digits."""
    value = min(max(value, _LEAST_RANGE), _MOST_RANGE)
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return min(math.ceil(value / unit) * unit, _MOST_RANGE)


def why_unused(camera: PhotographCamera, plan: CapturePlan) -> dict[int, str]:
    """Return, by position, why a photograph is not used."""
    used = camera.chosen(plan.settings)
    exposures = {k: each.exposure for k, each in enumerate(camera.photographs)}
    first, last = (pick(used, key=exposures.__getitem__) for pick in (min, max))
    reasons = {}
    for position, exposure in exposures.items():
        if position in used:
            continue
        if exposure < exposures[first]:
            name = camera.photographs[first].name
            reasons[position] = f"shorter than {name}, in which few enough highlights saturate"
        elif exposure > exposures[last]:
            name = camera.photographs[last].name
            reasons[position] = f"longer than {name}, which shows the darkest light of the range"
        else:
            reasons[position] = "what it shows is in those that are used"
    return reasons
