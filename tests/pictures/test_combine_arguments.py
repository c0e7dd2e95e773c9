"""Arguments of `combine` that do not fit: each is refused in a line that names it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import camctl
from camctl.model.noise import FrameNoise

FRAME = np.zeros((4, 4), "u1")
CURVE = camctl.linear_response(8)


@pytest.mark.parametrize(
    ("exposures", "words"),
    [
        ([], "invalid number of exposures: 0 for 1"),
        ([1, 2], "invalid number of exposures: 2 for 1"),
        ([0], r"invalid exposures \[0\]"),
        ([math.nan], r"invalid exposures \[nan\]"),
        (["1"], r"invalid exposures \['1'\]: expected a list of numbers"),
        ([None], r"invalid exposures \[None\]: expected a list of numbers"),
        (0.02, "invalid exposures 0.02: expected a list of numbers"),
    ],
)
def test_exposures_are_numbers_above_0(exposures: Any, words: str) -> None:
    with pytest.raises(camctl.UsageError, match=words):
        camctl.combine([FRAME], exposures)


def test_exposures_have_a_widest_ratio() -> None:
    with pytest.raises(camctl.UsageError, match="differ by more than a factor"):
        camctl.combine([FRAME] * 2, [1e-20, 1e20])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"white": 256}, "white level 256"),
        ({"white": 200.5}, "invalid white level 200.5: expected an integer"),
        ({"black": 8, "white": 9}, "black level 8 and white level 9"),
        ({"black": 2.5}, "invalid black level 2.5: expected an integer"),
        ({"method": "median"}, "unknown method 'median'"),
        ({"response": "unknown"}, "unknown camera response 'unknown'"),
        ({"response": CURVE, "white": 200}, "the response has 255 levels"),
        ({"response": [CURVE] * 3}, "three responses for frames of one channel"),
        ({"response": []}, "invalid response of 0 curves"),
        ({"response": None}, "invalid response of type NoneType"),
        ({"response": [2.2]}, "invalid response of type list"),
        ({"layout": "rgbg"}, "unknown layout 'rgbg'"),
        ({"layout": "rgb"}, "no layout rgb"),
        ({"noise": FrameNoise(20, 1, prnu=-1)}, "invalid prnu -1"),
        ({"noise": FrameNoise(20, 1, dsnu_levels=math.nan)}, "invalid dsnu_levels nan"),
        ({"noise": 5}, "invalid noise of type int"),
        ({"gains": (1, 2)}, r"invalid gains \[1, 2\]: expected 1 finite"),
        ({"gains": (-1,)}, r"invalid gains \[-1\]"),
        ({"noise": [FrameNoise(20, 1)] * 2}, "invalid noise of 2 frames for 1"),
    ],
)
def test_options_that_do_not_fit_are_named(options: dict[str, Any], words: str) -> None:
    with pytest.raises(camctl.UsageError, match=words):
        camctl.combine([FRAME], [1], **options)


def test_16_bits_need_a_white_level() -> None:
    with pytest.raises(camctl.UsageError, match="white level of 16-bit frames is not known"):
        camctl.combine([FRAME.astype("u2")], [1])


@pytest.mark.parametrize(
    ("frames", "words"),
    [
        ([np.zeros((4, 4))], "invalid frame of float64"),
        ([np.zeros((4, 4, 2), "u1")], "invalid frames of the shape"),
        ([FRAME, np.zeros((4, 5), "u1")], "expected frames of one shape and type"),
        ([np.ma.masked_equal(FRAME, 0)], "a mask of a frame is not used"),
    ],
)
def test_frames_are_unsigned_and_of_one_shape(frames: list[NDArray[Any]], words: str) -> None:
    with pytest.raises(camctl.DataError, match=words):
        camctl.combine(frames, list(range(1, len(frames) + 1)))


@pytest.mark.parametrize(
    ("frames", "words"),
    [([], "0 for 0 frames"), (None, "invalid frames None: expected a list of arrays")],
)
def test_no_frame_is_no_picture(frames: Any, words: str) -> None:
    with pytest.raises(camctl.UsageError, match=words):
        camctl.combine(frames, [])
