"""Random sets of exposures: the interleave step of a camera, and what every set satisfies."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camctl.exposure.random_sets import RandomSets, interleave_step
from camctl.model.response.camera import CameraResponse, linear_response, standard_response

REACH = math.log(1000.0)


@pytest.mark.parametrize("bits", range(1, 17))
def test_interleave_step_of_a_linear_camera_is_one_level(bits: int) -> None:
    assert interleave_step(linear_response(bits)) == 2.0**-bits


def test_interleave_step_of_a_curved_camera_is_its_gap_near_full_scale() -> None:
    """Brightness E^(1/3) has levels (k/256)^3, whose relative gap is 3/k."""
    camera = CameraResponse((np.arange(1, 256) / 256) ** 3, "cube root")
    assert interleave_step(camera) == pytest.approx(3 / 240, rel=0.01)


@given(st.integers(2, 8), st.integers(0, 2**32 - 1), st.sampled_from(["linear", "srgb"]))
def test_random_sets_ascend_from_1_within_reach(n: int, seed: int, name: str) -> None:
    response = linear_response(8) if name == "linear" else standard_response(name, 8)
    sets = RandomSets(np.random.default_rng(seed), n, response, REACH)
    starts = sets.starts(16)
    for found in (starts, sets.around(starts, 4)):
        assert found.shape[-1] == n
        assert np.all(found[..., 0] == 0)
        assert np.all(np.diff(found, axis=-1) >= 0)
        assert np.all(found <= REACH)
