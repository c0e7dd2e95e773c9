"""Choosing among the settings that a camera really has.

Whole sets of settings are compared by their result, the shortest exposure included, and not by how
close each ratio is: on a coarse grid the nearest ratios are rarely the best set.  Shutter time is
changed first, then gain; the aperture only on request.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

from camctl.errors import UnreachableExposureError, UsageError
from camctl.exposure.exposure_choices import SAME, SettingsGrid
from camctl.exposure.goal import CaptureRequest
from camctl.exposure.grid_search import solve_settings
from camctl.exposure.objective import ExposureProblem, Objective
from camctl.exposure.solver import Solution
from camctl.interface.controls import Choices, Control, ExposureControls, ExposureSetting
from camctl.model.response.desired import DesiredResponse

BASE_SLACK_STOPS = 1 / 6
"""The shortest exposure may be this far below its limit to fit the camera's steps, in stops."""

BASE_SLACK_ON_LIST_STOPS = 1 / 3
"""The same on a list of shutter times, where a step is often a third of a stop."""

#: Shutter times tried for the shortest exposure, each with the settings nearest to the ratios, and
#: the number of them, the best ones, for which neighbouring settings are tried, too.
_BASES, _KEPT_BASES = 24, 4
#: Settings tried for each ratio.
_NEIGHBOURS = 3
#: Gains and apertures that extend the shutter times, at most.
_GAINS, _APERTURES = 64, 8
#: Exposures on such a list that is made for a camera without one, at most: 16 stops of sixths.
_LISTED = 96
#: Sets that are compared where only the ratios count.
_MOST_ROUNDED = 100
#: Relative difference between requested and applied exposure from which there is a warning.
_WARNING_DIFFERENCE = 0.01
#: Levels that the longest exposure gives to the darkest light of a range that the scene decides.
_SHADOW_LEVELS = 2.0
#: Such exposures are no farther apart than this share of what one holds: else light between them
#: would have few levels.
_OVERLAP = 1 / 8

Score: TypeAlias = Callable[[Sequence[ExposureSetting]], float]


def relative_exposures(settings: Sequence[ExposureSetting]) -> tuple[float, ...]:
    """Return the stated exposures of settings relative to the smallest, in their order."""
    smallest = min(setting.exposure for setting in settings)
    return tuple(setting.exposure / smallest for setting in settings)


