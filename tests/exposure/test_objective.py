from __future__ import annotations

import itertools
import math
import re
from fractions import Fraction

import numpy as np
import pytest
from cells import CELLS, Cell
from sampling import some

from camctl.errors import UsageError
from camctl.exposure.evaluation import evaluate
from camctl.exposure.noise import NoiseTerm
from camctl.exposure.objective import ExposureProblem, Objective, xi
from camctl.model import effective
from camctl.model.effective import EffectiveCamera, effective_levels
from camctl.model.response.camera import linear_response
from camctl.model.response.desired import desired_response
from camctl.model.response.tabulated import tabulated_desired

EIGHT_BIT = linear_response(8)


def score(cell: Cell, exposures: tuple[float, ...]) -> float:
    return xi(EffectiveCamera.of(EIGHT_BIT, exposures), cell.desired, cell.levels_wanted)


@pytest.mark.parametrize("cell", CELLS, ids=lambda cell: f"{cell.response}-{cell.n}")
def test_objective_of_the_printed_table(cell: Cell) -> None:
    doubling = tuple(2.0**k for k in range(cell.n))
    assert round(score(cell, cell.printed), 2) == cell.printed_xi
    assert round(score(cell, cell.best), 2) == cell.best_xi
    assert round(score(cell, doubling), 2) == cell.doubling_xi


def test_objective_of_the_papers_four_bit_figure_with_infinite_range() -> None:
    response, desired = linear_response(4), desired_response("linear", math.inf)
    printed = xi(EffectiveCamera.of(response, (1, 1.05, 1.11)), desired, 45)
    better = xi(EffectiveCamera.of(response, (1, 1.0465116, 2.789256)), desired, 45)
    assert round(printed, 2) == 10.20
    assert better == pytest.approx(9.383333620037048, rel=1e-13)  # computed in exact fractions


def test_linear_objective_agrees_with_exact_fractions() -> None:
    exposures = (Fraction(1), Fraction(1003, 1000), Fraction(2985, 1000))
    dynamic_range, levels_wanted = Fraction(1024), Fraction(765)
    e_min = 1 / dynamic_range
    levels = sorted(Fraction(k, 256) / e for e in exposures for k in range(1, 256))
    edges = [Fraction(0), *levels, Fraction(1)]
    slope = levels_wanted / (1 - e_min)
    exact = sum(
        max(Fraction(0), slope * (b - a) - 1) / (b - a) * (b - max(a, e_min))
        for a, b in itertools.pairwise(edges)
        if b > max(a, e_min) and b > a
    )
    camera = EffectiveCamera.of(EIGHT_BIT, [float(e) for e in exposures])
    measured = xi(camera, desired_response("linear", 1024.0), 765)
    assert measured == pytest.approx(float(exact), rel=1e-12)


@pytest.mark.parametrize("name", ["linear", "gamma", "log"])
@pytest.mark.parametrize("p", some([1.0, 1.5, 2.0, 3.0], every=2, first=1))
def test_objective_agrees_with_a_midpoint_sum_of_its_definition(name: str, p: float) -> None:
    desired = desired_response(name, 20.0)
    camera = EffectiveCamera.of(linear_response(3), (1, 1.6))
    edges = np.concatenate([[0.0], camera.levels, [1.0]])
    E = desired.e_min + (np.arange(2_000_000) + 0.5) / 2_000_000 * (1 - desired.e_min)
    density = 1 / np.diff(edges)[np.searchsorted(edges, E, side="right") - 1]
    sampled = np.mean(np.maximum(0, 15 * desired.slope(E) - density) ** p) * (1 - desired.e_min)
    assert xi(camera, desired, 15, p=p) == pytest.approx(sampled, rel=1e-5)


def test_a_straight_table_equals_the_linear_response() -> None:
    table = tabulated_desired([0.01, 0.3, 0.55, 1.0], (np.array([0.01, 0.3, 0.55, 1.0])))
    camera = EffectiveCamera.of(EIGHT_BIT, (1, 1.7, 6))
    straight = desired_response("linear", 100.0)
    for p in (1.0, 2.0, 2.5):
        assert xi(camera, table, 700, p=p) == pytest.approx(xi(camera, straight, 700, p=p))


def test_a_knot_inside_a_gap_is_integrated_exactly() -> None:
    """One level at 1/2; a desired response of slope 6, then 2, against 2 in each gap."""
    table = tabulated_desired([0.01, 0.505, 1.0], [0.0, 0.75, 1.0])
    camera = EffectiveCamera.of(linear_response(1), (1,))
    steep, flat = 4 * 0.75 / 0.495, 4 * 0.25 / 0.495
    expected = (steep - 2) * 0.495 + (flat - 2) * 0.495
    assert xi(camera, table, 4) == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize(("block", "p"), [(1, 2.0), (7, 1.0), (254, 2.0)])
def test_blocks_of_gaps_add_up(block: int, p: float, monkeypatch: pytest.MonkeyPatch) -> None:
    table = tabulated_desired([0.01, 0.105, 0.3, 0.505, 1.0], [0.0, 0.3, 0.5, 0.75, 1.0])
    camera = EffectiveCamera.of(EIGHT_BIT, (1, 1.7, 6))
    cases = [table, desired_response("log", 300.0), desired_response("gamma", 100.0)]
    whole = [(xi(camera, each, 700, p=p), effective_levels(camera, each)) for each in cases]
    monkeypatch.setattr(effective, "_BLOCK", block)
    parts = [(xi(camera, each, 700, p=p), effective_levels(camera, each)) for each in cases]
    assert parts == pytest.approx(np.array(whole), rel=1e-12)


