"""Hard cases, each against exact fractions and 50 digits (tests/oracle), and general properties."""

from __future__ import annotations

import json
import math
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camctl.exposure.batch import BatchScore
from camctl.exposure.effective import EffectiveCamera, effective_levels
from camctl.exposure.objective import Objective, xi
from camctl.response.camera import linear_response
from camctl.response.desired import DesiredResponse, desired_response

ORACLE = Path(__file__).parents[1] / "oracle" / "exposure_oracle.json"
ROWS: list[dict[str, Any]] = json.loads(ORACLE.read_text(encoding="utf-8"))


def desired_of(row: dict[str, Any]) -> DesiredResponse:
    dynamic_range = math.inf if row["dynamic_range"] is None else row["dynamic_range"]
    q = row["q"] if row["response"] == "gamma" else 0.5
    return desired_response(row["response"], dynamic_range, q=q)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row["name"])
def test_hard_cases_against_fifty_digits(row: dict[str, Any]) -> None:
    """Relative errors stay within the bound that the oracle states for each row."""
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
    lambda name, log_range, q: desired_response(name, math.exp(log_range), q=q),
    st.sampled_from(["linear", "gamma", "log"]),
    st.floats(math.log(1.001), math.log(1e7)),
    st.sampled_from([0.2, 0.5, 1.0, 2.2]),
)


@settings(max_examples=150)
@given(BITS, RATIOS, DESIRED, st.floats(1, 1e5), st.sampled_from([1.0, 1.5, 2.0]))
def test_always_finite_and_never_negative(
    bits: int, ratios: list[float], desired: DesiredResponse, wanted: float, p: float
) -> None:
    """Warnings are errors here, so that none appears either."""
    camera = EffectiveCamera.of(linear_response(bits), [1.0, *ratios])
    score = xi(camera, desired, wanted, p=p)
    assert math.isfinite(score)
    assert score >= 0
    levels = effective_levels(camera, desired)
    assert 1 - 1e-9 <= levels <= camera.levels_total + 1


@settings(max_examples=60)
@given(BITS, RATIOS, DESIRED, st.floats(1, 1e4), st.sampled_from([1.0, 2.0]))
def test_batches_never_fail_nor_exceed_what_is_exact(
    bits: int, ratios: list[float], desired: DesiredResponse, wanted: float, p: float
) -> None:
    exposures = sorted([1.0, *ratios])
    goal = Objective(wanted, p)
    response = linear_response(bits)
    batch = BatchScore(response, desired, goal, len(exposures), exact=True)
    score = float(batch(np.array([exposures]))[0])
    exact = goal.score(response, exposures, desired)
    assert math.isfinite(score)
    assert score <= exact * (1 + 1e-6) + 1e-6 * wanted**p


@settings(max_examples=60)
@given(BITS, RATIOS, DESIRED, st.randoms(use_true_random=False))
def test_the_order_of_exposures_does_not_matter(
    bits: int, ratios: list[float], desired: DesiredResponse, random: Any
) -> None:
    exposures = [1.0, *ratios]
    mixed = list(exposures)
    random.shuffle(mixed)
    one = EffectiveCamera.of(linear_response(bits), exposures)
    two = EffectiveCamera.of(linear_response(bits), mixed)
    assert np.array_equal(one.levels, two.levels)
    assert xi(one, desired, 500) == xi(two, desired, 500)


@settings(max_examples=60)
@given(BITS, RATIOS, DESIRED, st.sampled_from([0.25, 0.5, 2.0, 16.0]))
def test_light_and_exposures_scale_together(
    bits: int, ratios: list[float], desired: DesiredResponse, factor: float
) -> None:
    """Powers of two: twice the exposure at half the light is the same sum, bit for bit."""
    one = EffectiveCamera.of(linear_response(bits), [1.0, *ratios])
    two = EffectiveCamera.of(linear_response(bits), [factor * e for e in [1.0, *ratios]])
    assert np.array_equal(one.levels, two.levels * factor)
    E = np.geomspace(1e-6, 1, 50)
    assert np.array_equal(one.brightness(E), two.brightness(E / factor))


@settings(max_examples=60)
@given(BITS, RATIOS, st.integers(0, 2**32 - 1))
def test_union_of_levels_is_the_sum_of_frames(bits: int, ratios: list[float], seed: int) -> None:
    """On every pixel that is not within rounding of a level."""
    exposures = [1.0, *ratios]
    camera = EffectiveCamera.of(linear_response(bits), exposures)
    E = np.exp(np.random.default_rng(seed).uniform(-14, 0.1, 200))
    top = 2**bits
    frames = sum(np.minimum(np.floor(e * E * top), top - 1).astype(np.int64) for e in exposures)
    near = np.zeros(E.shape, dtype=bool)
    for e in exposures:
        position = e * E * top
        near |= np.abs(position - np.round(position)) < 1e-9 * np.maximum(position, 1)
    assert np.array_equal(camera.brightness(E)[~near], np.asarray(frames)[~near])


@settings(max_examples=80)
@given(BITS, RATIOS, DESIRED, st.floats(1, 1e6), st.floats(1, 5000))
def test_one_exposure_more_never_hurts(
    bits: int, ratios: list[float], desired: DesiredResponse, extra: float, wanted: float
) -> None:
    """At the same scale, range and G."""
    fewer = EffectiveCamera.of(linear_response(bits), [1.0, *ratios])
    more = EffectiveCamera.of(linear_response(bits), [1.0, *ratios, extra])
    assert xi(more, desired, wanted) <= xi(fewer, desired, wanted) * (1 + 1e-9) + 1e-9 * wanted
    assert effective_levels(more, desired) >= effective_levels(fewer, desired) * (1 - 1e-9)


@pytest.mark.parametrize("bits", [1, 8, 16])
@pytest.mark.parametrize("n", [1, 2, 16])
@pytest.mark.parametrize("dynamic_range", [1.001, 1e7])
@pytest.mark.parametrize("spread", [1e-15, 1e6])
def test_the_corners_of_the_domain(bits: int, n: int, dynamic_range: float, spread: float) -> None:
    exposures = (1 + spread * np.arange(n) / max(1, n - 1)).tolist()
    camera = EffectiveCamera.of(linear_response(bits), exposures)
    for name in ("linear", "gamma", "log"):
        desired = desired_response(name, dynamic_range)
        assert 0 <= xi(camera, desired, n * camera.response.M) <= n * camera.response.M
        assert effective_levels(camera, desired) >= 1 - 1e-9
    table = camera.irradiance_table()
    assert table.size == camera.levels_total + 1
    assert np.all(np.isfinite(table))
    assert np.all(np.diff(table[:-1]) >= 0)