@dataclass(frozen=True)
class SettingChooser:
    """Finds the settings for `ratios` on one camera; the lowest `score` wins."""

    controls: ExposureControls
    request: CaptureRequest
    ratios: tuple[float, ...]
    score: Score

    @property
    def sets_time_only(self) -> bool:
        """Whether shutter times, and gain beyond them, are all that may be set."""
        return self.request.mains_hz is None and self._smallest_aperture() is None

    def reaches(self, limit_s: float) -> bool:
        """Return whether a shortest exposure of `limit_s` leaves the longest one possible."""
        largest_s = self._largest_exposure(self.controls.gain.nearest(1.0))
        return limit_s * self.ratios[-1] <= largest_s * (1 + _WARNING_DIFFERENCE)

    def best(self, limit_s: float, evaluations: int) -> tuple[ExposureSetting, ...]:
        """Return the set with the lowest score found within about `evaluations` evaluations.

        Every shortest exposure is tried with its nearest settings; around the best of them the
        neighbours of each setting are tried: all combinations where they are few, else one
        setting at a time.  `limit_s` is the longest shutter time of the shortest exposure, s; where
        the request leaves it to metering, it is shortened until the longest exposure is possible.

        Raises:
            CaptureError: an exposure is beyond the camera's controls
        """
        bases = self._bases(self._possible_limit_s(limit_s))
        rounded = [tuple(options[0] for options in self._options(base)) for base in bases]
        scores = [self.score(settings) for settings in rounded]
        ranked = sorted(range(len(bases)), key=scores.__getitem__)  # equals: the longer base first
        remaining = evaluations - len(bases)
        best, best_score = rounded[ranked[0]], scores[ranked[0]]
        for index in ranked[:_KEPT_BASES]:
            options = self._options(bases[index])
            if math.prod(map(len, options)) <= remaining // _KEPT_BASES:
                candidates: Iterable[tuple[ExposureSetting, ...]] = itertools.product(*options)
            else:
                start = rounded[index]
                candidates = (
                    (*start[:place], other, *start[place + 1 :])
                    for place in range(1, len(start))
                    for other in options[place][1:]
                )
            for candidate in itertools.islice(candidates, max(1, remaining // _KEPT_BASES)):
                score = self.score(candidate)
                if score < best_score * (1 - SAME):
                    best_score, best = score, candidate
        return tuple(sorted(best, key=lambda setting: setting.exposure))

    def _bases(self, limit_s: float) -> list[ExposureSetting]:
        """Return settings for the shortest exposure, the longest first."""
        time, gain = self.controls.time_s, self.controls.gain.nearest(1.0)
        f_number = self._smallest_aperture()
        if self.request.base_s is not None:
            return [ExposureSetting(given_base(time, limit_s), gain, f_number)]
        times = time.between(limit_s * 2.0**-BASE_SLACK_STOPS, limit_s, _BASES)
        if not times:
            times = (at_most(time, limit_s),)
        times = self._whole_periods(times, count=_whole_below)
        return [ExposureSetting(t, gain, f_number) for t in reversed(times)]

    def _largest_exposure(self, gain: float) -> float:
        """Return the largest exposure that there is over one second at `gain`, the base's, s."""
        controls, f_number = self.controls, self._smallest_aperture()
        lens = controls.f_number
        opening = (f_number / lens.minimum) ** 2 if f_number and lens is not None else 1.0
        return controls.time_s.maximum * controls.gain.maximum / gain * opening

    def _possible_limit_s(self, limit_s: float) -> float:
        """Return the longest shortest exposure from which the longest one is possible, s.

        Raises:
            CaptureError: there is none
        """
        time, largest_ratio = self.controls.time_s, self.ratios[-1]
        if self.request.base_s is not None:
            return limit_s  # as given: what is beyond the camera is refused
        largest_s = self._largest_exposure(self.controls.gain.nearest(1.0))
        if largest_s * (1 + _WARNING_DIFFERENCE) < time.minimum * largest_ratio:
            raise UnreachableExposureError(
                f"exposures up to 1:{largest_ratio:.6g} are beyond the camera's controls, which "
                f"reach 1:{largest_s / time.minimum:.6g}",
                hint="choose a smaller range or fewer exposures",
            )
        return min(limit_s, largest_s / largest_ratio)

    def _smallest_aperture(self) -> float | None:
        """Return the largest f-number, where the aperture may be changed."""
        aperture = self.controls.f_number
        return aperture.maximum if aperture is not None and self.request.use_aperture else None

    def _options(self, base: ExposureSetting) -> list[list[ExposureSetting]]:
        """Return, for each ratio, the settings around it, the nearest first."""
        found: list[list[ExposureSetting]] = [[base]]
        for ratio in self.ratios[1:]:
            settings = self._settings_near(base, ratio)
            found.append(_nearest_first(settings, base.exposure * ratio))
        return found

    def _settings_near(self, base: ExposureSetting, ratio: float) -> list[ExposureSetting]:
        time, gain = self.controls.time_s, self.controls.gain
        time_s = base.time_s * ratio
        if time_s <= time.maximum * (1 + _WARNING_DIFFERENCE):
            times = self._whole_periods(time.near(time_s, _NEIGHBOURS))
            return [ExposureSetting(t, base.gain, base.f_number) for t in times]
        apertures = [base.f_number]
        if base.f_number is not None and self.controls.f_number is not None:
            lens = self.controls.f_number
            wider = lens.between(lens.minimum, base.f_number * 0.999, _APERTURES)
            apertures += dict.fromkeys([*reversed(wider), lens.minimum])
        for f_number in apertures:
            # The aperture lets in this many times the light of the base exposure.
            opening = (base.f_number / f_number) ** 2 if f_number and base.f_number else 1.0
            gain_ratio = time_s / time.maximum / opening
            if gain_ratio > gain.maximum / base.gain * (1 + _WARNING_DIFFERENCE):
                continue
            gains = gain.near(base.gain * max(1.0, gain_ratio), 2 * _NEIGHBOURS)
            settings = [
                ExposureSetting(t, g, f_number)
                for g in gains
                if g >= base.gain
                for t in time.near(time_s * base.gain / g / opening, _NEIGHBOURS)
            ]
            return _nearest_first(settings, base.exposure * ratio)[:_NEIGHBOURS]
        largest = self._largest_exposure(base.gain) / base.time_s
        base_s = time.between(time.minimum, base.time_s * largest / ratio, 1)
        raise UnreachableExposureError(
            f"exposure {ratio:.6g} x {base.time_s:.6g} s is beyond the camera's controls",
            hint=f"the largest possible is {largest:.6g} x; choose a smaller range or fewer "
            "exposures" + (", or this shortest exposure" if base_s else ""),
            remedies={"base_s": float(f"{base_s[0]:.6g}")} if base_s else {},
        )

    def _whole_periods(
        self, times: tuple[float, ...], count: Callable[[float], int] = round
    ) -> tuple[float, ...]:
        """Replace times of a flicker period or more by whole periods, where there are any.

        `count` makes the whole number of periods from a number of them.
        """
        if self.request.mains_hz is None:
            return times
        period_s = 0.5 / self.request.mains_hz
        whole: set[float] = set()
        for time_s in times:
            if time_s >= period_s:
                near = self.controls.time_s.nearest(count(time_s / period_s) * period_s)
                if abs(near / period_s - round(near / period_s)) < _WARNING_DIFFERENCE:
                    whole.add(near)
        return tuple(sorted(whole)) or times


def _whole_below(number: float) -> int:
    """Return the largest whole number that is not above `number` (>= 1)."""
    return math.floor(number * (1 + SAME))


def reach_shadows(
    controls: ExposureControls,
    request: CaptureRequest,
    desired: DesiredResponse,
    settings: tuple[ExposureSetting, ...],
) -> tuple[tuple[ExposureSetting, ...], tuple[float, ...]] | None:
    """Return settings that show the darkest light of the desired range, and their ratios.

    The desired response may ask for so few levels in the dark that the most accurate exposures show
    nothing of it.  Then the last ones are replaced by longer ones at equal ratios, as few as leave
    no gap; what is beyond the camera's longest time and highest gain stays dark.

    Args:
        controls: of the camera
        request: what the user asks for
        desired: the response, with the range that the light has
        settings: the chosen ones, in ascending order of exposure

    Returns:
        None where `settings` show the light, or nothing may be changed
    """
    shortest, levels = settings[0], controls.levels.levels
    exposures = [setting.exposure / shortest.exposure for setting in settings]
    is_fixed = request.time_budget_s is not None or request.accuracy is not None
    needed = float(levels[0]) / desired.e_min if desired.e_min else math.inf
    possible = controls.time_s.maximum * controls.gain.maximum / shortest.time_s / shortest.gain
    longest = min(_SHADOW_LEVELS * needed, possible)
    if is_fixed or len(settings) < 2 or exposures[-1] >= min(needed, longest * (1 - SAME)):
        return None
    step = max(2.0, _OVERLAP * float(levels[-1] / levels[0]))
    count = min(len(settings) - 1, math.ceil(math.log(longest) / math.log(step) - SAME))
    chain = [longest ** (place / count) for place in range(1, count + 1)]
    ratios = tuple(sorted([*exposures[: len(exposures) - count], *chain]))

    def deviation(found: Sequence[ExposureSetting]) -> float:
        pairs = zip(found, ratios, strict=True)
        return max(abs(math.log(s.exposure / found[0].exposure / ratio)) for s, ratio in pairs)

    chooser = SettingChooser(controls, request, ratios, deviation)
    return chooser.best(shortest.time_s, _MOST_ROUNDED), ratios


def _nearest_first(settings: list[ExposureSetting], exposure: float) -> list[ExposureSetting]:
    return sorted(settings, key=lambda setting: abs(math.log(setting.exposure / exposure)))


def given_base(time: Control, base_s: float) -> float:
    """Return the shutter time nearest to a given base exposure.

    Raises:
        CaptureError: it is beyond the shortest or longest shutter time
    """
    nearest = time.nearest(base_s)
    if not time.minimum * 0.99 <= base_s <= time.maximum * 1.01:
        raise UnreachableExposureError(
            f"a base exposure of {base_s:.6g} s is beyond the camera's "
            f"{time.minimum:.6g} to {time.maximum:.6g} s",
            hint=f"the nearest possible is {nearest:.6g} s",
        )
    return nearest


def at_most(time: Control, limit_s: float) -> float:
    """Return the longest time up to a limit, or the shortest that there is."""
    return (*time.between(time.minimum, limit_s * (1 + SAME), 1), time.minimum)[0]


def _listed_exposures(controls: ExposureControls) -> dict[float, ExposureSetting]:
    """Return the settings of a list of shutter times by their true exposure, s at the base gain.

    Gain extends the longest time.
    """
    gain = controls.gain.nearest(1.0)
    times = controls.time_s.between(controls.time_s.minimum, controls.time_s.maximum, 1 << 16)
    settings = [ExposureSetting(time_s, gain) for time_s in times]
    gains = controls.gain.between(gain, controls.gain.maximum, _GAINS)
    settings += [ExposureSetting(times[-1], more) for more in gains]
    # The first of equal exposures is kept: time is changed before gain.
    return {controls.exposure(each) / gain: each for each in reversed(settings)}


def listed_up_to_longest(
    controls: ExposureControls, limit_s: float, count: int, most_sets: int
) -> ExposureControls:
    """Return the controls with lists alone: times from `limit_s` to the longest, and gains from it.

    They are `BASE_SLACK_STOPS` apart, or so far that `count` of them make up to about `most_sets`
    sets with one shortest exposure; at least `count`, where the camera has so many.
    """
    times, gain = controls.time_s, controls.gain.nearest(1.0)
    if isinstance(times, Choices):
        return controls
    size = count
    while size < _LISTED and math.comb(size, count - 1) <= most_sets:
        size += 1
    base_s = at_most(times, limit_s)
    stops = math.log2(times.maximum / base_s * controls.gain.maximum / gain)
    step = max(BASE_SLACK_STOPS, stops / size)

    def listed(control: Control, least: float, fewest: int) -> Choices:
        steps = max(math.ceil(math.log2(control.maximum / least) / step), fewest)
        found = {control.nearest(control.maximum * 2.0 ** (-k * step)) for k in range(steps)}
        return Choices(tuple(sorted({least, *found})))

    while True:
        gains = listed(controls.gain, gain, 0)
        shorter = listed(times, base_s, count - len(gains.values) + 1)
        if len(shorter.values) + len(gains.values) - 1 <= size or step >= stops:
            return replace(controls, time_s=shorter, gain=gains)
        step *= 2**BASE_SLACK_STOPS


def longest_base_on_list(controls: ExposureControls, count: int) -> float:
    """Return the longest time on a list from which on it has `count` exposures, s.

    The shortest time, where the list has fewer.
    """
    available = _listed_exposures(controls)
    exposures = sorted(available)
    setting = available[exposures[-min(count, len(exposures))]]
    return setting.time_s


def search_choices(
    controls: ExposureControls,
    request: CaptureRequest,
    desired: DesiredResponse,
    count: int,
    limit_s: float,
    ratios: tuple[float, ...] | None = None,
) -> tuple[ExposureSetting, ...]:
    """Return the best set on a list of shutter times: searched there, not rounded from a table.

    Gain extends the longest time.  The shortest exposure is the longest time on the list that
    `limit_s` allows, or one up to a third of a stop below it.  The search begins near `ratios`, the
    best of all exposures, which are searched first where they are not known.

    Raises:
        UsageError: the list is shorter than `count`, or a time budget is too short
        CaptureError: the list has too few exposures from the base on
    """
    gain = controls.gain.nearest(1.0)

    def true_s(time_s: float) -> float:
        return controls.exposure(ExposureSetting(time_s, gain)) / gain

    available = _listed_exposures(controls)
    base_s = true_s(at_most(controls.time_s, limit_s))
    least_s = base_s * 2.0**-BASE_SLACK_ON_LIST_STOPS
    if request.base_s is not None:
        least_s = base_s = true_s(given_base(controls.time_s, limit_s))
    exposures = sorted(available)
    if count <= len(exposures) and exposures[-count] < least_s * (1 - SAME):
        raise UnreachableExposureError(
            f"a shortest exposure of {base_s:.4g} s leaves fewer than {count} exposures up to "
            f"{exposures[-1]:.4g} s, the longest on this camera",
            hint="take fewer exposures, or this shortest exposure",
            remedies={
                "count": None,
                "base_s": float(f"{longest_base_on_list(controls, count):.6g}"),
            },
        )
    total_s = math.inf if request.time_budget_s is None else request.time_budget_s
    shortest_s = sum([each for each in exposures if each >= least_s * (1 - SAME)][:count])
    if shortest_s > total_s:
        raise UsageError(
            f"{count} exposures of this camera take {shortest_s:.4g} s at least, more than the "
            f"{total_s:.4g} s that the time budget leaves for shutter times",
            hint="allow more time, or take fewer exposures",
        )
    objective, ideal = Objective(request.levels_wanted), None
    if ratios is not None:
        problem = ExposureProblem(controls.levels, desired, count, objective)
        ideal = Solution.of(problem, ratios)
    found = solve_settings(
        controls.levels,
        desired,
        count,
        SettingsGrid(exposures, base=(least_s, base_s), total_limit=total_s),
        objective=objective,
        ideal=ideal,
    )
    # The search merges settings of one exposure; each of its values is one of `available`.
    return tuple(
        available[min(available, key=lambda exposure: abs(exposure - value))]
        for value in found.settings
    )
