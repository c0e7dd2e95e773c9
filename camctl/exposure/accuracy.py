"""The exposures that give the most accurate picture with the noise of a camera.

Accuracy is the mean square error in the desired response, with photon noise, read noise and
quantisation, as effective levels L = (12 mse)^(-1/2).  A search over the fast estimate of
`camctl.exposure.frame_accuracy` finds the best sets; the exact distribution of
`camctl.exposure.noise` decides between them and their neighbours.  Gains take part as in Hasinoff,
Durand and Freeman (2010), "Noise-optimal capture for high dynamic range photography": a frame of
twice the gain needs half the time for the same brightness, and has half the photons.

The rule of choice: the fastest set among those within `NEAR_TIE` of the best accuracy in the time
allowed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import process_time

from camctl.errors import UsageError
from camctl.exposure.accurate_sets import AccurateSets
from camctl.exposure.evaluation import evaluate
from camctl.exposure.exposure_choices import AccuracyProblem, Rated, TimeCosts
from camctl.exposure.solver import Progress, Solution
from camctl.model.effective import check_count

NEAR_TIE = 0.005
"""Relative difference in effective levels up to which the shorter set is preferred."""

NEAR_TIME = 1.03
"""Ratio of times up to which sets of different numbers of exposures are all improved."""

EFFORT_OF_EACH = 0.5
"""Effort for each of several numbers of exposures, which differ by more than it gains."""

COUNTS: tuple[int, ...] = (1, 2, 3, 4, 5, 6)
"""Numbers of exposures to choose from where none is given."""


class TooInaccurateError(UsageError):
    """No set of exposures has the requested accuracy; the hint states the best accuracy."""


@dataclass(frozen=True)
class AccuracySolution(Solution):
    """Exposures found by their accuracy.

    `effective_levels` has the noise counted in; `total_exposure` is the sum of time x gain.

    Attributes:
        effective_levels_noise_free: effective levels without noise
        times: shutter time of each exposure, in the unit of `AvailableExposures`
        gains: gain of each exposure
        enumerated: whether every set of a list of settings was considered, so that none is better
    """

    effective_levels_noise_free: float = 0.0
    times: tuple[float, ...] = ()
    gains: tuple[float, ...] = ()
    enumerated: bool = False

    @property
    def total_time(self) -> float:
        """Total exposure time, in the unit of `times`."""
        return math.fsum(self.times)


def solve_accuracy(
    problem: AccuracyProblem,
    counts: Sequence[int] = COUNTS,
    *,
    total_limit: float = math.inf,
    accuracy: float | None = None,
    near_tie: float = NEAR_TIE,
    progress: Progress | None = None,
) -> AccuracySolution:
    """Return the exposures of the most effective levels, or the shortest that reach `accuracy`.

    Without `accuracy` the result has the most effective levels of all sets within `total_limit`; of
    sets within `near_tie` of them it is the shortest.  The result is always the same, bit for bit.

    Args:
        problem: the camera, its noise and the desired response
        counts: numbers of exposures to choose from, 1 to 16 each
        total_limit: longest time of a set as `AvailableExposures.costs` counts it, in the unit of
            the available times
        accuracy: effective levels, noise included, to reach in the least time
        near_tie: relative difference in effective levels up to which the shorter set is preferred
        progress: called with the completed share, 0 to 1

    Raises:
        UsageError: a number is out of range, no set is short enough, or none reaches `accuracy`
        DataError: an available setting is not a positive number

    >>> from camctl.model.noise import NoiseModel
    >>> from camctl.model.response.camera import linear_response
    >>> from camctl.model.response.desired import desired_response
    >>> noise = NoiseModel(conversion_e_per_dn=40.0, read_noise_e=((1.0, 3.0),))
    >>> problem = AccuracyProblem(linear_response(8), desired_response("log", 1000.0), noise)
    >>> found = solve_accuracy(problem, [3])
    >>> [round(e) for e in found.exposures], round(found.effective_levels)
    ([1, 8, 81], 101)
    """
    for count in counts:
        check_count(count)
    if accuracy is not None and not 0 < accuracy < math.inf:
        raise UsageError(f"invalid accuracy {accuracy:g}: expected a positive number of levels")
    started = process_time()
    search = AccurateSets(problem, 1.0 if len(set(counts)) == 1 else EFFORT_OF_EACH)
    limit = total_limit - problem.available.costs.fixed
    possible = [n for n in sorted(set(counts)) if search.least_time(n) <= limit]
    if not possible:
        fewest, text = min(counts), problem.available.duration
        least = text(search.least_time(fewest))
        raise UsageError(
            f"{f'{fewest} exposures take' if fewest > 1 else 'one exposure takes'} {least} at "
            f"least, more than the {text(limit)} allowed",
            hint="allow more time" + (", or take fewer exposures" if fewest > 1 else ""),
        )
    report = progress or (lambda _: None)
    if accuracy is None:
        chosen = _most_accurate(search, possible, limit, near_tie, report)
    else:
        chosen = _least_time(search, possible, limit, accuracy, report)
    report(1.0)
    found = _solution(problem, chosen)
    return replace(
        found,
        seconds=process_time() - started,
        evaluations=search.evaluations,
        enumerated=all(search.enumerates(n) for n in possible),
    )


def estimate_levels(
    problem: AccuracyProblem, counts: Sequence[int] = COUNTS, *, total_limit: float = math.inf
) -> float | None:
    """Return about the most effective levels that `solve_accuracy` can find, in much less time.

    They are within a few per cent.  None where no set is short enough, or where the camera has so
    little noise that there is no fast estimate.
    """
    search = AccurateSets(problem)
    limit = total_limit - problem.available.costs.fixed
    possible = [n for n in set(counts) if search.least_time(n) <= limit]
    if problem.available.costs == TimeCosts():
        possible = possible and [max(possible)]  # more exposures are never worse then
    estimates = [search.estimated(n, limit) for n in possible]
    return max((levels for levels in estimates if levels is not None), default=None)


def _most_accurate(
    search: AccurateSets, counts: list[int], limit: float, near_tie: float, progress: Progress
) -> Rated:
    """Return the shortest set within `near_tie` of the most accurate one."""
    found: list[Rated] = []
    # The most accurate number by the estimate comes first: what is far from it is not improved.
    in_order = sorted(counts, key=lambda n: (-(search.estimated(n, limit) or 0.0), -n))
    for done, n in enumerate(in_order):
        least = max((each.levels for each in found), default=0.0)
        if search.may_reach(n, least, limit):
            found.append(search.most_accurate(n, limit, least=least))
        progress((done + 1) / (len(counts) + 1))
    best = max(found, key=lambda each: each.levels)
    if not near_tie:
        return best
    least = (1 - near_tie) * best.levels
    near = [len(each.shots) for each in found if each.levels >= least]
    return min([best, *_quickest(search, near, least, limit)], key=_time_then_count)


def _quickest(search: AccurateSets, counts: list[int], levels: float, limit: float) -> list[Rated]:
    """Return the quickest sets of `levels` with those numbers of exposures that need least time."""
    reached: list[Rated] = []
    least = limit / NEAR_TIME
    for n in counts:
        found = search.quickest(n, levels, min(limit, NEAR_TIME * least))
        if found is not None:
            reached.append(found)
            least = min(least, found.time)
    return [search.shortened(each, levels) for each in reached if each.time <= NEAR_TIME * least]


def _least_time(
    search: AccurateSets, counts: list[int], limit: float, accuracy: float, progress: Progress
) -> Rated:
    """Return the shortest set that has `accuracy` effective levels."""
    possible = [n for n in counts if search.may_reach(n, accuracy, limit)]
    progress(0.2)
    if found := _quickest(search, possible, accuracy, limit):
        return min(found, key=_time_then_count)
    best = _most_accurate(search, counts, limit, 0.0, progress)
    numbers = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    raise TooInaccurateError(
        f"no set of {numbers} exposures has {accuracy:.6g} effective levels with this camera's "
        "noise",
        hint=f"the best has {best.levels:.4g} in {search.problem.available.duration(best.time)}; "
        "request fewer levels, or allow more exposures or more time",
    )


def _time_then_count(rated: Rated) -> tuple[float, int]:
    return rated.time, len(rated.shots)


def _solution(problem: AccuracyProblem, rated: Rated) -> AccuracySolution:
    exposures = tuple(shot.exposure for shot in rated.shots)
    quality = evaluate(problem.response, problem.desired, exposures)
    return AccuracySolution(
        exposures=exposures,
        xi=quality.xi,
        levels_wanted=quality.levels_wanted,
        effective_levels=rated.levels,
        total_exposure=quality.total_exposure,
        seconds=0.0,
        evaluations=1,
        effective_levels_noise_free=quality.effective_levels,
        times=tuple(shot.time for shot in rated.shots),
        gains=tuple(shot.gain for shot in rated.shots),
    )
