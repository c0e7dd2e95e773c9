"""Ratios between neighbours, read off the pixels."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camctl.captures.exposure_check import NeighbourCheck
from camctl.response.camera import linear_response


def staircase(E, real, black=0):
    return (np.searchsorted(real.levels, E, side="right") + black).astype(np.uint16)


def compare(real, E, first, second, said, black=0):
    check = NeighbourCheck(real, black)
    before, after = (check.sample(staircase(E * e, real, black)) for e in (first, second))
    return check.compare(before, after, said)


@given(
    bits=st.sampled_from([4, 6, 8, 12]),
    ratio=st.floats(1, 100),
    low=st.floats(1e-4, 0.5),
    seed=st.integers(0, 999),
)
def test_true_ratios_always_agree(bits, ratio, low, seed):
    real = linear_response(bits)
    E = np.exp(np.random.default_rng(seed).uniform(np.log(low), 0, (64, 80)))
    assert compare(real, E, 1.0, ratio, ratio).agrees


@pytest.mark.parametrize(("said", "true"), [(2, 1), (2, 4), (9.9, 1), (88, 9.9), (88, 1), (3, 3.5)])
def test_a_frame_with_another_exposure_is_found(said, true):
    real = linear_response(8)
    E = np.exp(np.random.default_rng(1).uniform(np.log(1e-3), 0, (200, 300)))
    result = compare(real, E, 1.0, true, said)
    assert result.measured is not None
    assert not result.agrees


def test_black_is_no_light():
    real = linear_response(10, levels=959)
    E = np.random.default_rng(2).uniform(0, 0.4, (100, 100))
    assert compare(real, E, 1.0, 2.0, 2.0, black=64).measured == pytest.approx(2, rel=0.01)


def test_what_moves_spoils_its_own_pixels_only():
    real = linear_response(8)
    E = np.random.default_rng(3).uniform(0.2, 0.45, (200, 200))
    check = NeighbourCheck(real, 0)
    before = check.sample(staircase(E, real))
    E[:40] = 0.05
    result = check.compare(before, check.sample(staircase(E * 2, real)), 2.0)
    assert result.agrees
    assert result.moved == pytest.approx(0.2, abs=0.03)


def test_frames_without_common_light_are_not_judged():
    real = linear_response(8)
    E = np.where(np.arange(10_000) % 2, 0.9, 1e-5).reshape(100, 100)
    result = compare(real, E, 1.0, 100.0, 100.0)
    assert result.measured is None
    assert result.agrees
