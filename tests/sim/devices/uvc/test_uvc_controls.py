"""The controls, descriptors and stream negotiation of the virtual webcam, as a host sees them."""

from __future__ import annotations

import errno
import math
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import usb.core
import uvc_host as uvc
from hypothesis import given
from hypothesis import strategies as st
from uvc_host import GAIN, INFO, MODE, TIME, WHITE, Control, Host
from virtual_usb_bus import VirtualBackend

from camctl.errors import UsageError
from camctl.sim.devices.clock import VirtualDeviceClock
from camctl.sim.devices.usb.device import ControlFailure
from camctl.sim.devices.uvc.camera import UvcCamera, make

SMALL = {"name": "cam", "kind": "uvc", "scene": "ramp", "sensor": "ideal-8", "size": "40x30"}
CONTROLS: dict[str, Control] = {
    "MODE": uvc.MODE,
    "PRIORITY": uvc.PRIORITY,
    "TIME": uvc.TIME,
    "BACKLIGHT": uvc.BACKLIGHT,
    "BRIGHTNESS": uvc.BRIGHTNESS,
    "GAIN": uvc.GAIN,
    "MAINS": uvc.MAINS,
    "WHITE": uvc.WHITE,
    "WHITE_AUTO": uvc.WHITE_AUTO,
}
WRONG_STATE, OUT_OF_RANGE, INVALID_CONTROL, INVALID_REQUEST = 2, 4, 6, 7


@pytest.fixture
def camera() -> UvcCamera:
    return make(SMALL, VirtualDeviceClock())


@pytest.fixture
def host(camera: UvcCamera) -> Host:
    return Host(VirtualBackend([camera]))


def assert_stalls(call: Callable[..., object], *arguments: Any) -> None:
    with pytest.raises(usb.core.USBError) as caught:
        call(*arguments)
    assert caught.value.errno == errno.EPIPE


def split(data: bytes) -> list[bytes]:
    """Split concatenated descriptors; their lengths must add up."""
    found = []
    while data:
        assert 2 <= data[0] <= len(data)
        found.append(data[: data[0]])
        data = data[data[0] :]
    return found


@pytest.mark.parametrize(
    ("formats", "sizes", "rates"),
    [
        (["yuyv", "mjpg"], ["80x60", "20x10"], [10, 30, 5]),
        (["grey"], [], [30]),
        (["y16"], [], [7.5]),
    ],
)
def test_total_lengths_of_descriptors(
    formats: list[str], sizes: list[str], rates: list[float]
) -> None:
    camera = make({**SMALL, "formats": formats, "sizes": sizes, "fps": rates})
    whole = camera.configuration_descriptor
    assert struct.unpack_from("<H", whole, 2)[0] == len(whole)
    each = split(whole)
    assert [d[2] for d in each if d[1] == 4] == [0, 1]  # interfaces: control, streaming
    assert [d[5:8] for d in each if d[1] == 4] == [b"\x0e\x01\x00", b"\x0e\x02\x00"]
    assert [d[2:4] for d in each if d[1] == 5] == [b"\x81\x02"]
    streaming = whole.index(next(d for d in each if d[1:3] == b"\x24\x01" and d[3] == len(formats)))
    endpoint = len(whole) - 7
    assert struct.unpack_from("<H", whole, streaming + 4)[0] == endpoint - streaming
    control = whole.index(b"\x0d\x24\x01\x00\x01")
    interface = whole.index(each[7], control)
    assert struct.unpack_from("<H", whole, control + 5)[0] == interface - control