@pytest.mark.parametrize("gamma", [0.4, 3.0])
@pytest.mark.parametrize("p", [2.0, 2.5])
def test_gaps_that_are_narrow_and_wide_are_integrated_alike(p: float, gamma: float) -> None:
    """A camera of 10 bits has both; the others are the sum of 4,000 midpoints in each gap."""
    desired, G = desired_response("gamma", 64.0, gamma=gamma), 1500.0
    levels = linear_response(10).levels
    edges = np.concatenate([[0.0], levels, [1.0]])
    low, high = np.maximum(edges[:-1], desired.e_min), edges[1:]
    kept = high > low
    low, high, width = low[kept], high[kept], np.diff(edges)[kept]
    places = (np.arange(4000) + 0.5) / 4000
    sums = [
        np.mean(np.maximum(G * desired.slope(a + (b - a) * places) - 1 / w, 0.0) ** p) * (b - a)
        for a, b, w in zip(low, high, width, strict=True)
    ]
    assert xi(levels, desired, G, p=p) == pytest.approx(math.fsum(sums), rel=2e-7)


@pytest.mark.parametrize("levels_wanted", [0, -1, 0.5, 2e7, 1e308, math.nan, math.inf])
def test_number_of_desired_levels_is_limited(levels_wanted: float) -> None:
    camera, desired = EffectiveCamera.of(EIGHT_BIT, (1, 2)), desired_response("log", 256.0)
    message = f"invalid number of desired levels {levels_wanted:g}: expected 1 to 10,000,000"
    message = re.escape(message)  # 1e+308 has a special character
    with pytest.raises(UsageError, match=message):
        xi(camera, desired, levels_wanted)
    with pytest.raises(UsageError, match=message):
        Objective(levels_wanted)


@pytest.mark.parametrize("p", [0.5, 0, -1, math.nan, 17])
def test_norm_must_be_1_to_16(p: float) -> None:
    camera, desired = EffectiveCamera.of(EIGHT_BIT, (1, 2)), desired_response("log", 256.0)
    with pytest.raises(UsageError, match=f"invalid norm p = {p:g}: expected 1 to 16"):
        xi(camera, desired, 500, p=p)
    with pytest.raises(UsageError, match=f"invalid norm p = {p:g}: expected 1 to 16"):
        Objective(p=p)


def test_norms_above_1_need_a_finite_range() -> None:
    with pytest.raises(UsageError, match="p = 2 does not exist down to zero irradiance"):
        xi(
            EffectiveCamera.of(EIGHT_BIT, (1, 2)),
            desired_response("gamma", math.inf),
            500,
            p=2,
        )


@pytest.mark.parametrize("kind", ["paper", "time", "aperture", "gain"])
def test_noise_term_adds_its_formula(kind: str) -> None:
    e = np.array([1.0, 3.0, 8.0])
    read_noise = 3 * 0.01**2 / np.sum(e) ** 2
    expected = {
        "paper": 0.01**2 * np.sum(1 / e),
        "time": read_noise,
        "aperture": read_noise,
        "gain": 0.01**2 * np.sum(e**2) / np.sum(e) ** 2,
    }[kind]
    log = desired_response("log", 1000.0)
    noise = NoiseTerm(0.01, weight=7.0, kind=kind)
    noisy = ExposureProblem(EIGHT_BIT, log, 3, Objective(noise=noise)).score(e.tolist())
    plain = ExposureProblem(EIGHT_BIT, log, 3).score(e.tolist())
    assert noisy - plain == pytest.approx(7 * expected, rel=1e-9)


@pytest.mark.parametrize("jitter", [-0.1, 0.3, math.nan])
def test_jitter_must_be_a_fraction_up_to_a_fifth(jitter: float) -> None:
    with pytest.raises(UsageError, match=f"invalid exposure jitter {jitter:g}: expected a frac"):
        Objective(jitter=jitter)


def test_evaluation_of_a_bracket_of_one_stop() -> None:
    desired = desired_response("linear", 1024.0)
    found = evaluate(EIGHT_BIT, desired, (1, 2, 4))
    assert found.xi == pytest.approx(318.31, abs=0.02)
    assert found.levels_wanted == found.levels == 765
    assert found.levels_distinct == 511
    assert found.effective_levels == effective_levels(
        EffectiveCamera.of(EIGHT_BIT, (1, 2, 4)), desired
    )
    assert found.total_exposure == 7


def test_evaluation_accepts_times_in_any_order_and_unit() -> None:
    desired = desired_response("log", 1000.0)
    relative = evaluate(EIGHT_BIT, desired, (1, 8, 64))
    assert evaluate(EIGHT_BIT, desired, (64 / 1024, 1 / 1024, 8 / 1024)) == relative


def test_evaluation_uses_the_objective() -> None:
    desired = desired_response("log", 1000.0)
    found = evaluate(EIGHT_BIT, desired, (1, 8), objective=Objective(300.0, p=2.0))
    camera = EffectiveCamera.of(EIGHT_BIT, (1, 8))
    assert found.levels_wanted == 300
    assert found.xi == xi(camera, desired, 300, p=2.0)


def test_evaluation_refuses_invalid_exposures() -> None:
    with pytest.raises(UsageError, match="invalid exposure 0: expected a positive, finite number"):
        evaluate(EIGHT_BIT, desired_response("log", 1000.0), (1, 0))
