from __future__ import annotations

import pytest

from camctl.errors import UsageError
from camctl.exposure.objective import Objective
from camctl.exposure.solver import solve
from camctl.exposure.tradeoff import fewest_exposures
from camctl.model.response.camera import linear_response
from camctl.model.response.desired import desired_response

EIGHT_BIT = linear_response(8)
LOG = desired_response("log", 1000.0)


def test_fewest_exposures_for_a_tolerance() -> None:
    found = fewest_exposures(EIGHT_BIT, LOG, tolerance=60, levels_wanted=300)
    fewer = solve(EIGHT_BIT, LOG, len(found.exposures) - 1, objective=Objective(300))
    assert found.xi <= 60 < fewer.xi
    assert found.levels_wanted == 300


def test_unreachable_tolerance_is_refused_with_the_reachable_one() -> None:
    message = r"no set of up to 2 exposures reduces xi to 1; the best one has \d+(\.\d+)?: allow"
    with pytest.raises(UsageError, match=message):
        fewest_exposures(EIGHT_BIT, LOG, tolerance=1, levels_wanted=300, max_count=2)


@pytest.mark.parametrize("tolerance", [-1.0, float("nan")])
def test_invalid_tolerance_is_refused(tolerance: float) -> None:
    with pytest.raises(UsageError, match=f"invalid tolerance {tolerance:g}: expected a number of"):
        fewest_exposures(EIGHT_BIT, LOG, tolerance, 300)
