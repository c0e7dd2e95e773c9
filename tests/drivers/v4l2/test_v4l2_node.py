"""The kernel's structures, and devices whose answers make no sense."""

import ctypes
import errno
import os

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from v4l2_model import PATH, Model

from camctl.errors import CamctlError, CameraProtocolError
from drivers.v4l2 import abi
from drivers.v4l2.abi import ControlId, Request
from drivers.v4l2.camera import V4l2Camera
from drivers.v4l2.formats import FORMATS, WORDS, SpoiltFrameError
from drivers.v4l2.modes import Size
from drivers.v4l2.node import MOST_FORMATS, MOST_INTERVALS, MOST_SIZES, Node

#: Printed by a C program with linux/videodev2.h on x86-64.
KERNEL = {
    Request.QUERYCAP: (0x80685600, abi.Capability, 104),
    Request.ENUM_FMT: (0xC0405602, abi.FormatDescription, 64),
    Request.G_FMT: (0xC0D05604, abi.Format, 208),
    Request.S_FMT: (0xC0D05605, abi.Format, 208),
    Request.G_PARM: (0xC0CC5615, abi.StreamParameters, 204),
    Request.G_CTRL: (0xC008561B, abi.ControlValue, 8),
    Request.S_CTRL: (0xC008561C, abi.ControlValue, 8),
    Request.QUERYCTRL: (0xC0445624, abi.ControlQuery, 68),
    Request.QUERYMENU: (0xC02C5625, abi.MenuQuery, 44),
    Request.ENUM_FRAMESIZES: (0xC02C564A, abi.SizeQuery, 44),
    Request.ENUM_FRAMEINTERVALS: (0xC034564B, abi.IntervalQuery, 52),
}


@pytest.mark.parametrize("request_", list(Request), ids=lambda each: each.name)
def test_ioctls_are_the_kernels(request_):
    number, structure, size = KERNEL[request_]
    assert int(request_) == number
    assert ctypes.sizeof(structure) == size


@pytest.mark.parametrize("number", [errno.EINVAL, errno.ENOTTY])
def test_lists_that_are_missing_are_empty(number):
    model = Model()
    model.errors = dict.fromkeys((Request.ENUM_FMT, Request.ENUM_FRAMEINTERVALS), number)
    node = Node(PATH, model)
    assert node.formats() == ()
    assert node.intervals(1, Size(1, 1)) == ()


class Endless:
    """A device whose lists never end; it counts how often it is asked."""

    def __init__(self):
        self.asked = 0

    def open(self, path):
        return 7

    def close(self, descriptor):
        pass

    def ioctl(self, descriptor, request, argument):
        self.asked += 1
        if request == Request.ENUM_FMT:
            argument.pixelformat = argument.index + 1
        else:
            argument.type = 1
            for index in range(6):
                argument.words[index] = argument.index + 1


def test_lists_that_never_end_are_cut():
    endless = Endless()
    node = Node(PATH, endless)
    assert len(node.formats()) == MOST_FORMATS
    assert node.sizes(1).largest == Size(MOST_SIZES, MOST_SIZES)
    node.intervals(1, Size(1, 1))
    assert endless.asked == MOST_FORMATS + MOST_SIZES + MOST_INTERVALS


def test_interrupted_calls_are_repeated_and_not_for_ever():
    class Interrupting(Endless):
        def ioctl(self, descriptor, request, argument):
            self.asked += 1
            raise InterruptedError(errno.EINTR, os.strerror(errno.EINTR))

    kernel = Interrupting()
    with pytest.raises(CameraProtocolError):
        Node(PATH, kernel).identity()
    assert kernel.asked == 10


def test_text_without_end():
    found = abi.Capability()
    for index in range(32):
        found.card[index] = 0x41
    assert abi.text(found.card) == "A" * 32
    found.card[0], found.card[1], found.card[2] = 0x1B, 0xFF, 0
    assert abi.text(found.card) == "?\N{REPLACEMENT CHARACTER}"


class Nonsense(Model):
    """A camera that answers some questions with random bytes or errors."""

    def __init__(self, draw):
        super().__init__()
        self._draw = draw

    def ioctl(self, descriptor, request, argument):
        kind = self._draw(st.sampled_from(["sense"] * 6 + ["bytes", "error"]))
        if kind == "error":
            number = self._draw(
                st.sampled_from([errno.EIO, errno.EINVAL, errno.EPIPE, errno.ERANGE])
            )
            raise OSError(number, os.strerror(number))
        super().ioctl(descriptor, request, argument)
        if kind == "bytes":
            size = ctypes.sizeof(argument)
            raw = self._draw(st.binary(min_size=size, max_size=size))
            ctypes.memmove(ctypes.addressof(argument), raw, size)


