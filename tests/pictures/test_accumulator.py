"""The running sum against exact integers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camctl.errors import CaptureError, UsageError
from camctl.pictures.accumulator import Accumulator, sum_dtype
from camctl.pictures.compiled_sum import load
from camctl.system.compiled_functions import LoadedLater


@given(
    bits=st.integers(1, 16),
    count=st.integers(1, 16),
    shape=st.sampled_from([(1, 1), (3, 5), (7, 4, 3), (1, 1025)]),
    share=st.floats(0, 1),
    seed=st.integers(0, 2**32 - 1),
)
def test_sum_is_exactly_that_of_frames_clipped_at_white(
    bits: int, count: int, shape: tuple[int, ...], share: float, seed: int
) -> None:
    white = max(1, round(share * (2**bits - 1)))
    dtype = np.dtype(np.uint8) if bits <= 8 else np.dtype(np.uint16)
    frames = np.random.default_rng(seed).integers(0, 2**bits, (count, *shape)).astype(dtype)
    total = Accumulator(shape, dtype, count, white)
    for frame in frames:
        total.accumulate(frame)
    assert np.array_equal(total.total, np.minimum(frames, white).sum(axis=0, dtype=np.int64))
    total.withdraw(frames[0])
    rest = np.minimum(frames[1:], white).sum(axis=0, dtype=np.int64)
    assert np.array_equal(total.total, rest)


def test_tiles_cover_a_large_frame_without_a_gap() -> None:
    # More than two tiles, and not a multiple of one.
    frame = np.arange(2 * (1 << 20) + 77, dtype=np.uint32).astype(np.uint8).reshape(1, -1)
    total = Accumulator(frame.shape, frame.dtype, 3, 200)
    for _ in range(3):
        total.accumulate(frame)
    assert np.array_equal(total.total, 3 * np.minimum(frame, 200).astype(np.int64))


def test_six_frames_of_14_bits_do_not_wrap() -> None:
    frame = np.full((2, 2), 16383, np.uint16)
    total = Accumulator(frame.shape, frame.dtype, 6, 16383)
    for _ in range(6):
        total.accumulate(frame)
    assert total.total.tolist() == [[98298, 98298], [98298, 98298]]


def test_type_of_the_sum_is_the_narrowest_that_holds_it() -> None:
    assert sum_dtype(6, 255) == np.uint16
    assert sum_dtype(257, 255) == np.uint16
    assert sum_dtype(258, 255) == np.uint32
    assert sum_dtype(65537, 65535) == np.uint32
    with pytest.raises(UsageError, match="take at most 65537 exposures"):
        sum_dtype(65538, 65535)


def test_frame_of_another_format_is_an_error_that_names_both_formats() -> None:
    total = Accumulator((2, 2), np.dtype(np.uint8), 2, 255)
    message = r"a frame of \(2, 3\) uint8 came after frames of \(2, 2\) uint8"
    with pytest.raises(CaptureError, match=message):
        total.accumulate(np.zeros((2, 3), np.uint8))


def test_frame_that_is_not_contiguous_is_summed_in_its_own_order() -> None:
    frame = np.arange(24, dtype=np.uint8).reshape(4, 6)[:, ::-1]
    total = Accumulator(frame.shape, frame.dtype, 1, 255)
    total.accumulate(frame)
    assert np.array_equal(total.total, frame)


@pytest.mark.parametrize(
    ("dtype", "white"), [("uint8", 250), ("uint8", 255), ("uint16", 4000), ("uint16", 65535)]
)
def test_compiled_sums_are_those_of_numpy(
    dtype: str, white: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("numba")
    random = np.random.default_rng(3)
    most = np.iinfo(dtype).max
    frames = random.integers(0, most, (3, 40, 61), dtype=np.dtype(dtype), endpoint=True)
    totals = []
    for is_used in (False, True):
        choice = LoadedLater(load, 1, is_used)
        monkeypatch.setattr("camctl.pictures.accumulator.CHOICE", choice)
        total = Accumulator(frames[0].shape, frames.dtype, 2, white)
        total.accumulate(frames[0])
        total.accumulate(frames[1])
        total.exchange(frames[0], frames[2])
        totals.append(total.total.copy())
        total.withdraw(frames[1])
        assert np.array_equal(total.total, np.minimum(frames[2], white))
    assert np.array_equal(totals[0], totals[1])
