"""Sets of least quantisation error, for cameras whose noise does not dither the quantiser.

Without noise the accuracy follows from the gaps between the levels.  The search for the paper's
objective minimises them as well; the fast estimate of `camctl.exposure.frame_accuracy` takes no
account of them.  A quick search shows about what can be reached, so that the long one is made only
where it pays.
"""

from __future__ import annotations

from camctl.exposure.exposure_choices import SAME, AccuracyProblem, Shot, Shots
from camctl.exposure.objective import Objective
from camctl.exposure.solver import SearchOptions, Solution, coarse_camera, solve

SEARCH, SEARCH_OF_FEW = (SearchOptions(effort=effort, refinement=0.1) for effort in (0.05, 0.15))
"""The search for a set, and the search for a camera of at most `FEW_LEVELS`, which takes less time;
neighbours of what it finds are rated exactly afterwards."""

FEW_LEVELS = 63

QUICK_SEARCH = SearchOptions(effort=0.01, refinement=0.0)
"""The search for an estimate: its levels are within about 5 % of the result of `SEARCH`."""

SHORTENINGS = 6
"""Attempts to fit exposures into a time in which short ones take as long as a frame."""


class LeastQuantisation:
    """Finds sets of least quantisation error, at the smallest gain and where any time can be set.

    Args:
        problem: the camera and the desired response; noise is left out
    """

    def __init__(self, problem: AccuracyProblem) -> None:
        self.problem = problem
        self.evaluations = 0
        self._estimates: dict[tuple[int, float], float | None] = {}
        self._totals: dict[tuple[int, float], float] = {}
        self._search = SEARCH if problem.response.M > FEW_LEVELS else SEARCH_OF_FEW
        self._coarse, self._finer = coarse_camera(problem.response)

    def estimated(self, n: int, limit: float) -> float | None:
        """Return about the most effective levels of n exposures within `limit`; None: no set."""
        if (n, limit) not in self._estimates:
            found = self._within(n, limit, QUICK_SEARCH)
            levels = None if found is None else found.effective_levels * self._finer
            self._estimates[n, limit] = levels
        return self._estimates[n, limit]

    def best(self, n: int, limit: float) -> Shots | None:
        """Return the set of least quantisation error of a time up to `limit`, or None."""
        if self.estimated(n, limit) is None:
            return None
        found = self._within(n, limit, self._search)
        return None if found is None else self._shots(found)

    def _within(self, n: int, limit: float, search: SearchOptions) -> Solution | None:
        available = self.problem.available
        costs = available.costs
        total = costs.shutter(limit, n) - max(0.0, costs.least - 1)
        total = self._totals.get((n, limit), total)
        for _ in range(SHORTENINGS):
            if available.times is not None or not total >= n:
                return None
            found = solve(
                self._coarse if search is QUICK_SEARCH else self.problem.response,
                self.problem.desired,
                n,
                objective=Objective(kind="levels"),
                total_limit=total,
                search=search,
            )
            self.evaluations += found.evaluations
            if found.exposures[-1] > available.longest:
                return None
            # Exposures shorter than a frame take more time than their shutter times.
            over = costs.total([shot.time for shot in self._shots(found)]) - limit
            if over <= SAME * limit:
                self._totals[n, limit] = total
                return found
            total = min(total, found.total_exposure) - over / costs.factor
        return None

    def _shots(self, found: Solution) -> Shots:
        gain = min(self.problem.available.gains)
        return tuple(Shot(e, e, gain) for e in found.exposures)
