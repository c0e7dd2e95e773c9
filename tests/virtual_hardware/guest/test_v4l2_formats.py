"""Raw formats, damaged frames and sequence numbers through the kernel, from its test driver vivid.

vivid has no control for an exposure time, so these tests use the stream (`Capture`) alone.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import virtual_devices as rig
from error_lines import one_line
from guest_processes import wait_for
from numpy.typing import NDArray

from camctl.drivers.v4l2 import abi
from camctl.drivers.v4l2.camera import V4l2Camera
from camctl.drivers.v4l2.capture import Capture, StreamMode
from camctl.drivers.v4l2.formats import FORMATS, PixelFormat
from camctl.drivers.v4l2.node import Node
from camctl.errors import CameraBusyError, CameraError, UsageError
from camctl.interface.controls import Layout

_NEXT = 0x80000000  # V4L2_CTRL_FLAG_NEXT_CTRL
_COLOUR_BARS, _GREY_RAMP = 0, 20  # test patterns of vivid
#: OpenCV 4 and 5 open a node in none of these.
RAW_CODES = ("RG10", "BA10", "GB10", "BG10", "RG12", "BA12", "GB12", "BG12", "RG16", "BYR2")


def vivid_node() -> Path | None:
    nodes = Path("/sys/class/video4linux").glob("video*")
    found = [each.name for each in nodes if (each / "name").read_text().startswith("vivid")]
    return Path("/dev", min(found)) if found else None


@pytest.fixture(scope="module")
def path() -> str:
    rig.modprobe("vivid", "n_devs=1", "node_types=0x1", "num_inputs=1", "input_types=0x0")
    wait_for("vivid", lambda: (node := vivid_node()) is not None and node.exists())
    return str(vivid_node())


@pytest.fixture
def node(path: str) -> Iterator[Node]:
    with Node(path) as opened:
        set_named(opened, "OSD Text Mode", 2)  # none, so that every frame is the same
        yield opened


def control_numbers(node: Node) -> dict[str, int]:
    """Return the number of each control by its name."""
    found: dict[str, int] = {}
    query = abi.ControlQuery(id=_NEXT)
    while True:
        try:
            node.query(abi.Request.QUERYCTRL, query, "query")
        except CameraError:
            return found
        found[abi.text(query.name)] = query.id
        query = abi.ControlQuery(id=query.id | _NEXT)


def set_named(node: Node, name: str, value: int) -> None:
    number = control_numbers(node)[name]
    node.query(abi.Request.S_CTRL, abi.ControlValue(id=number, value=value), "set")


def format_of(code: str) -> PixelFormat:
    return next(each for each in FORMATS if each.code == code)


def mode(node: Node, code: str) -> StreamMode:
    form = format_of(code)
    grid = node.sizes(form.fourcc)
    shape = min(grid.listed, key=lambda shape: shape[0] * shape[1])
    return StreamMode(form, shape, max(node.intervals(form.fourcc, shape)))


def frame(node: Node, code: str) -> NDArray[Any]:
    with closing(Capture(node, mode(node, code))) as capture:
        capture.grab()
        pixels = capture.retrieve()
    assert pixels is not None
    return pixels


def test_vivid_offers_the_raw_formats(node: Node) -> None:
    offered = node.formats()
    assert {format_of(code).fourcc for code in (*RAW_CODES, "Y10 ", "Y12 ", "GREY")} <= set(offered)


@pytest.mark.parametrize(
    ("deep", "shift", "eight_bits"),
    [
        ("RG10", 2, "RGGB"),
        ("BA12", 4, "GRBG"),
        ("GB10", 2, "GBRG"),
        ("BYR2", 8, "BA81"),
        ("Y10 ", 2, "GREY"),
        ("Y12 ", 4, "GREY"),
    ],
)
def test_deep_samples_are_those_of_8_bits_and_more(
    node: Node, deep: str, shift: int, eight_bits: str
) -> None:
    """Each format has a packing of its own in the kernel and in the driver; the picture is one."""
    set_named(node, "Test Pattern", _GREY_RAMP)
    try:
        coarse, fine = frame(node, eight_bits), frame(node, deep)
    finally:
        set_named(node, "Test Pattern", _COLOUR_BARS)
    assert fine.shape == coarse.shape
    assert len(np.unique(coarse)) > 4
    assert np.array_equal(fine >> shift, coarse)


def test_first_line_of_a_mosaic_has_the_colours_of_its_name(node: Node) -> None:
    """All patterns show one picture: the same pixels are red, in another place of the 2 x 2."""
    planes = {}
    for code in ("RG10", "BA10", "GB10", "BG10"):
        layout = format_of(code).layout
        pixels = frame(node, code)
        place = layout.value.index("r")
        planes[layout] = pixels[place // 2 :: 2, place % 2 :: 2]
    reference = planes[Layout.RGGB].astype(int)
    for layout, plane in planes.items():
        different = np.mean(np.abs(plane.astype(int) - reference) > 64)
        assert different < 0.03, layout  # edges of the bars alone


def test_sequence_numbers_and_timestamps_count_the_frames(node: Node) -> None:
    chosen = mode(node, "Y10 ")
    with closing(Capture(node, chosen)) as capture:
        stamps = [(capture.grab(), capture.sequence) for _ in range(12)]
    times_s, numbers = np.array(stamps).T
    slots = np.rint(np.diff(times_s) / capture.interval_s)
    assert np.array_equal(np.diff(numbers), slots)


def test_a_frame_with_the_error_flag_is_not_returned(node: Node) -> None:
    with closing(Capture(node, mode(node, "RG10"))) as capture:
        capture.grab()
        assert capture.retrieve() is not None
        set_named(node, "Inject V4L2_BUF_FLAG_ERROR", 1)
        whole = []
        for _ in range(12):
            capture.grab()
            whole.append(capture.retrieve() is not None)
    assert whole.count(False) == 1


def test_another_stream_of_the_node_is_busy(node: Node, path: str) -> None:
    with (
        closing(Capture(node, mode(node, "GREY"))),
        Node(path) as second,
        pytest.raises(CameraBusyError),
    ):
        Capture(second, mode(second, "RG10"))


def test_the_stream_starts_again_in_another_format(node: Node) -> None:
    for code in ("RG10", "GREY", "RG10"):
        assert frame(node, code).dtype == (np.uint8 if code == "GREY" else np.uint16)


def test_a_node_without_exposure_time_is_refused_by_name(path: str) -> None:
    with pytest.raises(CameraError) as caught:
        V4l2Camera(path).open()
    assert not isinstance(caught.value, UsageError)
    assert one_line(caught.value).startswith(f"{path} has no control for the exposure time, so")


def test_structures_have_the_size_that_the_kernel_accepts(node: Node) -> None:
    """The kernel finds a request by its number, which holds the size of its structure."""
    buffers = abi.BufferRequest(count=0, type=abi.CAPTURE_BUFFER, memory=abi.MAPPED_MEMORY)
    node.query(abi.Request.REQBUFS, buffers, "stream from")
    assert ctypes.sizeof(abi.Buffer) == 88
