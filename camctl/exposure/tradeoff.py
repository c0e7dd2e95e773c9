"""Number of exposures against accuracy, before any picture is taken."""

from __future__ import annotations

import math

from camctl.errors import UsageError
from camctl.exposure.objective import Objective
from camctl.exposure.solver import Progress, SearchOptions, Solution, solve
from camctl.model.effective import MAX_EXPOSURES
from camctl.model.response.camera import CameraResponse
from camctl.model.response.desired import DesiredResponse

QUICK_EFFORT = 0.1
"""Effort of the first search for each number of exposures: within a few per cent of the best."""

QUICK_MARGIN = 1.25
"""A quick search with more than this many times the tolerance is not repeated with full effort."""


_ORDINALS = (
    *("first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth", "ninth"),
    *("tenth", "eleventh", "twelfth", "thirteenth", "fourteenth", "fifteenth", "sixteenth"),
)


def gain_in_words(count: int, cost: str, levels: float, levels_before: float) -> str:
    """Return what one more exposure costs and brings.

    The error is the root mean square one in the desired response, 1 / (sqrt(12) L).

    Args:
        count: number of exposures with it
        cost: what it costs more, such as 0.8 s
        levels: effective levels with it
        levels_before: effective levels without it

    >>> gain_in_words(4, "0.8 s", 100.0, 69.0)
    'the fourth exposure costs 0.8 s and brings 31 % less error'
    """
    less = 100 * (1 - levels_before / levels)
    error = f"{less:.0f} % less error" if less >= 1 else "no less error"
    return f"the {_ORDINALS[count - 1]} exposure costs {cost} and brings {error}"


def fewest_exposures(
    response: CameraResponse,
    desired: DesiredResponse,
    tolerance: float,
    levels_wanted: float,
    *,
    max_count: int = MAX_EXPOSURES,
    seed: int = 0,
    progress: Progress | None = None,
) -> Solution:
    """Return the solution with the fewest exposures that leaves at most `tolerance` levels missing.

    Grossberg and Nayar, section 3.2: one exposure is added until the objective is small enough.

    Args:
        response: the response of the real camera
        desired: the desired response
        tolerance: largest xi, >= 0
        levels_wanted: G; it must be given, since the default n * M grows with n
        max_count: number of exposures, at most
        seed: seed of the random numbers
        progress: called with the completed share, 0 to 1

    Raises:
        UsageError: the tolerance is negative, or `max_count` exposures do not reach it; states the
            xi that they reach
    """
    if not (math.isfinite(tolerance) and tolerance >= 0):
        raise UsageError(f"invalid tolerance {tolerance:g}: expected a number of levels >= 0")
    objective = Objective(levels_wanted)
    quick, full = SearchOptions(seed, QUICK_EFFORT), SearchOptions(seed)
    best = math.inf
    for n in range(1, max_count + 1):
        found = solve(response, desired, n, objective=objective, search=quick)
        if tolerance < found.xi < QUICK_MARGIN * tolerance or n == max_count:
            found = solve(response, desired, n, objective=objective, search=full)
        if progress is not None:
            progress(n / max_count)
        if found.xi <= tolerance:
            return found
        best = min(best, found.xi)
    raise UsageError(
        f"no set of up to {max_count} exposures reduces xi to {tolerance:g}",
        hint=f"the best one has {best:.4g}: allow that many missing levels, or request fewer "
        f"levels than {levels_wanted:g}",
    )
