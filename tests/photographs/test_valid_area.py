"""Pixels that a mask leaves out are filled from valid ones of the same colour."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camctl.errors import DataError
from camctl.photographs.valid_area import _nearest

pytest.importorskip("cv2", reason="OpenCV is blocked")


@given(
    st.integers(2, 30), st.integers(2, 30), st.sampled_from([1, 2]), st.integers(0, 99), st.data()
)
def test_nearest_pixels_are_valid_and_in_the_same_place_of_the_pattern(
    rows: int, columns: int, step: int, seed: int, data: st.DataObject
) -> None:
    share = data.draw(st.floats(0.01, 0.9))
    invalid = np.random.default_rng(seed).random((rows, columns)) < share
    invalid[:step, :step] = False
    row, column = np.nonzero(invalid)
    near_row, near_column = _nearest(invalid, step)
    assert not invalid[near_row, near_column].any()
    assert np.all((near_row - row) % step == 0)
    assert np.all((near_column - column) % step == 0)
    if step == 1:
        valid = np.argwhere(~invalid)
        for place, near in zip(
            zip(row, column, strict=True), zip(near_row, near_column, strict=True), strict=True
        ):
            least = np.hypot(*(valid - place).T).min()
            assert np.hypot(*np.subtract(near, place)) <= 1.2 * least  # of the fast transform


def test_a_mask_without_a_whole_block_of_the_pattern_is_refused() -> None:
    invalid = np.zeros((6, 6), np.bool_)
    invalid[::2, ::2] = True
    with pytest.raises(DataError, match="no whole block"):
        _nearest(invalid, 2)
