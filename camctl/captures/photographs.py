"""Photographs already taken, as a camera that has only their settings.

The plan of a capture then chooses among the photographs as it chooses among the settings of any
camera, and the frames are summed, checked and rendered by the same code.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from itertools import pairwise

import numpy as np

from camctl.camera import PHOTOGRAPHS, CameraBase, CameraInfo, Frame, Pixels
from camctl.captures.capture_plan import CapturePlan, relative_exposures
from camctl.captures.plan import plan_capture
from camctl.captures.request import CaptureRequest
from camctl.captures.setting_selection import search_choices
from camctl.clock import RealClock
from camctl.controls import Choices, ExposureControls, ExposureSetting, Layout
from camctl.errors import CaptureError, DataError, UsageError
from camctl.exposure.evaluation import evaluate
from camctl.exposure.objective import Objective
from camctl.exposure.patches import LightScale, Patches
from camctl.exposure.ratios import estimate_ratios

#: Stated times that are labels of a dial agree with one of these to this relative difference.
_SAME_LABEL = 0.015
#: Labels of dials in thirds and halves of a stop, s and 1/s.
_LABELS = (
    *(1, 1.3, 1.5, 1.6, 2, 2.5, 3, 3.2, 4, 5, 6, 8, 10, 13, 15, 20, 25, 30, 40, 45, 50, 60, 80, 90),
    *(100, 125, 160, 180, 200, 250, 320, 350, 400, 500, 640, 750, 800, 1000, 1250, 1500, 1600),
    *(2000, 2500, 3000, 3200, 4000, 5000, 6000, 6400, 8000, 10000, 12800, 16000, 32000),
)
_TENTHS = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
_LONGEST_LABEL_S = 60.0
#: Photographs of the same exposure are distinguished by this relative difference.
_APART = 1e-7
#: Another photograph is used if it adds more than this share of effective levels.
_WORTH = 0.05
#: Exposures are corrected by up to this factor, and a correction above the second number is named.
_MOST_CORRECTED, _NOTABLE = 1.3, 0.03
#: Share of the light of a scene that is below its range: the deepest dark.
_SHADOWS = 0.005
#: A photograph shows light up to this share of its full scale.
_WELL = 0.9
#: Dynamic ranges that a picture gets without being asked for.
_LEAST_RANGE, _MOST_RANGE = 16.0, 1e6

MOST_PHOTOGRAPHS = 16
"""Photographs of which one picture is made, at most."""


@dataclass(frozen=True)
class Photograph:
    """One photograph, as its file or its user states it.

    Attributes:
        name: of its file
        time_s: shutter time, s
        gain: linear gain, 1 for ISO 100
        f_number: f-number; None where it is not stated
        taken_at: when it was taken; None where that is not stated
        iso: ISO speed as stated; None where it is not
    """

    name: str
    time_s: float
    gain: float = 1.0
    f_number: float | None = None
    taken_at: datetime | None = None
    iso: float | None = None

    @property
    def setting(self) -> ExposureSetting:
        """Time, gain and f-number."""
        return ExposureSetting(self.time_s, self.gain, self.f_number)

    @property
    def exposure(self) -> float:
        """Exposure, which is time x gain / f-number^2, in arbitrary but constant units."""
        return self.setting.exposure


def is_dial_label(time_s: float) -> bool:
    """Return whether a stated time is a label of a dial, such as 1/60, 1/15 or 30.

    >>> is_dial_label(1 / 60), is_dial_label(1 / 47)
    (True, False)
    """
    if not 0 < time_s <= _LONGEST_LABEL_S:
        return False
    labels = (*_LABELS, *_TENTHS) if time_s >= 0.3 else _LABELS
    value = time_s if time_s >= 0.3 else 1 / time_s
    return any(math.isclose(value, label, rel_tol=_SAME_LABEL) for label in labels)


def true_time_s(label_s: float) -> float:
    """Return the true time of a dial's label: a power of two in thirds or halves of a stop.

    Debevec and Malik (1997), section 2.1, measured it so.

    >>> 1 / true_time_s(1 / 60), true_time_s(30), round(true_time_s(1 / 90) * 90.5, 3)
    (64.0, 32.0, 1.0)
    """
    stops = math.log2(label_s)
    thirds, halves = round(3 * stops) / 3, round(2 * stops) / 2
    return math.exp2(halves if abs(stops - halves) < abs(stops - thirds) / 3 else thirds)


def true_f_number(label: float) -> float:
    """Return the true f-number of a label: a power of two in sixths.

    >>> round(true_f_number(5.6), 3), round(true_f_number(11), 3), true_f_number(8)
    (5.657, 11.314, 8.0)
    """
    return math.exp2(round(6 * math.log2(label)) / 6)


def with_true_exposures(photographs: Sequence[Photograph]) -> list[Photograph] | None:
    """Return photographs with the true times and f-numbers of their labels.

    None: not all times are labels, so that they are taken as they are.
    """
    if not all(is_dial_label(each.time_s) for each in photographs):
        return None
    return [
        replace(
            each,
            time_s=true_time_s(each.time_s),
            f_number=None if each.f_number is None else true_f_number(each.f_number),
        )
        for each in photographs
    ]


class PhotographCamera(CameraBase):
    """A camera whose only settings are the exposures of photographs, and their frames its frames.

    A setting's time stands for the whole exposure: the shutter time that has it at the sensitivity
    and aperture of the first photograph.  The applied setting of a frame is the photograph's own.

    Args:
        photographs: in any order, two or more
        load: returns the pixels of a photograph by its position
        controls: what is known of the frames; `time_s` is not used
        taken_by: make, model and serial number of the camera that took them, for the report

    Attributes:
        photographs: as given
        times_s: time of the setting of each photograph, s
    """

    def __init__(
        self,
        photographs: Sequence[Photograph],
        load: Callable[[int], Pixels],
        controls: ExposureControls,
        taken_by: tuple[str, str, str] = ("", "", ""),
    ) -> None:
        super().__init__("the set of photographs", RealClock())
        self.photographs = tuple(photographs)
        self._load, self._given, self._taken_by = load, controls, taken_by
        unit = photographs[0].exposure / photographs[0].time_s
        times: list[float] = []
        order = sorted(range(len(photographs)), key=lambda k: photographs[k].exposure)
        for position in order:
            time_s = photographs[position].exposure / unit
            times.append(max(time_s, times[-1] * (1 + _APART)) if times else time_s)
        self._position = dict(zip(times, order, strict=True))
        self.times_s = [time_s for _, time_s in sorted(zip(order, times, strict=True))]
        self.open()

    def preview(self, setting: ExposureSetting) -> Frame:
        """Return the photograph at `setting`."""
        self._check_ready()
        self.controls.check(setting)
        return self._frame(setting, 0)

    def chosen(self, settings: Sequence[ExposureSetting]) -> list[int]:
        """Return the positions of the photographs at `settings`."""
        return [self._position[self.controls.time_s.nearest(each.time_s)] for each in settings]

    def _open(self) -> None:
        make, model, serial = self._taken_by
        self._info = CameraInfo(PHOTOGRAPHS, make, model or PHOTOGRAPHS, serial, PHOTOGRAPHS)
        times = Choices(tuple(sorted(self._position)))
        self._controls = replace(self._given, time_s=times, gain=Choices((1.0,)), tolerance=1e-9)

    def _close(self) -> None:
        """There is nothing to disconnect."""

    def _frames(self, settings: tuple[ExposureSetting, ...]) -> Iterator[Frame]:
        for index, setting in enumerate(settings):
            yield self._frame(setting, index)

    def _frame(self, setting: ExposureSetting, index: int) -> Frame:
        (position,) = self.chosen([setting])
        controls, photograph = self.controls, self.photographs[position]
        details: dict[str, str | float] = {"file": photograph.name}
        if photograph.iso is not None:
            details["iso"] = photograph.iso
        if photograph.taken_at is not None:
            details["taken_at"] = photograph.taken_at.isoformat()
        return Frame(
            self._load(position),
            setting,
            photograph.setting,
            self.clock.now(),
            index,
            controls.black,
            controls.white,
            details=details,
        )


def darkest_light(camera: PhotographCamera, patches: Sequence[Patches]) -> float:
    """Return the darkest light in photographs but for the deepest dark, E = 1 at full scale in 1 s.

    Each sample counts by the longest exposure in which it is not saturated.

    Args:
        camera: of the photographs
        patches: samples of each photograph, see `sample_patches`
    """
    controls, times = camera.controls, camera.times_s
    planes = {Layout.MONO: "G", Layout.RGB: "RGB"}.get(controls.layout, controls.layout.upper())
    responses = controls.responses or (controls.levels,) * 3
    scales = [LightScale(responses["RGB".index(each)], controls.black) for each in planes]
    found = []
    for plane, scale in enumerate(scales):
        parts = [np.array_split(each, len(planes))[plane] for each in patches]
        light = np.full(parts[0].size, np.nan)
        for position in np.argsort(times)[::-1].tolist():
            seen = scale.light[np.minimum(parts[position], scale.white)].ravel()
            use = np.isnan(light) & (seen <= _WELL * scale.full)
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
    if darkest is not None:
        # The shortest photograph of a set is the longest one up to the limit.
        base_s = max((t for t in camera.times_s if t <= limit_s), default=min(camera.times_s))
        request = replace(request, dynamic_range=_rounded_range(1 / (base_s * darkest)))
        if request.ratios is not None:
            return plan_capture(camera, request), request
    desired, controls = request.desired, camera.controls
    assert desired is not None  # the range is a number, and no response is automatic
    most = min(len(camera.photographs), MOST_PHOTOGRAPHS)
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
    plan = plan_capture(camera, asked)
    if plan.settings != chosen:  # the chosen set begins below the longest possible photograph
        base_s = chosen[0].time_s
        asked = replace(asked, base_s=base_s, compensation_stops=0.0, clip_percent=None)
        plan = plan_capture(camera, asked)
    return plan, asked


def _rounded_range(value: float) -> float:
    """Return a dynamic range that a picture can have, rounded up to two digits."""
    value = min(max(value, _LEAST_RANGE), _MOST_RANGE)
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return min(math.ceil(value / unit) * unit, _MOST_RANGE)


def corrected_exposures(
    photographs: Sequence[Photograph], patches: Sequence[Patches], scale: LightScale
) -> tuple[list[Photograph], list[str]]:
    """Return photographs with exposures estimated from their pixels, and what was changed.

    Shutters are not exact, and film is less sensitive in long exposures.  An exposure is changed
    where the stated one lies outside the 95 % interval of the estimate, by `_MOST_CORRECTED` at
    most: what differs by more has a wrong label.
    """
    stated = [each.exposure for each in photographs]
    try:
        found = estimate_ratios(patches, stated, scale)
    except DataError:
        return list(photographs), []
    # The unit is that of most photographs, and not of the reference alone.
    factors = np.array(found.exposures) / stated
    unit = float(np.median(factors))
    result, facts = [], []
    for k, photograph in enumerate(photographs):
        factor = float(factors[k]) / unit
        is_stated = found.low[k] <= stated[k] * unit <= found.high[k]
        if is_stated or abs(math.log(factor)) > math.log(_MOST_CORRECTED):
            result.append(photograph)
            continue
        result.append(replace(photograph, time_s=photograph.time_s * factor))
        if abs(factor - 1) > _NOTABLE:
            facts.append(f"{photograph.name} {factor:.2f}")
    if not facts:
        return result, []
    return result, [f"exposures in the pixels, over those stated: {', '.join(facts)}"]


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
