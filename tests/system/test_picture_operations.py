"""Operations on pictures are the same with OpenCV and without it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from camctl.errors import DataError, UsageError
from camctl.pictures.drawing import PAPER, Drawing
from camctl.system import picture_operations as operations

pytestmark = pytest.mark.usefixtures("cv2")

Sides = tuple[int, int]
SIDES = st.tuples(st.integers(1, 40), st.integers(1, 40))
SHAPES = st.one_of(
    SIDES, SIDES.map(lambda sides: (*sides, 1)), SIDES.map(lambda sides: (*sides, 3))
)
TYPES = st.sampled_from([np.uint8, np.uint16, np.float32])


def random(shape: tuple[int, ...], kind: Any = np.float32, seed: int = 0) -> NDArray[Any]:
    values = np.random.default_rng(seed).random(shape)
    most = 1.0 if kind is np.float32 else float(np.iinfo(kind).max)
    return np.asarray(values * most, kind)


def both(operation: Callable[[], NDArray[Any]]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return what an operation gives with OpenCV and without it."""
    with pytest.MonkeyPatch.context() as patch:
        theirs = operation()
        patch.setattr(operations, "opencv", lambda: None)
        return theirs, operation()


def check(operation: Callable[[], NDArray[Any]]) -> None:
    theirs, ours = both(operation)
    assert ours.shape == theirs.shape
    assert ours.dtype == theirs.dtype
    if theirs.dtype.kind == "f":
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-5 * max(1e-9, abs(theirs).max()))
    else:
        assert np.abs(ours.astype(int) - theirs.astype(int)).max() <= 1


@given(SHAPES, TYPES, st.floats(0.01, 1.0))
def test_reduction_by_area(shape: tuple[int, ...], kind: Any, factor: float) -> None:
    size = max(1, round(shape[1] * factor)), max(1, round(shape[0] * factor))
    check(lambda: operations.reduced_by_area(random(shape, kind), size))


def test_reduction_to_a_larger_size_keeps_each_pixel() -> None:
    check(lambda: operations.reduced_by_area(random((5, 7)), (17, 12)))


@given(SHAPES, SIDES)
def test_smooth_enlargement(shape: tuple[int, ...], added: Sides) -> None:
    size = shape[1] + added[0], shape[0] + added[1]
    check(lambda: operations.enlarged_smoothly(random(shape), size))


@given(SHAPES, st.integers(0, 9))
def test_box_means(shape: tuple[int, ...], radius: int) -> None:
    check(lambda: operations.box_means(random(shape), radius))


@given(SIDES.flatmap(lambda s: st.sampled_from([s, (*s, 3)])), st.booleans())
def test_correlation(shape: tuple[int, ...], repeats_border: bool) -> None:
    kernel = random((3, 3), seed=1)
    check(lambda: operations.correlated(random(shape), kernel, repeats_border=repeats_border))


@given(SIDES.flatmap(lambda s: st.sampled_from([s, (*s, 3)])), st.integers(0, 6))
def test_smoothing(shape: tuple[int, ...], reach: int) -> None:
    check(lambda: operations.smoothed(random(shape), random((2 * reach + 1,), seed=1)))


@given(SIDES, SIDES)
def test_dilation(shape: Sides, size: Sides) -> None:
    marks = random(shape, np.uint8) * (random(shape, seed=1) > 0.9)
    rows, columns = size[0] | 1, size[1] | 1
    theirs, ours = both(lambda: operations.dilated(marks.astype(np.uint8), (rows, columns)))
    np.testing.assert_array_equal(ours, theirs)


@given(SIDES, st.floats(0, 1))
def test_connected_parts(shape: Sides, share: float) -> None:
    marks = np.asarray(random(shape) < share)
    theirs, ours = both(lambda: operations.connected_parts(marks)[0])
    pairs = {(0, 0), *zip(theirs.ravel().tolist(), ours.ravel().tolist(), strict=True)}
    assert len(pairs) == theirs.max() + 1 == ours.max() + 1  # the same parts, in any order
    of_theirs, of_ours = both(lambda: operations.connected_parts(marks)[1])
    assert {(k, *of_theirs[k].tolist()) for k, _ in pairs if k} == {
        (k, *of_ours[other].tolist()) for k, other in pairs if k
    }


@given(SHAPES.filter(lambda shape: shape[2:] != (1,)), st.sampled_from([np.uint8, np.uint16]))
def test_png_files_are_read_by_opencv(shape: tuple[int, ...], kind: Any) -> None:
    import cv2

    picture = random(shape, kind)
    data = np.frombuffer(operations.png(picture), np.uint8)
    read = np.asarray(cv2.imdecode(data, cv2.IMREAD_UNCHANGED))
    np.testing.assert_array_equal(read if read.ndim == 2 else read[..., ::-1], picture)


@given(SHAPES.filter(lambda shape: shape[2:] != (1,)), st.binary(max_size=4))
def test_own_png_files_are_read_back_and_others_refused(
    shape: tuple[int, ...], noise: bytes
) -> None:
    picture = random(shape, np.uint8)
    data = operations.png(picture)
    assert np.array_equal(operations.png_pixels(data), picture)
    for damaged in (data[: -1 - len(noise) - 12], data[:40] + noise + b"x" + data[40:], noise):
        with pytest.raises(DataError, match="PNG"):
            operations.png_pixels(damaged)
    with pytest.raises(DataError, match="PNG"):
        operations.png_pixels(operations.png(picture.astype(np.uint16)))


