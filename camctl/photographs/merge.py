"""The picture of an effective camera from photographs already taken: which of them make it, and it.

All do, unless a number or their exposures are asked for.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.captures.metering import meter_light
from camctl.captures.plan import plan_capture
from camctl.captures.sequencer import capture
from camctl.errors import UsageError
from camctl.evidence.noise import fit_noise
from camctl.evidence.patches import Patches
from camctl.exposure.goal import AUTO, RANGE_WITHOUT_LIGHT, CaptureRequest
from camctl.exposure.search.best import longest_base_s
from camctl.exposure.search.settings import relative_exposures, search_choices
from camctl.findings import Finding
from camctl.interface.controls import ExposureSetting
from camctl.messages.plain import sentence
from camctl.model.effective import MAX_EXPOSURES, EffectiveCamera
from camctl.model.inverse import posterior_of
from camctl.model.quantiles import NORMAL_MAD, median
from camctl.model.sensor import SensorModel
from camctl.photographs.camera import PhotographCamera, detailed
from camctl.photographs.photograph_set import (
    OpenedPhotographs,
    PhotographOptions,
    open_photographs,
)
from camctl.pictures.render import DARK, sum_mask
from camctl.records.capture_plan import CapturePlan
from camctl.records.folder_store import FolderStore
from camctl.records.report import CaptureReport
from camctl.system.picture_operations import looked_up

#: Share of the light of a scene that is below its range: the deepest dark.
_SHADOWS = 0.005
#: Dynamic ranges that a picture gets without being asked for.
_LEAST_RANGE, _MOST_RANGE = 16.0, 1e7


def darkest_light(camera: PhotographCamera, patches: Sequence[Patches]) -> float:
    """Return the darkest light in photographs but for the deepest dark, E = 1 at full scale in 1 s.

    Each sample counts by the longest exposure in which it is not saturated, as no darker than noise
    and quantiser let it show.

    Args:
        camera: of the photographs
        patches: samples of each photograph, see `sample_patches`
    """
    controls, times = camera.controls, camera.times_s
    exposures, gains = [each / min(times) for each in times], [1.0] * len(times)
    levels = controls.plane_levels
    planes = [np.array_split(each, len(levels)) for each in patches]
    found = []
    for real in dict.fromkeys(levels):
        used = [k for k, each in enumerate(levels) if each is real]
        parts = [np.concatenate([each[k] for k in used]) for each in planes]
        scale = SensorModel(real, controls.black)
        # Of all colours together where they have one response, as `measure_noise` asks later.
        fit = fit_noise(real, parts, exposures, gains, controls.black)
        read = 0.0 if fit is None else math.sqrt(fit.noise[1])
        light = np.full(parts[0].size, np.nan)
        for position in np.argsort(times)[::-1].tolist():
            brightness = np.minimum(parts[position], scale.white).ravel()
            seen = looked_up(scale.light, brightness)
            use = np.isnan(light) & (brightness <= scale.highest(None))
            least = max(scale.level * max(0.5, read), _noise_below_black(seen))
            light[use] = np.maximum(seen[use], least) / times[position]
        light[np.isnan(light)] = scale.full / min(times)
        found.append(light / scale.full)
    return float(np.quantile(np.concatenate(found), _SHADOWS))


def _noise_below_black(light: NDArray[np.float64]) -> float:
    """Return the noise of dark samples as those that it made darker than black show it; 0: none do.

    Light makes them brighter: the median of a half of a normal distribution is 0.67 of its
    standard deviation.  Fewer than the deepest dark change nothing, and may be faults of pixels.
    """
    below = -light[light < 0]
    return median(below) / NORMAL_MAD if below.size > _SHADOWS * light.size else 0.0


def plan_photographs(
    camera: PhotographCamera, request: CaptureRequest, darkest: float | None = None
) -> tuple[CapturePlan, CaptureRequest]:
    """Return the plan of the photographs to use, and the request that it is made from.

    Args:
        camera: of the photographs
        request: what the user asks for; without a number or exposures all photographs are used,
            and with a number those of the best set of so many
        darkest: light that the dynamic range is to reach, see `darkest_light`; None: the request
            says the range

    Raises:
        UsageError, CaptureError: as `plan_capture`
    """
    if request.ratios is not None and darkest is None:
        return _plan_of_ratios(camera, request), request
    light = meter_light(camera, request)
    times = sorted(camera.times_s)
    limit_s = longest_base_s(request, light)
    is_all = request.ratios is None and request.count is None
    if is_all:
        base_s = times[0]
    else:
        if request.count is not None and request.base_s is None:
            # Where too few are as long as the metered one, shorter ones serve.
            limit_s = min(limit_s, times[-min(request.count, len(times))])
        base_s = max((t for t in times if t <= limit_s), default=times[0])
    if darkest is not None:
        request = replace(request, dynamic_range=_rounded_range(1 / (base_s * darkest)))
        if request.ratios is not None:
            return _plan_of_ratios(camera, request), request
    if is_all:
        chosen = tuple(ExposureSetting(each, 1.0) for each in _most(times))
    else:
        assert request.desired is not None  # the range is a number, and no response is automatic
        assert request.count is not None
        chosen = search_choices(camera.controls, request, request.desired, request.count, limit_s)
    asked = replace(
        request,
        count=None,
        ratios=relative_exposures(chosen),
        compensation_stops=0.0,
        clip_percent=None,
    )
    if light is not None:
        light = light.up_to(chosen[0].time_s)
    return plan_capture(camera, asked, light=light), asked


def _plan_of_ratios(camera: PhotographCamera, request: CaptureRequest) -> CapturePlan:
    """Return the plan of the photographs nearest to the exposures that are asked for.

    Raises:
        UsageError: two of them are the same, whose noise would count as if it were of two
    """
    plan = plan_capture(camera, request)
    used = camera.chosen(plan.settings)
    if twice := [k for k in used if used.count(k) > 1]:
        name, count = camera.photographs[twice[0]].name, used.count(twice[0])
        raise UsageError(
            f"{name} is nearest to {count} of the exposures, and can be used once",
            hint="give one exposure for each photograph",
            remedies={"ratios": None},
        )
    return plan


def _most(times_s: list[float]) -> list[float]:
    """Return so many of ascending times as can be summed, without those next to each other."""
    kept = list(times_s)
    while len(kept) > MAX_EXPOSURES:
        steps = np.diff(np.log(kept))
        del kept[1 + int(np.argmin(steps[:-1] + steps[1:]))]
    return kept


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
    """Return, by position, why a photograph is not used, where fewer were asked for."""
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
            is_shown = plan.light is not None and plan.light.dark <= _SHADOWS
            why = (
                "which shows the darkest light of the range"
                if is_shown
                else "the longest one chosen"
            )
            reasons[position] = f"longer than {name}, {why}"
        else:
            reasons[position] = "what it shows is in those that are used"
    return reasons


@dataclass(frozen=True, eq=False)
class MergePlan:
    """Which of the photographs are used, and why not the others.

    Attributes:
        opened: the photographs
        request: with the range and the exposures that were chosen
        plan: of the picture
    """

    opened: OpenedPhotographs
    request: CaptureRequest
    plan: CapturePlan

    @property
    def photographs(self) -> list[dict[str, Any]]:
        """Exposure of each photograph, whether it is used, and why not."""
        camera, used = self.opened.camera, self._used
        reasons = why_unused(camera, self.plan)
        return [
            {
                "file": each.name,
                "time_s": each.time_s,
                "gain": each.gain,
                "f_number": each.f_number,
                "used": k in used,
                "why_not": reasons.get(k),
            }
            for k, each in enumerate(camera.photographs)
        ]

    @property
    def notes(self) -> list[Finding]:
        """Findings that are warnings."""
        used = self._used
        displaced = (
            detailed(each, summed=k in used and len(used) > 1, used=k in used)
            for k, each in self.opened.displaced.items()
        )
        return [self._of_frames(each) for each in (*self.opened.notes, *displaced)]

    @property
    def facts(self) -> tuple[Finding, ...]:
        """Findings that are no warnings."""
        return tuple(map(self._of_frames, self.opened.facts))

    @property
    def _used(self) -> list[int]:
        """Positions of the photographs that are used, frame by frame."""
        return self.opened.camera.chosen(self.plan.settings)

    def _of_frames(self, finding: Finding) -> Finding:
        """Return a finding about files, given by their positions, as one about frames.

        A file that is no frame of the picture is named in its details alone.
        """
        files = [self.opened.positions[k] for k in self._used]
        frames = tuple(files.index(k) for k in finding.frames if k in files)
        return finding.model_copy(update={"frames": frames})

    @property
    def source(self) -> dict[str, Any]:
        """What the report says of the photographs, as `CaptureReport.source`."""
        return {
            "photographs": self.photographs,
            "response_from": self.opened.response,
            "facts": [
                {"text": sentence(each), **each.model_dump(mode="json")} for each in self.facts
            ],
        }

    def capture(self, path: str | os.PathLike[str] | None, *, overwrite: bool) -> CaptureReport:
        """Sum the photographs that are used, and write the pictures; see `merge`."""
        plan = replace(self.plan, findings=(*self.notes, *self.plan.findings))
        camera, source = self.opened.camera, self.source
        return capture(camera, self.request, path, plan=plan, source=source, overwrite=overwrite)


def plan_merge(
    files: Sequence[str | os.PathLike[str]], request: CaptureRequest, options: PhotographOptions
) -> MergePlan:
    """Read photographs, and choose those that serve a picture; arguments as for `merge`."""
    request = replace(request, deghost=request.deghost or options.removes_ghosts)
    is_auto = request.dynamic_range == AUTO
    if is_auto:
        # Until the light of the photographs gives it.
        request = replace(request, dynamic_range=RANGE_WITHOUT_LIGHT)
    opened = open_photographs([Path(each) for each in files], options)
    camera, patches = opened.camera, opened.patches
    darkest = darkest_light(camera, patches) if is_auto else None
    plan, request = plan_photographs(camera, request, darkest)
    return MergePlan(opened, request, with_dark_share(camera, plan, patches))


def merge(
    files: Sequence[str | os.PathLike[str]],
    request: CaptureRequest | None = None,
    path: str | os.PathLike[str] | None = None,
    *,
    options: PhotographOptions | None = None,
    overwrite: bool = False,
) -> CaptureReport:
    """Make the picture that `request` asks for from photographs of one scene, as `camctl merge`.

    All are summed, but for those that are proven wrong, or as many as the request says.

    Args:
        files: photographs with different exposures: JPEG, PNG, TIFF, camera raw, linear OpenEXR
        request: the desired picture; None: response "log" over the range of the light in the
            photographs; without `count` and `ratios` all of these are used
        path: folder of the result, which is made; None: all is kept in memory
        options: what is known of the photographs beside their files
        overwrite: replace an earlier result in the folder

    Returns:
        the report; `source["photographs"]` says which photographs are used, and why not the
        others, `findings` what was found wrong with them, and `source["facts"]` what was done

    Raises:
        UsageError: the request or an option cannot be met, or an exposure is missing
        DataError: a file cannot be read, or the photographs do not fit each other or their labels
        CaptureError: no set of the photographs makes the picture
        StorageError: a file cannot be written, or the folder holds another result
    """
    if path is not None:
        FolderStore.check_free(Path(path), overwrite=overwrite)
    asked = request or CaptureRequest()
    found = plan_merge(files, asked, options or PhotographOptions())
    return found.capture(path, overwrite=overwrite)
