"""What accuracy costs in time: the front of one camera for one desired response.

Each point has the settings that give the most effective levels in its time, over all sets of
settings of the camera: its times, gains, frame interval, readout and control delay, and its noise.
Where the noise is unknown, quantisation alone decides (`Front.has_noise`).
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter, ValidationError

from camctl.errors import DataError, UnreachableExposureError, UsageError
from camctl.exposure.accuracy import (
    COUNTS,
    TooInaccurateError,
    accurate_sets,
    least_time,
    most_accurate,
    sets_within,
)
from camctl.exposure.accurate.judge import JUDGED_FRAMES
from camctl.exposure.accurate.sets import AccurateSets
from camctl.exposure.cache import kept
from camctl.exposure.exposure_choices import (
    SAME,
    Rated,
    Shot,
    Shots,
)
from camctl.exposure.goal import DEFAULT_COUNT, CaptureRequest
from camctl.exposure.noise import noisy_effective_levels
from camctl.exposure.search.wall_time import predicted_wall_s, timed_problem, without_costs
from camctl.interface.controls import ExposureControls, ExposureSetting
from camctl.model.effective import EffectiveCamera
from camctl.model.noise import FrameNoise
from camctl.model.response.desired import DesiredResponse

VERSION = 21
"""Part of the key of a kept point; it changes where the search finds other settings."""

POINTS = 12
"""Points of a front, evenly over the logarithm of the time."""

SMOOTH_LEVELS = 66.0
"""Effective levels at which noise is just not seen: its standard deviation in the brightness of a
display with a contrast of 1:100, ln(100) / (sqrt(12) L), is 2 %, Weber's fraction of the eye."""

#: Fewest effective levels of the recommended point, or as many as so many exposures have.
_FLOOR = SMOOTH_LEVELS, DEFAULT_COUNT
#: Factors on the effective levels asked of the search until the camera's own steps reach them.
_MORE_LEVELS = (1.0, 1.002, 1.006, 1.02)
#: Relative change of exposures, by rounding, that changes the effective levels by at most 0.1 %.
SAME_LEVELS = 2e-3
#: Share of the levels that rounding down to the camera's steps may cost.
_LOST = 1e-3
#: Attempts to fit the camera's own steps into a time budget.
ATTEMPTS = 6
#: Relative difference up to which two times are the same: more than float64 rounds.
SAME_TIME = 1e-8

Progress = Callable[[float], None]


@dataclass(frozen=True)
class FrontPoint:
    """The most accurate settings within a time.

    Attributes:
        settings: by ascending exposure
        ratios: the exposures before they were rounded to the camera's steps, relative to the
            shortest
        time_s: predicted time from the request until the last frame is here, s
        levels: predicted effective levels, the noise counted in
    """

    settings: tuple[ExposureSetting, ...]
    ratios: tuple[float, ...]
    time_s: float
    levels: float

    @property
    def n(self) -> int:
        """Number of exposures."""
        return len(self.settings)


_POINTS = TypeAdapter(tuple[FrontPoint, ...])


def _read_points(path: Path, *, least: int) -> tuple[FrontPoint, ...]:
    """Return the points in a file, `least` at least.

    Raises:
        DataError: it is damaged
    """
    with suppress(ValidationError):
        points = _POINTS.validate_json(path.read_bytes())
        if len(points) >= least:
            return points
    raise DataError(f"cached settings {path} are damaged")


def _read_levels(path: Path) -> float:
    """Return the effective levels in a file.

    Raises:
        DataError: it is damaged
    """
    with suppress(ValueError):
        levels = float(path.read_text("utf-8"))
        if 0 < levels < math.inf:
            return levels
    raise DataError(f"cached effective levels {path} are damaged")


