"""The kernel's structures, devices with invalid responses, and the packing of samples."""

from __future__ import annotations

import ctypes
import errno
import mmap
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from v4l2_model import PATH, Model

from camctl.drivers.v4l2 import abi
from camctl.drivers.v4l2.abi import ControlId, Request
from camctl.drivers.v4l2.camera import V4l2Camera
from camctl.drivers.v4l2.formats import FORMATS, PixelFormat
from camctl.drivers.v4l2.kernel import Linux, Memory
from camctl.drivers.v4l2.node import MOST_FORMATS, MOST_INTERVALS, MOST_SIZES, Node, SizeGrid
from camctl.drivers.v4l2.packing import WORDS, DamagedFrameError
from camctl.errors import CamctlError, CameraProtocolError
from camctl.interface.controls import Layout

#: Number of each ioctl, its structure, and the size of that in bytes, as printed by a C program
#: with linux/videodev2.h, linux/v4l2-subdev.h and linux/media.h on x86-64.
KERNEL: dict[Request, tuple[int, type[ctypes.Structure], int]] = {
    Request.QUERYCAP: (0x80685600, abi.Capability, 104),
    Request.ENUM_FMT: (0xC0405602, abi.FormatDescription, 64),
    Request.G_FMT: (0xC0D05604, abi.Format, 208),
    Request.S_FMT: (0xC0D05605, abi.Format, 208),
    Request.REQBUFS: (0xC0145608, abi.BufferRequest, 20),
    Request.QUERYBUF: (0xC0585609, abi.Buffer, 88),
    Request.QBUF: (0xC058560F, abi.Buffer, 88),
    Request.DQBUF: (0xC0585611, abi.Buffer, 88),
    Request.STREAMON: (0x40045612, abi.BufferType, 4),
    Request.STREAMOFF: (0x40045613, abi.BufferType, 4),
    Request.S_PARM: (0xC0CC5616, abi.StreamParameters, 204),
    Request.G_EXT_CTRLS: (0xC0205647, abi.LongValues, 32),
    Request.G_CTRL: (0xC008561B, abi.ControlValue, 8),
    Request.S_CTRL: (0xC008561C, abi.ControlValue, 8),
    Request.QUERYCTRL: (0xC0445624, abi.ControlQuery, 68),
    Request.QUERYMENU: (0xC02C5625, abi.MenuQuery, 44),
    Request.ENUM_FRAMESIZES: (0xC02C564A, abi.SizeQuery, 44),
    Request.ENUM_FRAMEINTERVALS: (0xC034564B, abi.IntervalQuery, 52),
    Request.SUBDEV_G_FMT: (0xC0585604, abi.PadFormat, 88),
    Request.ENUM_ENTITIES: (0xC1007C01, abi.Entity, 256),
}


def test_fields_of_a_media_device_are_where_the_kernel_has_them() -> None:
    found = abi.Entity.type, abi.Entity.links, abi.Entity.major, abi.PadFormat.width
    assert [each.offset for each in found] == [36, 54, 72, 8]


@pytest.mark.parametrize("request_", list(Request), ids=lambda each: each.name)
def test_ioctl_numbers_and_structure_sizes_are_those_of_the_kernel(request_: Request) -> None:
    number, structure, size = KERNEL[request_]
    assert int(request_) == number
    assert ctypes.sizeof(structure) == size


def test_structures_of_multi_planar_nodes_have_the_sizes_of_the_kernel() -> None:
    """As in linux/videodev2.h on x86-64: the format fills the same union as that of one plane."""
    assert ctypes.sizeof(abi.PlanesFormat) == ctypes.sizeof(abi.Format) == 208
    assert ctypes.sizeof(abi.PlaneFormat) == 20
    assert abi.PlanesFormat.planes.offset == 8 + 5 * 4
    assert (ctypes.sizeof(abi.Plane), abi.Plane.data_offset.offset) == (64, 16)


@pytest.mark.parametrize("number", [errno.EINVAL, errno.ENOTTY])
def test_missing_lists_are_empty(number: int) -> None:
    model = Model()
    model.errors = dict.fromkeys((Request.ENUM_FMT, Request.ENUM_FRAMEINTERVALS), number)
    node = Node(PATH, model)
    assert node.formats() == ()
    assert node.intervals(1, (1, 1)) == ()


