"""Accuracy in hard cases, and general properties.

The expected values of the hard cases come from exact fractions and 50 digits; see tests/oracle.
"""

from __future__ import annotations

import json
import math
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camctl.exposure.candidates import BatchScore
from camctl.exposure.objective import ExposureProblem, Objective, xi
from camctl.model.effective import EffectiveCamera, effective_levels
from camctl.model.response.camera import linear_response
from camctl.model.response.desired import DesiredResponse, desired_response

ORACLE = Path(__file__).parents[1] / "oracle" / "exposure_oracle.json"
ROWS: list[dict[str, Any]] = json.loads(ORACLE.read_text(encoding="utf-8"))


def desired_of(row: dict[str, Any]) -> DesiredResponse:
    dynamic_range = math.inf if row["dynamic_range"] is None else row["dynamic_range"]
    gamma = row["q"] if row["response"] == "gamma" else None
    return desired_response(row["response"], dynamic_range, gamma=gamma)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row["name"])
def test_relative_error_is_within_the_bound_of_each_hard_case(row: dict[str, Any]) -> None:
    desired = desired_of(row)
    camera = EffectiveCamera.of(linear_response(row["bits"], phase=row["phase"]), row["exposures"])
    score = xi(camera, desired, row["levels_wanted"], p=row["p"])
    assert abs(Fraction(score) / Fraction(row["xi"]) - 1) <= row["bound"]
    levels = effective_levels(camera, desired)
    assert abs(Fraction(levels) / Fraction(row["effective_levels"]) - 1) <= max(row["bound"], 1e-13)
    assert camera.levels_distinct == row["levels_distinct"]


BITS = st.integers(1, 10)
RATIOS = st.lists(
    st.one_of(st.floats(1, 1e6), st.floats(0, 1e-2).map(lambda x: 1 + x), st.just(1 + 1e-15)),
    min_size=0,
    max_size=5,
)
DESIRED = st.builds(
    lambda kind, log_range: desired_response(kind[0], math.exp(log_range), gamma=kind[1]),
    st.sampled_from(
        [("linear", None), ("log", None), *(("gamma", gamma) for gamma in (0.2, 0.5, 1.0, 2.2))]
    ),
    st.floats(math.log(1.001), math.log(1e7)),
)


@given(BITS, RATIOS, DESIRED, st.floats(1, 1e5), st.sampled_from([1.0, 1.5, 2.0]))
def test_objective_and_effective_levels_are_finite_and_not_negative(
    bits: int, ratios: list[float], desired: DesiredResponse, levels_wanted: float, p: float
) -> None:
    """Warnings are errors in the tests: none is raised."""
    camera = EffectiveCamera.of(linear_response(bits), [1.0, *ratios])
    score = xi(camera, desired, levels_wanted, p=p)
    assert math.isfinite(score)
    assert score >= 0
    levels = effective_levels(camera, desired)
    assert 1 - 1e-9 <= levels <= camera.levels_total + 1


@given(BITS, RATIOS, DESIRED, st.floats(1, 1e4), st.sampled_from([1.0, 2.0]))
def test_score_of_a_batch_is_finite_and_at_most_the_exact_objective(
    bits: int, ratios: list[float], desired: DesiredResponse, levels_wanted: float, p: float
) -> None:
    exposures = sorted([1.0, *ratios])
    problem = ExposureProblem(
        linear_response(bits), desired, len(exposures), Objective(levels_wanted, p)
    )
    score = float(BatchScore(problem, exact=True)(np.array([exposures]))[0])
    exact = problem.score(exposures)
    assert math.isfinite(score)
    assert score <= exact * (1 + 1e-6) + 1e-6 * levels_wanted**p


@given(BITS, RATIOS, DESIRED, st.randoms(use_true_random=False))
def test_order_of_exposures_does_not_matter(
    bits: int, ratios: list[float], desired: DesiredResponse, random: Any
) -> None:
    exposures = [1.0, *ratios]
    shuffled = list(exposures)
    random.shuffle(shuffled)
    one = EffectiveCamera.of(linear_response(bits), exposures)
    two = EffectiveCamera.of(linear_response(bits), shuffled)
    assert np.array_equal(one.levels, two.levels)
    assert xi(one, desired, 500) == xi(two, desired, 500)


@given(BITS, RATIOS, st.sampled_from([0.25, 0.5, 2.0, 16.0]))
def test_exposures_times_a_power_of_two_divide_the_levels_by_it(
    bits: int, ratios: list[float], factor: float
) -> None:
    """Twice the exposure at half the light gives the same sum, bit for bit."""
    one = EffectiveCamera.of(linear_response(bits), [1.0, *ratios])
    two = EffectiveCamera.of(linear_response(bits), [factor * e for e in [1.0, *ratios]])
    assert np.array_equal(one.levels, two.levels * factor)


@given(BITS, RATIOS, st.integers(0, 2**32 - 1))
def test_number_of_levels_below_a_pixel_is_its_sum_of_frames(
    bits: int, ratios: list[float], seed: int
) -> None:
    """Holds for every pixel that is not within rounding error of a level."""
    exposures = [1.0, *ratios]
    camera = EffectiveCamera.of(linear_response(bits), exposures)
    E = np.exp(np.random.default_rng(seed).uniform(-14, 0.1, 200))
    top = 2**bits
    frames = sum(np.minimum(np.floor(e * E * top), top - 1).astype(np.int64) for e in exposures)
    near = np.zeros(E.shape, dtype=bool)
    for e in exposures:
        position = e * E * top
        near |= np.abs(position - np.round(position)) < 1e-9 * np.maximum(position, 1)
    sums = np.searchsorted(camera.levels, E, side="right")
    assert np.array_equal(sums[~near], np.asarray(frames)[~near])


@given(BITS, RATIOS, DESIRED, st.floats(1, 1e6), st.floats(1, 5000))
def test_one_more_exposure_never_worsens_the_result(
    bits: int, ratios: list[float], desired: DesiredResponse, extra: float, levels_wanted: float
) -> None:
    """At the same scale of E, range and G."""
    fewer = EffectiveCamera.of(linear_response(bits), [1.0, *ratios])
    more = EffectiveCamera.of(linear_response(bits), [1.0, *ratios, extra])
    allowed = xi(fewer, desired, levels_wanted) * (1 + 1e-9) + 1e-9 * levels_wanted
    assert xi(more, desired, levels_wanted) <= allowed
    assert effective_levels(more, desired) >= effective_levels(fewer, desired) * (1 - 1e-9)


@pytest.mark.parametrize("bits", [1, 8, 16])
@pytest.mark.parametrize("n", [1, 2, 16])
@pytest.mark.parametrize("dynamic_range", [1.001, 1e7])
@pytest.mark.parametrize("spread", [1e-15, 1e6])
def test_extreme_arguments_give_valid_results(
    bits: int, n: int, dynamic_range: float, spread: float
) -> None:
    exposures = (1 + spread * np.arange(n) / max(1, n - 1)).tolist()
    camera = EffectiveCamera.of(linear_response(bits), exposures)
    for name in ("linear", "gamma", "log"):
        desired = desired_response(name, dynamic_range)
        assert 0 <= xi(camera, desired, n * camera.response.M) <= n * camera.response.M
        assert effective_levels(camera, desired) >= 1 - 1e-9
    assert camera.levels.size == n * camera.response.M
    assert np.all(np.isfinite(camera.levels))
    assert np.all(np.diff(camera.levels) >= 0)
