"""`camctl.VideoCapture`: what OpenCV's class does, it does too."""

from __future__ import annotations

import threading
import time
from types import SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np
import pytest

import camctl
from camctl.errors import UsageError
from camctl.exposure.goal import CaptureRequest
from camctl.livestream import video_capture

GIVEN = CaptureRequest(base_s=0.002, ratios=(1, 4, 16), dynamic_range=256)


@pytest.mark.parametrize(("bits", "dtype"), [(8, np.uint8), (16, np.uint16)])
def test_the_class_of_opencv(bits: int, dtype: type) -> None:
    import cv2

    options = {"scene": "ramp", "size": "64x48", "sensor": "webcam"}
    capture = camctl.VideoCapture("sim", request=GIVEN, bits=bits, options=options)
    assert capture.isOpened()
    found, picture = capture.read()
    assert found
    assert picture is not None
    assert picture.shape == (48, 64, 3)
    assert picture.dtype == dtype
    assert capture.result is not None
    assert np.array_equal(picture[..., 0] >> (bits - 8), capture.result.image[..., 2] >> 8)
    assert capture.get(cv2.CAP_PROP_FRAME_WIDTH) == 64
    assert capture.get(cv2.CAP_PROP_FRAME_HEIGHT) == 48
    assert capture.get(cv2.CAP_PROP_FPS) == pytest.approx(30)
    for number, value in (
        (cv2.CAP_PROP_FRAME_WIDTH, 64),
        (cv2.CAP_PROP_FRAME_WIDTH, 640),
        (cv2.CAP_PROP_GAIN, 0),
        (cv2.CAP_PROP_CONVERT_RGB, 0),
    ):
        assert not capture.set(number, value)
    assert capture.get(cv2.CAP_PROP_FORMAT) == (cv2.CV_8UC3 if bits == 8 else cv2.CV_16UC3)
    capture.release()
    capture.release()
    assert capture.read() == (False, None)
    assert capture.retrieve() == (False, None)
    assert not capture.isOpened()


def test_a_camera_without_colours_has_three_channels_unless_asked_otherwise() -> None:
    import cv2

    capture = camctl.VideoCapture("sim", request=GIVEN, options={"scene": "ramp", "size": "64x48"})
    found, picture = capture.read()
    assert found
    assert picture is not None
    assert picture.shape == (48, 64, 3)
    assert cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY).tolist() == picture[..., 0].tolist()
    assert capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)
    assert capture.get(cv2.CAP_PROP_FORMAT) == cv2.CV_8U
    grey = capture.retrieve()[1]
    assert grey is not None
    assert np.array_equal(grey, picture[..., 0])
    capture.release()


@pytest.mark.parametrize("camera_id", [0, 7])
def test_a_number_opens_no_camera(camera_id: int) -> None:
    capture = camctl.VideoCapture(camera_id)
    assert not capture.isOpened()
    assert isinstance(capture.error, UsageError)
    assert capture.read() == (False, None)


@pytest.mark.parametrize("preference", [200, -1, GIVEN])
def test_no_backend_is_chosen_by_a_number(preference: Any) -> None:
    capture = camctl.VideoCapture("sim", preference)
    assert not capture.isOpened()
    assert "expected CAP_ANY (0)" in str(capture.error)
    assert "\n" not in str(capture.error)


def test_the_second_argument_is_that_of_opencv() -> None:
    import cv2

    size = {"size": "64x48"}
    for capture in (
        camctl.VideoCapture("sim", cv2.CAP_ANY, options=size),
        camctl.VideoCapture("sim", apiPreference=cv2.CAP_ANY, options=size),
    ):
        assert capture.isOpened()
        capture.release()


@pytest.mark.parametrize(
    ("constants", "colours", "grey"),
    [
        ({"CV_8UC1": 0, "CV_8UC3": 16}, 16, 0),  # OpenCV 4
        ({"CV_8UC1": 0, "CV_8UC3": 64}, 64, 0),  # OpenCV 5
        (None, 16, 0),
    ],
)
def test_the_numbers_of_opencv_are_those_of_its_version(
    constants: dict[str, int] | None, colours: int, grey: int
) -> None:
    module = None if constants is None else SimpleNamespace(**constants)
    capture = camctl.VideoCapture("sim", request=GIVEN, options={"size": "64x48"})
    with mock.patch.object(video_capture, "opencv", return_value=module):
        assert capture.get(8) == colours
        assert capture.set(16, 0)
        assert capture.get(8) == grey
    capture.release()


def test_numbers_of_properties_are_those_of_the_opencv_that_is_here() -> None:
    import cv2

    for name in ("POS_MSEC", "FRAME_WIDTH", "FRAME_HEIGHT", "FPS", "POS_FRAMES", "FORMAT"):
        short = name.removeprefix("FRAME_")
        assert getattr(video_capture, f"_{short}") == getattr(cv2, f"CAP_PROP_{name}")
    assert cv2.CAP_PROP_CONVERT_RGB == video_capture._CONVERT_RGB
    assert cv2.CAP_ANY == video_capture._ANY


def test_a_read_ends_where_another_thread_releases_the_camera() -> None:
    options = {"scene": "ramp", "size": "64x48", "time": "real"}
    capture = camctl.VideoCapture("sim", request=GIVEN, options=options)
    assert capture.read()[0]
    ends: list[Any] = []

    def read() -> None:
        try:
            while capture.read()[0]:
                pass
            ends.append(capture.read())
        except BaseException as error:
            ends.append(error)

    reader = threading.Thread(target=read)
    reader.start()
    time.sleep(0.1)
    capture.release()
    reader.join(20)
    assert ends == [(False, None)]


def test_a_camera_that_cannot_be_opened_is_not_open() -> None:
    capture = camctl.VideoCapture("v4l2:/dev/none")
    assert not capture.isOpened()
    assert capture.error is not None
    assert capture.read() == (False, None)