def test_linux_maps_and_waits(tmp_path: Path) -> None:
    """The running kernel's calls, on a file and a pipe in place of a node."""
    kernel = Linux()
    page = mmap.PAGESIZE
    file = tmp_path / "buffers"
    file.write_bytes(bytes(page) + bytes(range(200)) + bytes(page - 200))
    descriptor = kernel.open(str(file))
    memory = kernel.map(descriptor, page, page)
    kernel.close(descriptor)
    assert memory[:200].tolist() == list(range(200))
    assert not memory.flags.writeable
    read, write = os.pipe()
    assert not kernel.wait(read, 0.0)
    os.write(write, b"frame")
    assert kernel.wait(read, 60.0)
    os.close(read)
    os.close(write)
    with pytest.raises(OSError, match="Bad file descriptor"):
        kernel.ioctl(read, Request.QUERYCAP, abi.Capability())


class EndlessLists:
    """A device whose lists never end; it counts the queries."""

    def __init__(self) -> None:
        self.queries = 0

    def open(self, path: str) -> int:
        return 7

    def close(self, descriptor: int) -> None:
        pass

    def map(self, descriptor: int, offset: int, length: int) -> Memory:
        raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))

    def wait(self, descriptor: int, timeout_s: float) -> bool:
        return False

    def ioctl(self, descriptor: int, request: Request, argument: Any) -> None:
        if request == Request.QUERYCAP:
            return
        self.queries += 1
        if request == Request.ENUM_FMT:
            argument.pixelformat = argument.index + 1
        else:
            argument.type = abi.Grid.DISCRETE
            for index in range(6):
                argument.words[index] = argument.index + 1


def test_endless_lists_are_cut() -> None:
    endless = EndlessLists()
    node = Node(PATH, endless)
    assert len(node.formats()) == MOST_FORMATS
    assert node.sizes(1).largest == (MOST_SIZES, MOST_SIZES)
    node.intervals(1, (1, 1))
    assert endless.queries == MOST_FORMATS + MOST_SIZES + MOST_INTERVALS


class OneRange(EndlessLists):
    """A device with one range of sizes: widths 16 to 64 in steps of 8, heights 6 to 30 by 3."""

    def ioctl(self, descriptor: int, request: Request, argument: Any) -> None:
        self.queries += 1
        argument.type = abi.Grid.STEPWISE
        argument.words[:] = [16, 64, 8, 6, 30, 3]


def test_range_of_sizes_is_one_grid() -> None:
    kernel = OneRange()
    grid = Node(PATH, kernel).sizes(1)
    assert grid == SizeGrid(((30, 64),), smallest=(6, 16), step=(3, 8))
    assert kernel.queries == 1
    assert [grid.has(shape) for shape in ((30, 64), (6, 16), (9, 24))] == [True] * 3
    assert [grid.has(shape) for shape in ((64, 30), (7, 16), (9, 23), (33, 64))] == [False] * 4


def test_interrupted_calls_are_repeated_a_limited_number_of_times() -> None:
    class Interrupted(EndlessLists):
        def ioctl(self, descriptor: int, request: Request, argument: Any) -> None:
            self.queries += 1
            raise InterruptedError(errno.EINTR, os.strerror(errno.EINTR))

    kernel = Interrupted()
    with pytest.raises(CameraProtocolError):
        Node(PATH, kernel).identity()
    assert kernel.queries == 10


def test_text_without_end_and_with_unprintable_characters() -> None:
    found = abi.Capability()
    for index in range(32):
        found.card[index] = 0x41
    assert abi.text(found.card) == "A" * 32
    found.card[0], found.card[1], found.card[2] = 0x1B, 0xFF, 0
    assert abi.text(found.card) == "?\N{REPLACEMENT CHARACTER}"


class RandomResponses(Model):
    """A camera that responds to some queries with random bytes or errors."""

    def __init__(self, draw: Callable[[st.SearchStrategy[Any]], Any]) -> None:
        super().__init__()
        self._draw = draw

    def ioctl(self, descriptor: int, request: Request, argument: ctypes.Structure) -> None:
        kind = self._draw(st.sampled_from(["valid"] * 6 + ["bytes", "error"]))
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


def open_and_close(model: Model) -> None:
    """Open a camera; it either has valid times or fails with an error of one line."""
    camera = V4l2Camera(PATH, kernel=model, clock=model.clock)
    try:
        with camera:
            times = camera.controls.time_s
            assert 0 < times.minimum <= times.maximum
    except CamctlError as error:
        assert "\n" not in str(error)  # noqa: PT017
    assert model.descriptors == 0


@given(data=st.data())
def test_random_responses_raise_no_other_errors(data: st.DataObject) -> None:
    open_and_close(RandomResponses(data.draw))