@pytest.mark.parametrize("formats", [["yuyv", "mjpg"], ["grey"], ["y16"]])
def test_frame_descriptors_list_sizes_and_rates(formats: list[str]) -> None:
    sizes, rates = ["80x60", "20x10"], [10.0, 30.0, 7.5]
    camera = make({**SMALL, "formats": formats, "sizes": sizes, "fps": rates})
    each = split(camera.configuration_descriptor)
    frames = [d for d in each if d[1] == 0x24 and d[2] in (5, 7) and len(d) >= 30]
    expected = [(40, 30), (80, 60), (20, 10)]
    assert [struct.unpack_from("<HH", d, 5) for d in frames] == expected * len(formats)
    for frame in frames:
        intervals = struct.unpack_from(f"<{frame[25]}I", frame, 26)
        assert sorted(intervals) == list(intervals)
        assert {round(1e7 / interval, 1) for interval in intervals} == set(rates)
        assert round(1e7 / struct.unpack_from("<I", frame, 21)[0], 1) == rates[0]  # the default
        least, most = struct.unpack_from("<II", frame, 9)
        assert 0 < least <= most


@pytest.mark.parametrize(("sensor", "transfer"), [("ideal-8", 6), ("consumer", 7)])
def test_the_transfer_characteristics_are_those_of_the_sensor(sensor: str, transfer: int) -> None:
    camera = make({**SMALL, "sensor": sensor, "formats": ["yuyv"]})
    colours = [d for d in split(camera.configuration_descriptor) if d[1:3] == b"\x24\x0d"]
    assert [d[4] for d in colours] == [transfer]


def test_the_entities_declare_as_many_controls_as_there_are(camera: UvcCamera) -> None:
    each = split(camera.configuration_descriptor)
    terminal = next(d for d in each if d[1:3] == b"\x24\x02")
    unit = next(d for d in each if d[1:3] == b"\x24\x05")
    declared = int.from_bytes(terminal[15:18], "little"), int.from_bytes(unit[8:10], "little")
    assert sum(bits.bit_count() for bits in declared) == len(CONTROLS)


@pytest.mark.parametrize("control", CONTROLS.values(), ids=CONTROLS.keys())
def test_the_default_of_a_control_is_in_its_range(host: Host, control: Control) -> None:
    assert host.get(control, uvc.LEN) == control[2]
    assert host.get(control, uvc.MIN) <= host.get(control) <= host.get(control, uvc.MAX)
    assert host.get(control, uvc.DEF) == host.get(control)
    assert host.get(control, uvc.RES) > 0
    assert host.get(control, INFO) & 3 == 3


@pytest.mark.parametrize("control", [TIME, GAIN, WHITE], ids=["TIME", "GAIN", "WHITE"])
def test_an_automatic_control_is_disabled_until_the_mode_is_manual(
    host: Host, control: Control
) -> None:
    assert host.get(control, INFO) & 4
    assert_stalls(host.set, control, host.get(control, uvc.MIN))
    assert host.last_error() == WRONG_STATE
    host.set_manual()
    assert not host.get(control, INFO) & 4
    host.set(control, host.get(control, uvc.MAX))
    assert host.get(control) == host.get(control, uvc.MAX)


def test_automatic_exposure_declares_that_it_changes_the_time(host: Host) -> None:
    assert host.get(TIME, INFO) == 0x0F  # get, set, disabled, auto-updated


@pytest.mark.parametrize(
    ("control", "value"), [(TIME, 0), (TIME, 2**31), (GAIN, 241), (MODE, 2), (MODE, 9), (MODE, 0)]
)
def test_a_value_out_of_range_is_refused(host: Host, control: Control, value: int) -> None:
    host.set_manual()
    before = host.get(control)
    assert_stalls(host.set, control, value)
    assert host.last_error() == OUT_OF_RANGE
    assert host.get(control) == before


def test_unknown_controls_and_requests_are_refused(host: Host) -> None:
    assert_stalls(host.get, (1, 9, 1))
    assert host.last_error() == INVALID_CONTROL
    assert_stalls(host.get, (2, 2, 2), 0x88)
    assert host.last_error() == INVALID_REQUEST


