from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from camctl.errors import RefusedSettingError, UsageError
from camctl.interface.controls import (
    Choices,
    ExposureControls,
    ExposureSetting,
    Layout,
    ResponseOrigin,
    Steps,
)
from camctl.interface.orientation import Orientation


def test_choices_are_near_as_ratios() -> None:
    """1.9 is closer to 1 as a difference and closer to 3 as a ratio."""
    choices = Choices((1.0, 3.0))
    assert choices.nearest(1.9) == 3
    assert choices.near(1.9, 1) == (3,)
    assert choices.near(1.9, 2) == (1, 3)


@given(
    st.lists(st.integers(1, 10**6).map(float), min_size=1, max_size=8, unique=True).map(sorted),
    st.floats(0.1, 1e7),
    st.integers(1, 8),
)
def test_near_choices_include_the_nearest_and_are_consecutive(
    values: list[float], value: float, count: int
) -> None:
    choices = Choices(tuple(values))
    near = choices.near(value, count)
    assert choices.near(value, 1) == (choices.nearest(value),)
    assert choices.nearest(value) in near
    first = values.index(near[0])
    assert list(near) == values[first : first + min(count, len(values))]


@pytest.mark.parametrize("values", [(), (2.0, 1.0), (1.0, 1.0)])
def test_choices_must_ascend(values: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match=r"invalid choices .*: expected different ascending"):
        Choices(values)


def test_near_steps_are_consecutive_settings_around_a_value() -> None:
    steps = Steps(1.0, 5.0, 0.5)
    assert steps.nearest(2.3) == 2.5
    assert steps.near(2.3, 3) == (2.0, 2.5, 3.0)
    assert steps.near(9.0, 2) == (4.5, 5.0)
    assert Steps(1.0, 5.0).near(2.3, 3) == (2.3,)


@pytest.mark.parametrize("values", [(0.0, 1.0, 0.1), (2.0, 1.0, 0.1), (1.0, 2.0, -0.1)])
def test_invalid_steps_are_refused(values: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match="expected 0 < minimum <= maximum and step >= 0"):
        Steps(*values)


CONTROLS = ExposureControls(
    time_s=Choices((0.01, 0.1)),
    shape=(4, 6),
    layout=Layout.MONO,
    bits=8,
    white=255,
    response_origin=ResponseOrigin.STATED,
)


def test_setting_that_the_camera_has_is_accepted() -> None:
    CONTROLS.check(ExposureSetting(0.1))


def test_setting_that_the_camera_does_not_have_is_refused_with_the_nearest() -> None:
    with pytest.raises(RefusedSettingError) as caught:
        CONTROLS.check(ExposureSetting(0.08))
    assert (caught.value.control, caught.value.requested, caught.value.nearest) == (
        "time_s",
        0.08,
        0.1,
    )


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        (ExposureSetting(-1.0), "invalid time_s -1.0: expected a positive, finite number"),
        (ExposureSetting(0.1, 0.0), "invalid gain 0.0: expected a positive, finite number"),
        (ExposureSetting(0.1, 1.0, 2.8), "this camera cannot set f_number; leave f_number out"),
    ],
)
def test_invalid_settings_are_refused(setting: ExposureSetting, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        CONTROLS.check(setting)


@pytest.mark.parametrize(("bits", "black", "white"), [(17, 0, 255), (8, 255, 255), (8, 0, 256)])
def test_inconsistent_bit_depth_black_and_white_are_refused(
    bits: int, black: int, white: int
) -> None:
    message = f"invalid frames of {bits} bit with black {black} and white {white}: expected"
    with pytest.raises(ValueError, match=message):
        ExposureControls(
            time_s=Choices((1.0,)),
            shape=(2, 2),
            layout=Layout.MONO,
            bits=bits,
            black=black,
            white=white,
            response_origin=ResponseOrigin.STATED,
        )


@given(st.sampled_from(Layout), st.integers(2, 7), st.integers(2, 7), st.integers(1, 8))
def test_a_turned_mosaic_has_the_samples_of_each_colour(
    layout: Layout, rows: int, columns: int, tag: int
) -> None:
    channels = (3,) if layout is Layout.RGB else ()
    frame = np.arange(rows * columns * 3).reshape(rows, columns, 3)[..., : max(1, sum(channels))]
    frame = frame.reshape(rows, columns, *channels)
    lies = Orientation.of_tag(tag)
    turned = lies.upright(frame)
    assert np.array_equal(lies.lying(turned), frame)

    def samples(layout: Layout, frame: NDArray[Any]) -> dict[str, set[int]]:
        found: dict[str, set[int]] = {}
        letters = str(layout) if layout.is_mosaic else "rgb"
        for letter, plane in zip(letters, layout.planes(frame), strict=False):
            found.setdefault(letter, set()).update(plane.ravel().tolist())
        return found

    assert samples(layout.turned(frame.shape, lies.upright), turned) == samples(layout, frame)


def test_a_camera_that_states_a_black_level_is_right_in_the_mean() -> None:
    times = Choices((0.01, 0.02))
    raw = ExposureControls(
        times, (4, 4), Layout.MONO, 12, black=60, white=4095, response_origin=ResponseOrigin.STATED
    )
    assert raw.levels.levels[0] == pytest.approx(0.5 / 4036)
    assert replace(raw, black=0).levels.levels[0] == pytest.approx(1 / 4096)
    assert replace(raw, phase=0.0).levels.levels[0] == pytest.approx(1 / 4036)
