"""Ratios of neighbouring frames, measured on their pixels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from sampling import some

from camctl.evidence.light_ratio import FrameSample, NeighbourCheck, lamp_factor
from camctl.evidence.ratio_check import RatioCheck
from camctl.model.noise import FrameNoise
from camctl.model.response.camera import CameraResponse, linear_response
from camctl.model.sensor import FILE_OFFSET


def frame_of(E: NDArray[np.float64], real: CameraResponse, black: int = 0) -> NDArray[np.uint16]:
    """Return the frame of a noise-free camera."""
    return (np.searchsorted(real.levels, E, side="right") + black).astype(np.uint16)


def compare(
    real: CameraResponse,
    E: NDArray[np.float64],
    exposures: tuple[float, float],
    reported: float,
    black: int = 0,
) -> RatioCheck:
    """Compare frames of two exposures whose ratio is reported as `reported`."""
    check = NeighbourCheck(real, black)
    for position, exposure in enumerate(exposures):
        check.add(position, frame_of(E * exposure, real, black))
    return check.check(1, reported, (1.0, 1.0), None)


@given(
    bits=st.sampled_from([4, 6, 8, 12]),
    ratio=st.floats(1, 100),
    low=st.floats(1e-4, 0.5),
    seed=st.integers(0, 999),
)
def test_true_ratios_always_agree(bits: int, ratio: float, low: float, seed: int) -> None:
    real = linear_response(bits)
    E = np.exp(np.random.default_rng(seed).uniform(np.log(low), 0, (64, 80)))
    assert compare(real, E, (1.0, ratio), ratio).agrees


@pytest.mark.parametrize(
    ("reported", "true"), [(2, 1), (2, 4), (9.9, 1), (88, 9.9), (88, 1), (3, 3.5)]
)
def test_wrong_ratios_do_not_agree(reported: float, true: float) -> None:
    real = linear_response(8)
    E = np.exp(np.random.default_rng(1).uniform(np.log(1e-3), 0, (200, 300)))
    result = compare(real, E, (1.0, true), reported)
    assert result.measured is not None
    assert not result.agrees


def test_black_level_is_not_light() -> None:
    real = linear_response(10, levels=959)
    E = np.random.default_rng(2).uniform(0, 0.4, (100, 100))
    result = compare(real, E, (1.0, 2.0), 2.0, black=64)
    assert result.measured == pytest.approx(2, rel=0.01)


def test_moving_object_changes_only_its_own_pixels() -> None:
    real = linear_response(8)
    E = np.random.default_rng(3).uniform(0.2, 0.45, (200, 200))
    check = NeighbourCheck(real, 0)
    check.add(0, frame_of(E, real))
    E[:40] = 0.05
    check.add(1, frame_of(E * 2, real))
    result = check.check(1, 2.0, (1.0, 1.0), None)
    assert result.agrees
    assert result.moved == pytest.approx(0.2, abs=0.03)


def noisy_pair(
    true: float, *, known: bool, thing: float | None = None, seed: int = 0
) -> tuple[NeighbourCheck, FrameSample, FrameSample]:
    """Return frames of 39 electrons a level whose exposures differ by a factor of `true`.

    A thing of another light, if there is one, covers 40 % of the second frame.
    """
    real, rng = linear_response(8), np.random.default_rng(seed)
    E = np.exp(rng.uniform(np.log(0.02), np.log(0.22), (40, 50))).repeat(8, 0).repeat(8, 1)
    check, samples = NeighbourCheck(real, 0), []
    for exposure in (1.0, true):
        light = E * exposure
        if thing is not None and exposure != 1:
            light[:128] = thing
        light = light + np.hypot(np.sqrt(light / 39 / 256), 0.1 / 256) * rng.normal(size=E.shape)
        noise = FrameNoise(39.0, 0.1) if known else None
        samples.append(check.sample(frame_of(light, real), noise))
    return check, samples[0], samples[1]


@pytest.mark.parametrize("known", some([True, False], every=2, first=1))
def test_the_interval_holds_the_true_ratio_and_not_one_that_is_3_percent_off(known: bool) -> None:
    for seed in range(20):
        check, before, after = noisy_pair(4.0, known=known, seed=seed)
        right = check.compare(before, after, 4.0)
        assert right.agrees
        assert right.measured == pytest.approx(4.0, rel=right.tolerance)
        assert right.tolerance < 0.03
        wrong = check.compare(before, after, 4.0 * 1.03)
        assert not wrong.agrees
        assert wrong.is_of_whole_picture


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("thing", [0.05, 0.7])
def test_a_thing_in_two_fifths_of_the_picture_does_not_change_the_ratio(
    known: bool, thing: float
) -> None:
    check, before, after = noisy_pair(4.0, known=known, thing=thing)
    result = check.compare(before, after, 4.0)
    assert result.agrees
    assert result.measured == pytest.approx(4.0, rel=0.02)
    assert result.moved == pytest.approx(0.4, abs=0.06)


@pytest.mark.parametrize("offset", [-2, 2])
@pytest.mark.parametrize(("most", "true"), [(0.02, 4.0), (0.2, 4.0), (0.2, 1.0), (0.2, 2.8)])
def test_the_offset_of_a_photograph_makes_no_ratio_wrong_and_hides_no_wrong_one(
    offset: int, most: float, true: float
) -> None:
    real, rng = linear_response(8), np.random.default_rng(1)
    E = np.exp(rng.uniform(np.log(most / 24), np.log(most), (40, 50))).repeat(8, 0).repeat(8, 1)
    check = NeighbourCheck(real, 0, offset=FILE_OFFSET)
    short = np.maximum(frame_of(E, real).astype(np.int64) + offset, 0).astype(np.uint16)
    result = check.compare(check.sample(short), check.sample(frame_of(E * true, real)), 4.0)
    assert result.contradicts == (true != 4.0)


def test_few_electrons_do_not_shift_the_ratio() -> None:
    """At a high gain a level is a third of an electron; the scene has 6 to 20 of them."""
    real, rng = linear_response(10, levels=959), np.random.default_rng(0)
    electrons = rng.uniform(6, 20, (30, 40)).repeat(8, 0).repeat(8, 1)
    check, noise = NeighbourCheck(real, 64), FrameNoise(0.375, 13.0, black=64)
    samples = []
    for _ in range(2):
        levels = rng.poisson(electrons) / 0.375 + rng.normal(0, 13, electrons.shape)
        pixels = np.clip(np.rint(levels + 64), 0, 1023).astype(np.uint16)
        samples.append(check.sample(pixels, noise))
    result = check.compare(samples[0], samples[1], 1.0)
    assert result.agrees
    assert result.measured == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("is_known", [True, False])
@pytest.mark.parametrize("electrons", [9, 10, 11, 13])
def test_dim_noisy_frames_do_not_contradict_their_exposures(electrons: int, is_known: bool) -> None:
    """Which patches count does not depend on what noise makes of the frame that is tested."""
    rng = np.random.default_rng(electrons)
    check = NeighbourCheck(linear_response(12, phase=0.5, levels=3839), 256)
    noise = FrameNoise(1.0, 40.0, black=256) if is_known else None
    for _ in range(3):
        samples = []
        for exposure in (1, 4):
            levels = rng.poisson(electrons * exposure, (240, 320)) + rng.normal(0, 40, (240, 320))
            pixels = np.clip(np.rint(levels + 256), 0, 4095).astype(np.uint16)
            samples.append(check.sample(pixels, noise))
        assert not check.compare(samples[0], samples[1], 4.0).contradicts


def test_frames_without_common_light_have_no_measured_ratio() -> None:
    real = linear_response(8)
    E = np.where(np.arange(10_000) % 2, 0.9, 1e-5).reshape(100, 100)
    result = compare(real, E, (1.0, 100.0), 100.0)
    assert result.measured is None
    assert result.agrees


@pytest.mark.parametrize(
    ("times_s", "mains_hz", "expected"),
    [((1e-6, 1e-6), None, 1.4 / 0.6), ((0.02, 0.04), 50, 1.0), ((10, 10), None, 1.0003)],
)
def test_lamps_change_short_exposures_most(
    times_s: tuple[float, float], mains_hz: float | None, expected: float
) -> None:
    assert lamp_factor(times_s, mains_hz) == pytest.approx(expected, abs=1e-4)