def test_shutter_times_are_silently_cut_until_ok(camera: UvcCamera, host: Host) -> None:
    host.set_manual()
    camera.do("clamp", max_s=0.01)
    host.set(TIME, 400)
    assert host.get(TIME) == 100
    host.set(TIME, 60)
    assert host.get(TIME) == 60
    camera.do("ok")
    host.set(TIME, 400)
    assert host.get(TIME) == 400


def test_a_limit_that_is_no_time_is_refused(camera: UvcCamera) -> None:
    with pytest.raises(UsageError, match="invalid max_s nan: expected seconds above 0"):
        camera.do("clamp", max_s=math.nan)


def test_a_hanging_camera_does_not_reply_until_ok(camera: UvcCamera, host: Host) -> None:
    camera.do("hang")
    with pytest.raises(usb.core.USBTimeoutError):
        host.get(TIME)
    camera.do("ok")
    assert host.get(TIME) == 157


def test_unplugging_resets_the_controls(camera: UvcCamera) -> None:
    backend = VirtualBackend([camera])
    Host(backend).set_manual(77)
    camera.do("unplug")
    assert usb.core.find(backend=backend) is None
    camera.do("plug")
    again = Host(backend)
    assert again.get(TIME) == 157
    assert again.get(MODE) != uvc.MANUAL


@pytest.mark.parametrize(
    ("requested", "offered"),
    [((9, 9, 1_900_000), (2, 2, 2_000_000)), ((0, 0, 0), (1, 1, 1_000_000))],
)
def test_a_probe_returns_the_nearest_mode(
    requested: tuple[int, int, int], offered: tuple[int, int, int]
) -> None:
    config = {**SMALL, "formats": ["yuyv", "mjpg"], "sizes": ["20x10"], "fps": [10, 5]}
    host = Host(VirtualBackend([make(config, VirtualDeviceClock())]))
    fields = struct.unpack("<HBBI5HII", host.probe(*requested))
    assert fields[1:4] == offered
    pixels = 40 * 30 if offered[1] == 1 else 20 * 10
    assert fields[-2] == pixels * 2


@given(
    kind=st.sampled_from([0x21, 0xA1, 0x41, 0xC1]),
    request=st.integers(0, 255),
    value=st.integers(0, 0xFFFF),
    index=st.integers(0, 0xFFFF),
    data=st.binary(max_size=40),
)
def test_any_request_has_a_reply_or_is_refused(
    kind: int, request: int, value: int, index: int, data: bytes
) -> None:
    camera = make(SMALL, VirtualDeviceClock())
    reply = camera.request(kind, request, value, index, len(data), data)
    assert isinstance(reply, bytes | ControlFailure)
    assert isinstance(camera.request(0x80, 6, 0x100, 0, 18, b""), bytes)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"formats": ["yuv9"]}, "unknown pixel format 'yuv9'; did you mean yuyv"),
        (
            {"formats": ["rggb8"]},
            "the pixel format rggb8 cannot hold the pixels of a sensor of 8 bits, mono",
        ),
        ({"formats": ["grey"], "sensor": "machine-vision"}, "grey cannot .* sensor of 12 bits"),
        ({"fps": 0}, "invalid camera option fps=0"),
        ({"delay": -2}, "invalid camera option delay=-2"),
        ({"sizes": ["big"]}, "write WIDTHxHEIGHT"),
        ({"colour": "red"}, "unknown camera option 'colour'"),
    ],
)
def test_an_invalid_configuration_is_an_error_of_one_line(
    options: dict[str, Any], message: str
) -> None:
    with pytest.raises(UsageError, match=message) as caught:
        make({**SMALL, **options})
    assert "\n" not in str(caught.value)


def test_the_state_has_python_numbers_only(camera: UvcCamera) -> None:
    state = camera.do("state")
    assert state["format"] == "yuyv"
    values = [*state.values(), *state["controls"].values()]
    assert not any(isinstance(value, np.generic) for value in values)
