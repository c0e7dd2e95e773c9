from __future__ import annotations

import numpy as np
import pytest
from sampling import some

from camctl.errors import UsageError
from camctl.exposure import lower_bound
from camctl.exposure.lower_bound import certify
from camctl.exposure.objective import ExposureProblem, Objective, xi
from camctl.exposure.solver import solve
from camctl.model.effective import EffectiveCamera
from camctl.model.response.camera import linear_response, standard_response
from camctl.model.response.desired import DesiredResponse, desired_response
from camctl.model.response.tabulated import tabulated_desired


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["linear", *(pytest.param(each, marks=pytest.mark.slow) for each in ("gamma", "log"))]
)
def test_no_pair_on_a_fine_grid_scores_below_the_bound(name: str) -> None:
    """Does not use the reasoning of the bound: 14,000 ratios with the exact objective."""
    response = linear_response(4)
    desired = desired_response(name, 64.0)
    proof = certify(response, desired)
    assert proof.gap <= 1.01e-4
    ratios = np.exp(np.linspace(0, np.log(64) + 3, 12_000))
    near = proof.exposures[1] * (1 + np.linspace(-1e-3, 1e-3, 2001))
    scores = [
        xi(EffectiveCamera.of(response, (1, r)), desired, 30)
        for r in np.concatenate([ratios, near[near >= 1]]).tolist()
    ]
    assert min(scores) >= proof.lower_bound
    assert proof.lower_bound <= proof.xi <= min(scores) * (1 + 1e-4)


@pytest.mark.parametrize(
    ("name", "best"), some([("log", 179.92), ("gamma", 114.74), ("linear", 105.13)], every=3)
)
def test_two_exposures_of_the_printed_table_are_proven_optimal(name: str, best: float) -> None:
    proof = certify(linear_response(8), desired_response(name, 512.0))
    assert proof.gap <= 1.01e-4
    assert round(proof.xi, 2) == best


@pytest.mark.slow
def test_bound_holds_for_an_srgb_camera_that_rounds() -> None:
    desired = desired_response("gamma", 256.0, gamma=0.3)
    response = standard_response("srgb", 6, phase=0.5)
    proof = certify(response, desired)
    rng = np.random.default_rng(2)
    for r in np.exp(rng.uniform(0, 7, 3000)).tolist():
        assert xi(EffectiveCamera.of(response, (1, r)), desired, 126) >= proof.lower_bound
    assert proof.gap <= 1.01e-4


def test_no_random_set_of_three_scores_below_the_bound() -> None:
    response = linear_response(3)
    desired = desired_response("linear", 32.0)
    proof = certify(response, desired, 3, max_evaluations=60_000)
    assert 0 <= proof.lower_bound <= proof.xi
    rng = np.random.default_rng(4)
    for exposures in np.exp(rng.uniform(0, 3, (3000, 3))).tolist():
        relative = sorted(e / min(exposures) for e in exposures)
        assert xi(EffectiveCamera.of(response, relative), desired, 21) >= proof.lower_bound


def test_one_exposure_has_no_gap() -> None:
    proof = certify(linear_response(8), desired_response("log", 256.0), 1)
    assert proof.gap == 0


@pytest.mark.parametrize(
    "desired",
    [
        desired_response("gamma", 100.0, gamma=2.0),
        desired_response("gamma", float("inf")),
        tabulated_desired([0.1, 0.3, 1], [0, 0.6, 1]),
    ],
    ids=["gamma above 1", "infinite range", "table"],
)
def test_responses_without_a_known_bound_are_refused(desired: DesiredResponse) -> None:
    with pytest.raises(UsageError, match="no lower bound is known for the desired response"):
        certify(linear_response(8), desired)


@pytest.mark.parametrize(
    ("bits", "name", "dynamic_range", "n", "wanted", "is_equal"),
    [(8, "linear", 256.0, 3, 100.0, True), (4, "log", 4.0, 2, 8.0, False)],
    ids=["equal exposures", "others"],
)
def test_a_set_without_missing_levels_needs_no_search_for_a_bound(
    monkeypatch: pytest.MonkeyPatch,
    bits: int,
    name: str,
    dynamic_range: float,
    n: int,
    wanted: float,
    *,
    is_equal: bool,
) -> None:
    def refuse(*_: object) -> None:
        pytest.fail("boxes were searched for a bound")

    monkeypatch.setattr(lower_bound, "_Boxes", refuse)
    response, desired = linear_response(bits), desired_response(name, dynamic_range)
    equal = xi(EffectiveCamera.of(response, (1.0,) * n), desired, wanted)
    assert (equal == 0) is is_equal
    proof = certify(response, desired, n, levels_wanted=wanted)
    assert (proof.xi, proof.lower_bound, proof.gap) == (0.0, 0.0, 0.0)
    found = solve(response, desired, n, objective=Objective(wanted))
    assert proof.evaluations == found.evaluations


def test_the_table_of_a_camera_of_many_levels_is_made_in_parts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem = ExposureProblem(linear_response(6), desired_response("log", 100.0), 2)
    whole = lower_bound._Lipschitz(problem, 7.0)
    assert whole.t.size == lower_bound.LIPSCHITZ_POINTS
    monkeypatch.setattr(lower_bound, "LEVELS_AT_ONCE", 1000)
    assert np.array_equal(lower_bound._Lipschitz(problem, 7.0).value, whole.value)
    monkeypatch.setattr(lower_bound, "LIPSCHITZ_LEVELS", 63 * 100)
    few = lower_bound._Lipschitz(problem, 7.0)
    assert few.t.size == 100
    at = np.linspace(0.0, 7.0, 999)
    assert np.all(few(at) >= whole(at) * (1 - 1e-12))  # still an upper bound
