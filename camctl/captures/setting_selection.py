"""Choosing among the settings that a camera really has.

Sets of realisable settings are judged by what they would give, the shortest exposure included, and
not by how near each ratio comes: on a coarse grid the nearest ratios are rarely the best set.  Time
is used first, then gain; the aperture only where that was asked for.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from camctl.captures.request import CapturePlan, CaptureRequest
from camctl.controls import Control, ExposureControls, ExposureSetting
from camctl.errors import CaptureError
from camctl.exposure.grid_search import SettingsGrid, solve_settings
from camctl.exposure.objective import Objective
from camctl.response.desired import DesiredResponse

#: How far below its limit the shortest exposure may lie to fit the camera's steps, in stops.
BASE_SLACK_STOPS = 1 / 6
_BASES = 24
_KEPT_BASES = 4
_NEIGHBOURS = 3
_GAINS = 64
#: A given exposure that is met less well than this is worth a warning.
_NOTABLE = 0.01

Score: TypeAlias = Callable[[Sequence[ExposureSetting]], float]


@dataclass(frozen=True)
class SettingChooser:
    """Finds the settings for `ratios` on one camera; the lowest `score` wins."""

    controls: ExposureControls
    request: CaptureRequest
    ratios: tuple[float, ...]
    score: Score

    @property
    def is_plain(self) -> bool:
        """Whether shutter times, and gain beyond them, are all that may be set."""
        return self.request.mains_hz is None and self._closed() is None

    def best(self, limit_s: float, evaluations: int) -> tuple[ExposureSetting, ...]:
        """Return the set of the lowest score found within about that many evaluations.

        Every base is tried with its nearest settings; around the best of them the neighbours of
        each setting are tried, all together where they are few, else one after another.
        """
        bases = self._bases(limit_s)
        rounded = [tuple(options[0] for options in self._options(base)) for base in bases]
        scores = [self.score(settings) for settings in rounded]
        ranked = sorted(range(len(bases)), key=scores.__getitem__)  # equals: the longer base first
        left = evaluations - len(bases)
        champion, best_score = rounded[ranked[0]], scores[ranked[0]]
        for index in ranked[:_KEPT_BASES]:
            options = self._options(bases[index])
            if math.prod(map(len, options)) <= left // _KEPT_BASES:
                candidates: Iterable[tuple[ExposureSetting, ...]] = itertools.product(*options)
            else:
                start = rounded[index]
                candidates = (
                    (*start[:place], other, *start[place + 1 :])
                    for place in range(1, len(start))
                    for other in options[place][1:]
                )
            for candidate in itertools.islice(candidates, max(1, left // _KEPT_BASES)):
                score = self.score(candidate)
                if score < best_score * (1 - 1e-9):
                    best_score, champion = score, candidate
        return tuple(sorted(champion, key=lambda setting: setting.exposure))

    def _bases(self, limit_s: float) -> list[ExposureSetting]:
        """Return settings for the shortest exposure, best first."""
        time, gain = self.controls.time_s, self.controls.gain.nearest(1.0)
        f_number = self._closed()
        if self.request.base_s is not None:
            return [ExposureSetting(_given_base(time, limit_s), gain, f_number)]
        times = self._whole_periods(time.between(limit_s * 2.0**-BASE_SLACK_STOPS, limit_s, _BASES))
        if not times:
            below = time.between(time.minimum, limit_s, 1)
            times = below or (time.minimum,)
        return [ExposureSetting(t, gain, f_number) for t in reversed(times)]

    def _closed(self) -> float | None:
        aperture = self.controls.f_number
        return aperture.maximum if aperture is not None and self.request.use_aperture else None

    def _options(self, base: ExposureSetting) -> list[list[ExposureSetting]]:
        """Return, for each ratio, the settings around it, the nearest first."""
        found: list[list[ExposureSetting]] = [[base]]
        for ratio in self.ratios[1:]:
            wanted = base.exposure * ratio
            settings = self._reach(base, ratio)
            settings.sort(key=lambda setting: abs(math.log(setting.exposure / wanted)))
            found.append(settings)
        return found

    def _reach(self, base: ExposureSetting, ratio: float) -> list[ExposureSetting]:
        time, gain = self.controls.time_s, self.controls.gain
        time_s = base.time_s * ratio
        if time_s <= time.maximum * (1 + _NOTABLE):
            times = self._whole_periods(time.near(time_s, _NEIGHBOURS))
            return [ExposureSetting(t, base.gain, base.f_number) for t in times]
        apertures = [base.f_number]
        if base.f_number is not None and self.controls.f_number is not None:
            lens = self.controls.f_number
            apertures += list(reversed(lens.between(lens.minimum, base.f_number * 0.999, 8)))
        for f_number in apertures:
            opened = (base.f_number / f_number) ** 2 if f_number and base.f_number else 1.0
            needed = time_s / time.maximum / opened
            if needed > gain.maximum / base.gain * (1 + _NOTABLE):
                continue
            gains = [g for g in gain.near(base.gain * needed, 2 * _NEIGHBOURS) if g >= base.gain]
            settings = [
                ExposureSetting(t, g, f_number)
                for g in gains
                for t in time.near(time_s * base.gain / g / opened, _NEIGHBOURS)
            ]
            wanted = base.exposure * ratio
            settings.sort(key=lambda setting: abs(math.log(setting.exposure / wanted)))
            return settings[:_NEIGHBOURS]
        widest = apertures[-1]
        opened = (base.f_number / widest) ** 2 if widest and base.f_number else 1.0
        most = time.maximum * gain.maximum / base.gain * opened / base.time_s
        raise CaptureError(
            f"exposure {ratio:.6g} x {base.time_s:.6g} s is beyond the camera's controls",
            hint=f"the nearest possible is {most:.6g} x; pick a smaller range or fewer exposures, "
            f"or shorten the base with --compensation {math.log2(most / ratio):.1f}",
        )

    def _whole_periods(self, times: tuple[float, ...]) -> tuple[float, ...]:
        """Replace times of a flicker period or more by whole periods, where there are any."""
        if self.request.mains_hz is None:
            return times
        period = 0.5 / self.request.mains_hz
        whole: set[float] = set()
        for time_s in times:
            if time_s >= period:
                near = self.controls.time_s.nearest(round(time_s / period) * period)
                if abs(near / period - round(near / period)) < _NOTABLE:
                    whole.add(near)
        return tuple(sorted(whole)) or times

    def warnings(self, plan: CapturePlan) -> list[str]:
        """Return what a person should know of the chosen settings."""
        found = []
        if self.request.base_s is not None:
            wanted = self.request.base_s * 2.0**self.request.compensation_stops
            if abs(plan.base_s / wanted - 1) > _NOTABLE:
                found.append(f"the base is {plan.base_s:.6g} s, {wanted:.6g} s is not on offer")
        if self.request.ratios is not None:
            for wanted, applied in zip(plan.ratios, plan.exposures, strict=True):
                if abs(applied / wanted - 1) > _NOTABLE:
                    found.append(f"ratio {wanted:.6g} becomes {applied:.6g} on this camera")
        if self.request.mains_hz is not None:
            period = 0.5 / self.request.mains_hz
            for setting in plan.settings:
                count = setting.time_s / period
                if abs(count - round(count)) > _NOTABLE * max(1.0, count) or count < 0.5:
                    found.append(
                        f"{setting.time_s:.4g} s is no whole number of the lamps' flicker periods "
                        f"of {period:.4g} s"
                    )
        return found


def _given_base(time: Control, base_s: float) -> float:
    """Return the shutter time nearest to a base that a person gave; CaptureError out of reach."""
    nearest = time.nearest(base_s)
    if not time.minimum * 0.99 <= base_s <= time.maximum * 1.01:
        raise CaptureError(
            f"a base exposure of {base_s:.6g} s is beyond the camera's "
            f"{time.minimum:.6g} to {time.maximum:.6g} s",
            hint=f"the nearest possible is {nearest:.6g} s",
        )
    return nearest


def best_of_choices(
    controls: ExposureControls,
    request: CaptureRequest,
    desired: DesiredResponse,
    count: int,
    limit_s: float,
) -> tuple[ExposureSetting, ...]:
    """Return the best set on a list of shutter times: searched there, not rounded from a table.

    Gain takes over beyond the longest time.  The shortest exposure is the longest on the list that
    `limit_s` allows, or one up to a third of a stop below it.

    Raises:
        UsageError: the list is shorter than `count`, or a time budget is too short
        CaptureError: the list has too few exposures at or above the base

    """
    gain = controls.gain.nearest(1.0)
    times = controls.time_s.between(controls.time_s.minimum, controls.time_s.maximum, 1 << 16)
    offered = {time_s: ExposureSetting(time_s, gain) for time_s in times}
    for more in controls.gain.between(gain, controls.gain.maximum, _GAINS):
        offered.setdefault(times[-1] * more / gain, ExposureSetting(times[-1], more))
    base_s = max((time_s for time_s in times if time_s <= limit_s * (1 + 1e-9)), default=times[0])
    least_s = base_s * 2.0 ** (-1 / 3)
    if request.base_s is not None:
        least_s = base_s = _given_base(controls.time_s, limit_s)
    exposures = sorted(offered)
    if count <= len(exposures) and exposures[-count] < least_s * (1 - 1e-9):
        stops = math.floor(10 * math.log2(exposures[-count] / base_s)) / 10
        raise CaptureError(
            f"a shortest exposure of {base_s:.4g} s leaves fewer than {count} on this camera, "
            f"which ends at {exposures[-1]:.4g} s",
            hint=f"take fewer exposures, or shorten it with --compensation {stops:.1f}",
        )
    found = solve_settings(
        controls.levels,
        desired,
        count,
        SettingsGrid(
            exposures,
            base=(least_s, base_s),
            total_limit=math.inf if request.time_budget_s is None else request.time_budget_s,
        ),
        objective=Objective(request.levels_wanted),
    )
    # The search merges settings that are one exposure; each of its values is one on offer.
    return tuple(offered[min(offered, key=lambda on: abs(on - value))] for value in found.settings)