register_values = st.integers(-(2**31), 2**31 - 1)


@given(
    control=st.sampled_from(sorted(ControlId)),
    minimum=register_values,
    maximum=register_values,
    step=register_values,
    default=register_values,
)
def test_random_control_ranges_raise_no_other_errors(
    control: ControlId, minimum: int, maximum: int, step: int, default: int
) -> None:
    model = Model()
    register = model.controls.setdefault(control, model.controls[ControlId.GAIN])
    register.minimum, register.maximum = minimum, maximum
    register.step, register.default = step, default
    open_and_close(model)


def format_with(code: str) -> PixelFormat:
    return next(each for each in FORMATS if each.code == code)


@given(
    format_=st.sampled_from(FORMATS),
    data=st.binary(min_size=1, max_size=200),
    columns=st.integers(1, 9),
)
def test_frames_of_any_length_are_decoded_or_damaged(
    format_: PixelFormat, data: bytes, columns: int
) -> None:
    shape = (4, columns)
    try:
        samples = format_.packing.samples(np.frombuffer(data, np.uint8), shape)
    except DamagedFrameError:
        return
    assert samples.shape == (shape if format_.layout is not Layout.RGB else (*shape, 3))
    assert samples.dtype == (np.uint8 if format_.bits == 8 else np.uint16)
    if format_.packing is not WORDS:  # samples in words may be too large: the camera checks them
        assert int(samples.max()) < 2**format_.bits


@pytest.mark.parametrize(
    ("code", "raw", "samples"),
    [
        ("Y10P", [0xFF, 0x00, 0x80, 0x01, 0b11_10_01_00], [0x3FC, 0x001, 0x202, 0x007]),
        ("Y10B", [0xFF, 0b00_000000, 0b0001_1000, 0b000010_00, 7], [0x3FC, 0x001, 0x202, 0x007]),
        ("Y12P", [0xAB, 0x12, 0xDC], [0xABC, 0x12D]),
        (
            "pREE",
            [0xFF, 0, 1, 0x80, 0b10_000001, 0b1100_0000, 0b111111_10],
            [0x3FC1, 0x0002, 0x006C, 0x203F],
        ),
        ("Y16 ", [0x34, 0x12, 0xFF, 0x00], [0x1234, 0x00FF]),
        ("UYVY", [128, 7, 128, 9], [7, 9]),
        ("YUYV", [7, 128, 9, 128], [7, 9]),
        ("NV12", [7, 9, 128, 128], [7, 9]),
    ],
)
def test_samples_are_unpacked_as_v4l2_defines(
    code: str, raw: list[int], samples: list[int]
) -> None:
    found = format_with(code).packing.samples(np.array(raw, np.uint8), (1, len(samples)))
    assert found.tolist() == [samples]


def jpeg() -> bytes:
    rows = np.random.default_rng(1).integers(0, 255, (16, 16)).astype(np.uint8)
    done, data = cv2.imencode(".jpg", rows)
    assert done
    return data.tobytes()


@pytest.mark.parametrize("damage", ["cut", "no end", "hole", "other size", "no data"])
def test_damaged_jpeg_is_recognised(damage: str, capfd: pytest.CaptureFixture[str]) -> None:
    """Decoders invent what is missing, and report that on standard error only."""
    packing = format_with("MJPG").packing
    whole, shape = jpeg(), (16, 16)
    damaged = {
        "cut": whole[: len(whole) // 2] + b"\xff\xd9",
        "no end": whole[:-2],
        "hole": whole[:-60] + b"\xff\xd9" + whole[-58:],
        "other size": whole,
        "no data": b"\xff\xd8\xff\xd9",
    }[damage]
    if damage == "other size":
        shape = (8, 8)
    assert packing.samples(np.frombuffer(whole, np.uint8), (16, 16)).shape == (16, 16)
    with pytest.raises(DamagedFrameError):
        packing.samples(np.frombuffer(damaged, np.uint8), shape)
    assert capfd.readouterr() == ("", "")


def test_bytes_before_the_end_of_a_jpeg_are_harmless(capfd: pytest.CaptureFixture[str]) -> None:
    """Many webcams send some."""
    packing = format_with("MJPG").packing
    padded = jpeg()[:-2] + b"\0\0\0\xff\xd9\0\0"
    found = packing.samples(np.frombuffer(padded, np.uint8), (16, 16))
    undamaged = packing.samples(np.frombuffer(jpeg(), np.uint8), (16, 16))
    assert np.array_equal(found, undamaged)
    assert capfd.readouterr() == ("", "")
