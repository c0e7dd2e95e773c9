from __future__ import annotations

import itertools
import math
from fractions import Fraction

import numpy as np
import pytest
from cells import CELLS, Cell

from camctl.errors import UsageError
from camctl.exposure.effective import EffectiveCamera
from camctl.exposure.objective import xi
from camctl.response.camera import linear_response
from camctl.response.desired import desired_response, tabulated_desired

EIGHT_BIT = linear_response(8)


def score(cell: Cell, exposures: tuple[float, ...]) -> float:
    return xi(EffectiveCamera.of(EIGHT_BIT, exposures), cell.desired, cell.levels_wanted)


@pytest.mark.parametrize("cell", CELLS, ids=lambda cell: f"{cell.response}-{cell.n}")
def test_the_printed_table_to_the_second_decimal(cell: Cell) -> None:
    doubling = tuple(2.0**k for k in range(cell.n))
    assert round(score(cell, cell.printed), 2) == cell.printed_xi
    assert round(score(cell, cell.best), 2) == cell.best_xi
    assert round(score(cell, doubling), 2) == cell.doubling_xi


def test_four_bit_figure_with_no_darkest_irradiance() -> None:
    response, desired = linear_response(4), desired_response("linear", math.inf)
    printed = xi(EffectiveCamera.of(response, (1, 1.05, 1.11)), desired, 45)
    better = xi(EffectiveCamera.of(response, (1, 1.0465116, 2.789256)), desired, 45)
    assert round(printed, 2) == 10.20
    assert better == pytest.approx(9.383333620037048, rel=1e-13)  # in exact fractions


def test_linear_against_exact_fractions() -> None:
    exposures = (Fraction(1), Fraction(1003, 1000), Fraction(2985, 1000))
    dynamic_range, wanted = Fraction(1024), Fraction(765)
    e_min = 1 / dynamic_range
    levels = sorted(Fraction(k, 256) / e for e in exposures for k in range(1, 256))
    edges = [Fraction(0), *levels, Fraction(1)]
    slope = wanted / (1 - e_min)
    exact = sum(
        max(Fraction(0), slope * (b - a) - 1) / (b - a) * (b - max(a, e_min))
        for a, b in itertools.pairwise(edges)
        if b > max(a, e_min) and b > a
    )
    camera = EffectiveCamera.of(EIGHT_BIT, [float(e) for e in exposures])
    measured = xi(camera, desired_response("linear", 1024.0), 765)
    assert measured == pytest.approx(float(exact), rel=1e-12)


@pytest.mark.parametrize("name", ["linear", "gamma", "log"])
@pytest.mark.parametrize("p", [1.0, 1.5, 2.0, 3.0])
def test_closed_forms_against_samples(name: str, p: float) -> None:
    """A midpoint sum of the definition, fine enough for four digits."""
    desired = desired_response(name, 20.0)
    camera = EffectiveCamera.of(linear_response(3), (1, 1.6))
    edges = np.concatenate([[0.0], camera.levels, [1.0]])
    E = desired.e_min + (np.arange(2_000_000) + 0.5) / 2_000_000 * (1 - desired.e_min)
    density = 1 / np.diff(edges)[np.searchsorted(edges, E, side="right") - 1]
    sampled = np.mean(np.maximum(0, 15 * desired.slope(E) - density) ** p) * (1 - desired.e_min)
    assert xi(camera, desired, 15, p=p) == pytest.approx(sampled, rel=1e-5)


def test_a_table_of_a_straight_line_is_the_linear_response() -> None:
    table = tabulated_desired([0.01, 0.3, 0.55, 1.0], (np.array([0.01, 0.3, 0.55, 1.0])))
    camera = EffectiveCamera.of(EIGHT_BIT, (1, 1.7, 6))
    straight = desired_response("linear", 100.0)
    for p in (1.0, 2.0, 2.5):
        assert xi(camera, table, 700, p=p) == pytest.approx(xi(camera, straight, 700, p=p))


def test_a_table_with_corners_inside_gaps_is_exact() -> None:
    """One level at 1/2; slopes 3/2 then 1/2 wanted 4 times, so 6 and 2 against 2 a gap."""
    table = tabulated_desired([0.01, 0.505, 1.0], [0.0, 0.75, 1.0])
    camera = EffectiveCamera.of(linear_response(1), (1,))
    steep, flat = 4 * 0.75 / 0.495, 4 * 0.25 / 0.495
    expected = (steep - 2) * 0.495 + (flat - 2) * 0.495
    assert xi(camera, table, 4) == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize("wanted", [0, -1, math.nan, math.inf])
def test_wanted_levels_must_be_positive(wanted: float) -> None:
    with pytest.raises(UsageError, match="wanted levels"):
        xi(EffectiveCamera.of(EIGHT_BIT, (1, 2)), desired_response("log", 256.0), wanted)


@pytest.mark.parametrize("p", [0.5, 0, -1, math.nan, 17])
def test_the_norm_must_be_at_least_one(p: float) -> None:
    with pytest.raises(UsageError, match="norm"):
        xi(EffectiveCamera.of(EIGHT_BIT, (1, 2)), desired_response("log", 256.0), 500, p=p)


def test_higher_norms_need_a_finite_range() -> None:
    with pytest.raises(UsageError, match="finite dynamic range"):
        xi(
            EffectiveCamera.of(EIGHT_BIT, (1, 2)),
            desired_response("gamma", math.inf),
            500,
            p=2,
        )
