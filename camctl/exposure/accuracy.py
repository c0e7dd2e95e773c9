"""The exposures that give the most accurate picture with the noise of a camera.

Accuracy is the mean square error in the desired response, with photon noise, read noise and
quantisation, as effective levels L = (12 mse)^(-1/2).  A search over the fast estimate of
`camctl.exposure.accurate` finds the best sets; the exact distribution of
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
from camctl.exposure.accurate.sets import AccurateSets
from camctl.exposure.evaluation import evaluate
from camctl.exposure.exposure_choices import SAME, AccuracyProblem, Rated
from camctl.exposure.solver import Progress, Solution
from camctl.model.effective import MOST_SEARCHED, check_count

NEAR_TIE = 0.005
"""Relative difference in effective levels up to which the shorter set is preferred."""

COUNTS: tuple[int, ...] = tuple(range(1, MOST_SEARCHED + 1))
"""Numbers of exposures to choose from where none is given."""


KEPT_SEARCHES = 16
"""Searches whose findings are kept, about 1 MB each: a plan compares up to nine ranges."""

_kept: dict[str, AccurateSets] = {}


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
        counts: numbers of exposures to choose from, 1 to 64 each
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
    ([1, 9, 80], 101)
    """
    for count in counts:
        check_count(count)
    if accuracy is not None and not 0 < accuracy < math.inf:
        raise UsageError(f"invalid accuracy {accuracy:g}: expected a positive number of levels")
    started = process_time()
    limit = total_limit - problem.available.costs.fixed
    search = sets_within(problem, counts, limit)
    report = progress or (lambda _: None)
    report(0.2)
    if accuracy is None:
        chosen = most_accurate(search, limit, near_tie)
    else:
        chosen = least_time(search, limit, accuracy)
    report(1.0)
    return replace(
        _solution(problem, chosen),
        seconds=process_time() - started,
        evaluations=search.judge.ratings,
        enumerated=search.enumerated,
    )


def accurate_sets(problem: AccuracyProblem, counts: Sequence[int]) -> AccurateSets:
    """Return the search for sets of `counts` exposures; what it has found is kept for a while."""
    key = repr((*problem.identity, problem.available.costs, min(counts), max(counts)))
    if key not in _kept:
        if len(_kept) >= KEPT_SEARCHES:
            _kept.pop(next(iter(_kept)))
        _kept[key] = AccurateSets(problem, (min(counts), max(counts)))
    return _kept[key]


def sets_within(problem: AccuracyProblem, counts: Sequence[int], limit: float) -> AccurateSets:
    """Return the search for sets of `counts` exposures of which some take `limit` at most.

    Raises:
        UsageError: even the fewest exposures take longer
    """
    fewest = min(counts)
    search = accurate_sets(problem, counts)
    least = search.least_time(fewest)
    if least > limit * (1 + SAME):
        text = problem.available.duration
        raise UsageError(
            f"{f'{fewest} exposures take' if fewest > 1 else 'one exposure takes'} {text(least)} "
            f"at least, more than the {text(limit)} allowed",
            hint="allow more time" + (", or take fewer exposures" if fewest > 1 else ""),
        )
    return search


def most_accurate(
    search: AccurateSets,
    limit: float = math.inf,
    near_tie: float = NEAR_TIE,
    *,
    judged: bool = True,
) -> Rated:
    """Return the most accurate set; where time does not bind, the shortest nearly as accurate.

    If it need not be `judged`, a set of many frames has its estimated levels.
    """
    is_bound = not search.enumerated and search.is_bound(limit)
    if near_tie and not is_bound:
        found = search.nearly_most_accurate(1 - near_tie)
        if found is not None:
            return search.judge(found.shots) if judged else found
    best = search.within(limit)
    if not near_tie or is_bound:
        return best
    levels = (1 - near_tie) * best.levels
    nearly = search.nearly_as_accurate(best, levels)
    return min(best, nearly, key=lambda each: (each.time, len(each.shots)))


def least_time(search: AccurateSets, limit: float, accuracy: float) -> Rated:
    """Return the shortest set that has `accuracy` effective levels.

    Raises:
        TooInaccurateError: none has
    """
    found = search.reaching(accuracy, limit)
    if found is not None:
        return found
    best = search.within(limit)
    if best.levels >= accuracy:
        return best
    fewest, most = search.counts
    numbers = f"{fewest}" if fewest == most else f"{fewest} to {most}"
    raise TooInaccurateError(
        f"no set of {numbers} exposures has {accuracy:.6g} effective levels with this camera's "
        "noise",
        hint=f"the best has {best.levels:.4g} in {search.problem.available.duration(best.time)}; "
        "request fewer levels, or allow more exposures or more time",
    )


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