@settings(max_examples=300)
@given(data=st.data())
def test_no_answer_leads_out_of_our_errors(data):
    model = Nonsense(data.draw)
    try:
        with V4l2Camera(PATH, kernel=model, opener=model.video, clock=model.clock) as camera:
            controls = camera.controls
            assert 0 < controls.time_s.minimum <= controls.time_s.maximum
    except CamctlError as error:
        assert "\n" not in str(error)  # noqa: PT017
    assert model.descriptors == 0


range_words = st.integers(-(2**31), 2**31 - 1)


@settings(max_examples=300)
@given(
    control=st.sampled_from(sorted(ControlId)),
    minimum=range_words,
    maximum=range_words,
    step=range_words,
    default=range_words,
)
def test_no_range_leads_out_of_our_errors(control, minimum, maximum, step, default):
    model = Model()
    register = model.controls.setdefault(control, model.controls[ControlId.GAIN])
    register.minimum, register.maximum = minimum, maximum
    register.step, register.default = step, default
    try:
        V4l2Camera(PATH, kernel=model, opener=model.video, clock=model.clock).close()
    except CamctlError as error:
        assert "\n" not in str(error)  # noqa: PT017


@settings(max_examples=200)
@given(
    format_=st.sampled_from(FORMATS),
    data=st.binary(min_size=1, max_size=200),
    width=st.integers(1, 9),
)
def test_frames_of_any_length(format_, data, width):
    size = Size(width, 4)
    try:
        samples = format_.samples(np.frombuffer(data, np.uint8).reshape(1, -1), size)
    except SpoiltFrameError:
        return
    assert samples.shape == (4, width)
    assert samples.dtype == (np.uint8 if format_.bits == 8 else np.uint16)
    if format_.packing is not WORDS:  # samples in words may be too large: the camera checks
        assert int(samples.max()) < 2**format_.bits


@pytest.mark.parametrize(
    ("code", "raw", "samples"),
    [
        ("Y10P", [0xFF, 0x00, 0x80, 0x01, 0b11_10_01_00], [0x3FC, 0x001, 0x202, 0x007]),
        ("Y12P", [0xAB, 0x12, 0xDC], [0xABC, 0x12D]),
        ("Y16 ", [0x34, 0x12, 0xFF, 0x00], [0x1234, 0x00FF]),
        ("UYVY", [128, 7, 128, 9], [7, 9]),
        ("YUYV", [7, 128, 9, 128], [7, 9]),
    ],
)
def test_samples_are_taken_apart_as_v4l2_packs_them(code, raw, samples):
    format_ = next(each for each in FORMATS if each.code == code)
    size = Size(len(samples), 1)
    found = format_.samples(np.array([raw], np.uint8), size)
    assert found.tolist() == [samples]


def jpeg():
    rows = np.random.default_rng(1).integers(0, 255, (16, 16)).astype(np.uint8)
    done, data = cv2.imencode(".jpg", rows)
    assert done
    return data.tobytes()


@pytest.mark.parametrize("harm", ["cut", "no end", "hole", "other size", "nothing"])
def test_a_damaged_jpeg_is_told_from_a_whole_one(harm, capfd):
    """Decoders invent what is missing, and say so only where the user would see it."""
    format_ = next(each for each in FORMATS if each.code == "MJPG")
    whole, size = jpeg(), Size(16, 16)
    spoilt = {
        "cut": whole[: len(whole) // 2] + b"\xff\xd9",
        "no end": whole[:-2],
        "hole": whole[:-60] + b"\xff\xd9" + whole[-58:],
        "other size": whole,
        "nothing": b"\xff\xd8\xff\xd9",
    }[harm]
    if harm == "other size":
        size = Size(8, 8)
    assert format_.samples(np.frombuffer(whole, np.uint8), Size(16, 16)).shape == (16, 16)
    with pytest.raises(SpoiltFrameError):
        format_.samples(np.frombuffer(spoilt, np.uint8), size)
    assert capfd.readouterr() == ("", "")


def test_bytes_before_the_end_of_a_jpeg_are_harmless(capfd):
    """Many webcams send some."""
    format_ = next(each for each in FORMATS if each.code == "MJPG")
    padded = jpeg()[:-2] + b"\0\0\0\xff\xd9\0\0"
    found = format_.samples(np.frombuffer(padded, np.uint8), Size(16, 16))
    wanted = format_.samples(np.frombuffer(jpeg(), np.uint8), Size(16, 16))
    assert np.array_equal(found, wanted)
    assert capfd.readouterr() == ("", "")
