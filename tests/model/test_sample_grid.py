"""The values that samples have, and what is computed from their codes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from camctl.model.noise import FrameNoise
from camctl.model.response.camera import linear_response, standard_response
from camctl.model.sample_grid import SampleGrid

CODES: NDArray[np.uint16] = np.random.default_rng(0).integers(0, 1024, (64, 64)).astype(np.uint16)
WHITE = 65535


def found(*frames: NDArray[Any], white: int = WHITE) -> tuple[int, int]:
    """Return step and lowest value of frames."""
    grid = SampleGrid.of(frames, white)
    return grid.step, grid.first


def test_shifted_samples_have_a_step() -> None:
    assert found(CODES << 6) == (64, 0)
    assert found(CODES << 4) == (16, 0)
    assert found((CODES & 255) * np.uint16(257)) == (257, 0)  # 8 bits scaled to 16


def test_one_sample_between_decides() -> None:
    frame = CODES << 6
    frame[-1, -1] = 12345
    assert found(CODES << 6, frame) == (1, 0)
    assert found(CODES) == (1, 0)


def test_values_may_begin_anywhere() -> None:
    assert found((CODES << 5) + np.uint16(17)) == (32, 17)


def test_cut_off_samples_need_not_lie_on_the_grid() -> None:
    frame: NDArray[Any] = (CODES << 5) + np.uint16(17)
    frame[0, :3] = 0, WHITE, 65472
    assert found(frame, white=65472) == (32, 17)
    codes = SampleGrid.of([frame], 65472).codes(frame)
    assert codes[0, :3].tolist() == [0, 2045, 2045]
    assert (codes[1:] == CODES[1:]).all()


@pytest.mark.parametrize("values", [[], [0], [WHITE], [640], [0, 64, 128, 192, WHITE]])
def test_few_values_show_no_step(values: list[int]) -> None:
    assert found(np.array([values * 1000], np.uint16)) == (1, 0)


def test_values_that_are_not_above_black_show_no_step() -> None:
    assert SampleGrid.of([CODES << 6], WHITE, 65400).step == 1
    assert SampleGrid.of([CODES << 6], WHITE, 64000).step == 64


@pytest.mark.parametrize(("black", "code"), [(0, 0), (1024, 16), (1040, 16), (1057, 17)])
def test_levels_are_those_of_the_fewer_bits(black: int, code: int) -> None:
    """A sample is right in the mean less black, also where black is no value of the grid."""
    grid = SampleGrid(64, 0, WHITE)
    assert grid.nearest(black) == code
    phase = 0.5 if black else 0.0
    real = grid.response(linear_response(16, phase=phase, levels=WHITE - black), black)
    assert 1023 - code == real.M
    expected = np.arange(1, real.M + 1) - phase - (black / 64 - code)
    assert real.levels * (real.M + 1) == pytest.approx(expected)
    assert grid.light_scale(black) == pytest.approx((65536 - black) / (64 * (1024 - code)))


def test_curved_response_keeps_its_levels() -> None:
    stated = standard_response("srgb", 16)
    real = SampleGrid(64, 0, WHITE).response(stated, 0)
    assert real.levels.tolist() == stated.levels[63::64].tolist()


def test_step_1_changes_nothing() -> None:
    grid, real = SampleGrid(1, 0, 1023), linear_response(10)
    assert grid.codes(CODES) is CODES
    assert grid.response(real, 0) is real
    assert grid.light_scale(0) == 1


def test_noise_in_larger_levels_is_the_same_noise() -> None:
    noise = FrameNoise(2.0, 32.0, 64.0, 16.0, 0.01, 5, 128.0)
    assert noise.in_levels(64) == FrameNoise(128.0, 0.5, 1.0, 0.25, 0.01, 5, 2.0)