@pytest.mark.parametrize("size", [0.36, 0.42, 0.48, 0.66])
def test_text_stays_in_its_place_without_opencv(size: float) -> None:
    text, place = "1/250 s, gain 2 (gjpqy)", (20, 30)

    def box() -> NDArray[Any]:
        drawing = Drawing(400, 60)
        drawing.text(text, place, 300, size=size)
        rows, columns = np.nonzero((drawing.pixels != PAPER[0]).any(axis=2))
        assert columns.max() < place[0] + operations.text_width(text, size) + 2
        return np.array([rows.min(), columns.min(), rows.max()])

    theirs, ours = both(box)
    assert abs(ours[1] - theirs[1]) <= 1
    assert ours[0] >= theirs[0] - 2  # no letter leaves the line
    assert ours[2] <= theirs[2] + 2


def test_what_needs_opencv_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(operations, "opencv", lambda: None)
    with pytest.raises(UsageError, match="decoding JPEG frames needs OpenCV, which is not inst"):
        operations.required_opencv("decoding JPEG frames")


@given(SHAPES, st.sampled_from([np.uint8, np.uint16, np.uint32, np.float32, np.float16, np.bool_]))
def test_channels_apart_and_together(shape: tuple[int, ...], kind: Any) -> None:
    picture = (np.random.default_rng(0).random(shape) * 255).astype(kind)
    for planes in both(lambda: np.stack(operations.channels_apart(picture))):
        assert np.array_equal(np.moveaxis(planes, 0, -1), picture.reshape(*shape[:2], -1))
    for again in both(lambda: operations.channels_together(operations.channels_apart(picture))):
        assert again.dtype == picture.dtype
        assert np.array_equal(again, picture.reshape(again.shape))


def test_halves_are_those_of_numpy() -> None:
    """Every float16, infinity and NaN included, and what is between those near 0."""
    halves = np.arange(1 << 16, dtype=np.uint16).view(np.float16).reshape(256, 256)
    small = random((100, 100)) * np.float32(2.0**-14)
    for values in (halves.astype(np.float32), small, -small):
        for found in both(lambda values=values: operations.as_halves(values)):  # type: ignore[misc]
            assert found.dtype == np.float16
            assert np.array_equal(found, values.astype(np.float16), equal_nan=True)


@given(SHAPES, st.sampled_from([np.uint8, np.uint16, np.uint32]), st.integers(1, 3))
def test_counts_of_levels(shape: tuple[int, ...], kind: Any, step: int) -> None:
    """Of contiguous pictures and of views, as the planes of a mosaic."""
    levels = 1000 if kind is not np.uint8 else 256
    picture = np.random.default_rng(0).integers(0, levels, shape).astype(kind)[::step, ::step]
    where = random(picture.shape) < 0.5
    for counts in both(lambda: operations.level_counts(picture, levels)):
        assert counts.tolist() == np.bincount(picture.ravel(), minlength=levels).tolist()
    for counts in both(lambda: operations.level_counts(picture, levels, where)):
        assert counts.tolist() == np.bincount(picture[where], minlength=levels).tolist()


@pytest.mark.parametrize("kind", [np.uint8, np.int16, np.int64, np.float32, np.float64])
@pytest.mark.parametrize(
    ("shape", "levels"), [((5, 3), 256), ((4, 50, 40), 200), ((4, 50, 40), 256), ((3000,), 300)]
)
def test_values_of_a_table(kind: type, shape: tuple[int, ...], levels: int) -> None:
    rng = np.random.default_rng(0)
    table: np.ndarray = rng.integers(0, 100, levels).astype(kind)
    samples = rng.integers(0, min(levels, 256), shape).astype(np.uint8)
    check_values(table, samples)


@pytest.mark.parametrize("kind", [np.uint8, np.int16, np.float32])
@pytest.mark.parametrize(
    ("shape", "levels"),
    [((5, 3), 65536), ((600, 500), 200), ((600, 500), 65536), ((500, 300, 3), 4000)],
)
def test_values_of_a_wide_table(kind: type, shape: tuple[int, ...], levels: int) -> None:
    rng = np.random.default_rng(0)
    table: np.ndarray = rng.integers(0, 100, levels).astype(kind)
    samples = rng.integers(0, levels, shape).astype(np.uint16)
    check_values(table, samples)
    check_values(table, samples[::2, ::2])


def check_values(table: NDArray[Any], samples: NDArray[Any]) -> None:
    for found in both(lambda: operations.looked_up(table, samples)):
        assert found.dtype == table.dtype
        assert (found == table[samples]).all()


def test_counts_of_levels_are_exact_where_float32_is_not() -> None:
    picture = np.zeros((4097, 4097), np.uint8)  # 2^24 + 8193
    assert operations.level_counts(picture, 256)[0] == picture.size


@given(SHAPES, st.sampled_from([1, 3, 9]))
def test_sums_along_columns(shape: tuple[int, ...], length: int) -> None:
    marks = random(shape) < 0.5
    for counts in both(lambda: operations.sums_along_columns(marks, length)):
        for row in range(shape[0]):
            near = marks[max(0, row - length // 2) : row + length // 2 + 1]
            assert (counts[row] == near.sum(axis=0)).all()