class Front:
    """The settings of most effective levels for each time.

    What is asked of it is computed when it is asked for, and then kept, on disk too.

    Args:
        controls: of the camera
        desired: the desired response; its E = 1 is full scale of the shortest exposure
        limit_s: longest shutter time of the shortest exposure, s
        request: what else the user asks for: the number of exposures, a given base exposure, the
            frequency of the mains; None: nothing
        before: the setting of the frame before, such as the metering frame

    Attributes:
        has_noise: whether the camera's noise is known and counted in
        limit_s: longest shutter time of the shortest exposure, s

    Raises:
        CaptureError: the given base exposure is beyond the camera's shutter times
    """

    def __init__(
        self,
        controls: ExposureControls,
        desired: DesiredResponse,
        limit_s: float,
        *,
        request: CaptureRequest | None = None,
        before: ExposureSetting | None = None,
    ) -> None:
        self.controls, self.desired, self._before = controls, desired, before
        self.limit_s = limit_s
        self._request = request or CaptureRequest()
        self.has_noise = controls.noise is not None
        count = self._request.count
        self._counts = COUNTS if count is None else (count,)
        self._problem = timed_problem(
            controls, desired, limit_s, request=self._request, before=before
        )
        self._unit_s = self._problem.available.unit_s
        self._answers: dict[str, tuple[FrontPoint, ...]] = {}

    @property
    def points(self) -> tuple[FrontPoint, ...]:
        """Points from the fastest set to the most accurate one, ascending in time and levels."""
        return self._kept("points", self._points)

    def _points(self) -> tuple[FrontPoint, ...]:
        sets, fixed = self._sets, self._problem.available.costs.fixed
        first, last = sets.least_time(min(self._counts)), sets.longest_of_use
        times = np.geomspace(first + fixed, max(first, last) + fixed, POINTS) - fixed
        known = self.recommended
        rated = sets.front(times.tolist(), self._shots(known.settings))
        found = [known, *map(self._point, rated)]
        found.sort(key=lambda point: (point.time_s, -point.levels))
        front: list[FrontPoint] = []
        for point in found:
            if not front or point.levels > front[-1].levels:
                front.append(point)
        return tuple(front)

    @property
    def recommended(self) -> FrontPoint:
        """The point beyond which more time brings no more than averaging does.

        It is the fastest one whose levels^2 / time is within 3 % of the largest: effective levels
        of averages grow as the square root of the time.  Where noise would be seen in it, since
        many poor frames pay best in the dark, it is the fastest point with `SMOOTH_LEVELS`, or with
        the accuracy of `DEFAULT_COUNT` exposures where these have fewer.
        """

        def find() -> tuple[FrontPoint, ...]:
            floor = _FLOOR if self._request.count is None else None
            return (self._point(self._sets.recommended(floor)),)

        return self._kept("recommended", find)[0]

    @property
    def most_accurate(self) -> FrontPoint:
        """The fastest point within 0.5 % of the most effective levels, shutter times counted."""

        def find() -> tuple[FrontPoint, ...]:
            found = most_accurate(
                accurate_sets(without_costs(self._problem, self.controls), self._counts),
                judged=False,  # but with the camera's steps, where it is of many frames
            )
            return (self._point(found, judges_many=True),)

        return self._kept("most accurate", find)[0]

    def at_time(self, budget_s: float) -> FrontPoint:
        """Return the most accurate settings that take a time budget at most.

        Raises:
            UsageError: no settings are over as soon as that; says the least time
            CaptureError: with the camera's own steps none fit
        """
        return self._kept(f"time {budget_s!r}", lambda: (self._within(budget_s),))[0]

    def levels_within(self, time_s: float) -> float | None:
        """Return the most effective levels of any number of exposures in a time.

        None: no settings are over as soon as that.  It is rated without the camera's steps.
        """

        def find() -> tuple[FrontPoint, ...]:
            sets = accurate_sets(self._problem, COUNTS)
            limit = time_s / self._unit_s - self._problem.available.costs.fixed
            if sets.least_time(min(COUNTS)) > limit:
                return ()
            return (self._point(sets.within(limit, thorough=False)),)

        found = self._kept(f"levels within {time_s!r}", find, least=0)
        return found[0].levels if found else None

    def _kept(
        self, question: str, find: Callable[[], tuple[FrontPoint, ...]], *, least: int = 1
    ) -> tuple[FrontPoint, ...]:
        """Return the points that answer a question: known, from the cache, or found now.

        `least` is the number that there must be: an answer may be that there is none.
        """
        if question not in self._answers:
            self._answers[question] = kept(
                self._file(question),
                partial(_read_points, least=least),
                find,
                lambda points: _POINTS.dump_json(points).decode(),
            )
        return self._answers[question]

    def levels_with(self, exposures: Sequence[float], noise: Sequence[FrameNoise]) -> float:
        """Return the exact effective levels of exposures, kept on disk as the points are.

        Args:
            exposures: relative to each other
            noise: of each
        """

        def find() -> float:
            relative = [exposure / min(exposures) for exposure in exposures]
            camera = EffectiveCamera.of(self.controls.levels, relative)
            return noisy_effective_levels(camera, self.desired, noise)

        return kept(
            self._file(f"levels with {tuple(exposures)!r} {tuple(noise)!r}"),
            _read_levels,
            find,
            repr,
        )

    @property
    def is_smooth(self) -> bool:
        """Whether noise dithers the quantiser: levels change smoothly with the exposures."""
        return bool(self._sets.dithered)

    def levels_like(
        self, levels: float, settings: Sequence[ExposureSetting], exposures: Sequence[float]
    ) -> float:
        """Return about the levels of settings, which have `levels`, if they had other exposures.

        They change as the estimate does.

        Args:
            levels: of the settings as they are
            settings: by ascending exposure
            exposures: others, near theirs, in their order
        """
        shots = self._shots(settings)
        others = tuple(s._replace(exposure=e) for s, e in zip(shots, exposures, strict=True))
        return levels * self._sets.judge.estimated(others) / self._sets.judge.estimated(shots)

    def _file(self, question: str) -> str:
        parts = repr((VERSION, *self._identity, question)).encode()
        return f"front-{hashlib.sha256(parts).hexdigest()[:24]}"

    @property
    def _identity(self) -> tuple[object, ...]:
        """Everything that decides the points."""
        controls, problem = self.controls, self._problem
        return (
            *(*problem.identity, problem.available.costs, self._counts, self._before),
            *(controls.time_s, controls.gain, controls.true_exposures, controls.timing),
            *(controls.frame_interval_s, controls.delay_frames),
        )

    @property
    def _sets(self) -> AccurateSets:
        return accurate_sets(self._problem, self._counts)

    @property
    def chosen(self) -> FrontPoint:
        """What the request asks for: an accuracy, a time, a number, or the recommended point.

        Raises what `at_time` and `at_accuracy` raise.
        """
        request = self._request
        if request.accuracy is not None:
            budget_s = math.inf if request.time_budget_s is None else request.time_budget_s
            return self.at_accuracy(request.accuracy, budget_s=budget_s)
        if request.time_budget_s is not None:
            return self.at_time(request.time_budget_s)
        return self.recommended if request.count is None else self.most_accurate

    def _within(self, budget_s: float) -> FrontPoint:
        allowed_s = budget_s
        for _ in range(ATTEMPTS):
            try:
                limit = self._limit(allowed_s)
                rated = most_accurate(sets_within(self._problem, self._counts, limit), limit)
                point = self._point(rated, judges_many=True)
            except UsageError:
                if allowed_s == budget_s:
                    raise
                break
            over_s = point.time_s - budget_s
            if over_s <= SAME_TIME * budget_s:
                return point
            rounded = self._shortest_steps(point)
            fits = rounded.time_s <= budget_s * (1 + SAME_TIME)
            if fits and rounded.levels > (1 - _LOST) * point.levels:
                return rounded
            allowed_s = min(allowed_s - over_s, allowed_s * (1 - 1e-3))
        if fits:
            return rounded
        raise UnreachableExposureError(
            f"no settings of this camera were found that fit into {budget_s:.4g} s",
            hint="allow more time, or take fewer exposures",
        )

    def _limit(self, budget_s: float) -> float:
        """Return a time budget in the unit of the problem, without the fixed time of a set."""
        limit = budget_s / self._unit_s * (1 + SAME_TIME / 10)
        return limit - self._problem.available.costs.fixed

    def _shortest_steps(self, point: FrontPoint) -> FrontPoint:
        """Return a point with its times rounded down to the camera's steps."""
        least = min(self.controls.exposure(setting) for setting in point.settings)
        shorter = []
        for setting in point.settings:
            is_base = self.controls.exposure(setting) <= least * (1 + SAME_TIME)
            below = self.controls.time_s.between(
                self.controls.time_s.minimum, setting.time_s * (1 - SAME_TIME), 1
            )
            shorter.append(setting if is_base or not below else replace(setting, time_s=below[0]))
        levels = self._levels_near(point.levels, self._shots(point.settings), shorter)
        time_s = self.time_of(shorter)
        return replace(point, settings=tuple(shorter), time_s=time_s, levels=levels)

    def _shots(self, settings: Sequence[ExposureSetting]) -> Shots:
        return tuple(
            Shot(exposure, setting.time_s / self._unit_s, setting.gain)
            for exposure, setting in zip(
                self.controls.relative_exposures(settings), settings, strict=True
            )
        )

    def at_accuracy(self, levels: float, *, budget_s: float = math.inf) -> FrontPoint:
        """Return the settings that have so many effective levels in the least time.

        Args:
            levels: effective levels, the noise counted in
            budget_s: time that they may take at most

        Raises:
            TooInaccurateError: none have; says the most levels that there are, and their time
        """
        question = f"accuracy {levels!r} {budget_s!r}"
        return self._kept(question, lambda: (self._reaching(levels, budget_s),))[0]

    def _reaching(self, levels: float, budget_s: float) -> FrontPoint:
        limit, best = self._limit(budget_s), None
        sets = sets_within(self._problem, self._counts, limit)
        for factor in _MORE_LEVELS:
            try:
                best = self._point(least_time(sets, limit, levels * factor), is_exact=True)
            except TooInaccurateError:
                if best is None:
                    raise
                break
            if best.levels >= levels and best.time_s <= budget_s * (1 + SAME_TIME):
                return best
        assert best is not None  # the first attempt found it, or raised
        if budget_s < math.inf and best.time_s > budget_s:
            best = self.at_time(budget_s)
        return best

    @property
    def estimated_levels(self) -> float | None:
        """About the effective levels of `chosen`, in less time and within a few per cent.

        Where an accuracy is asked for, the most that there are; None: no set is short enough.
        """
        budget_s = self._request.time_budget_s
        is_free = budget_s is None and self._request.accuracy is None

        def find() -> tuple[FrontPoint, ...]:
            sets = self._sets
            if is_free and self._request.count is None:
                return (self._point(sets.estimated_recommended(_FLOOR)),)
            limit = math.inf if budget_s is None else self._limit(budget_s)
            if sets.least_time(min(self._counts)) > limit:
                return ()
            return (self._point(sets.estimated(limit)),)

        found = self._kept(f"estimate {budget_s!r} {is_free}", find, least=0)
        return found[0].levels if found else None

    def _point(
        self, rated: Rated, *, is_exact: bool = False, judges_many: bool = False
    ) -> FrontPoint:
        """Return the point of a set, with its times rounded to the camera's steps.

        The steps change the levels as they change the estimate; with `is_exact` the levels are
        predicted exactly, and with `judges_many` those of many frames, which nothing rates again.
        """
        controls, settings = self.controls, []
        for shot in rated.shots:
            gain = controls.gain.nearest(shot.gain)
            time_s = controls.nearest_time(shot.time * self._unit_s, gain)
            settings.append(ExposureSetting(time_s, gain))
        asked = [shot.time * shot.gain for shot in rated.shots]
        pairs = sorted(zip(settings, asked, strict=True), key=lambda pair: pair[0].exposure)
        settings = [setting for setting, _ in pairs]
        ratios = tuple(exposure / min(asked) for exposure in sorted(asked))
        if is_exact:
            levels = self.levels_of(settings)
        else:
            levels = self._levels_near(rated.levels, rated.shots, settings, judges_many=judges_many)
        return FrontPoint(tuple(settings), ratios, self.time_of(settings), levels)

    def _levels_near(
        self,
        levels: float,
        shots: Shots,
        settings: Sequence[ExposureSetting],
        *,
        judges_many: bool = True,
    ) -> float:
        """Return the levels of settings that are those of `shots`, which have `levels`, rounded.

        Where levels that interleave decide they are judged, with `judges_many` those of many
        frames, too; others change as the estimate does.
        """
        judge, rounded = self._sets.judge, self._shots(settings)
        pairs = zip(rounded, shots, strict=True)
        changed = max(abs(math.log(a.exposure / b.exposure)) for a, b in pairs)
        is_many = judges_many and len(rounded) > JUDGED_FRAMES
        if is_many or (changed > SAME and not self._sets.dithered):
            return judge(rounded).levels
        if changed > SAME_LEVELS:
            return levels * judge.estimated(rounded) / judge.estimated(shots)
        return levels

    def levels_of(self, settings: Sequence[ExposureSetting]) -> float:
        """Return the exact effective levels of settings, the noise counted in."""
        controls = self.controls
        camera = EffectiveCamera.of(controls.levels, controls.relative_exposures(settings))
        return noisy_effective_levels(camera, self.desired, controls.frame_noise(settings))

    def time_of(self, settings: Sequence[ExposureSetting]) -> float:
        """Return the predicted time of settings, from the request until the last frame, s."""
        return predicted_wall_s(self.controls, settings, before=self._before)
