"""The virtual webcam's registers and descriptors, as a host of its own finds them."""

import errno
import math
import struct

import numpy as np
import pytest
import usb.core
import uvc_host as host_side
from hypothesis import given
from hypothesis import strategies as st
from uvc_host import DEF, GAIN, INFO, LEN, MAX, MIN, MODE, RES, TIME, WHITE, WHITE_AUTO, Host

from camctl.errors import UsageError
from sim.devices.usb.backend import VirtualBackend
from sim.devices.usb.device import Refusal
from sim.devices.uvc.camera import make

SMALL = {"name": "cam", "kind": "uvc", "scene": "ramp", "sensor": "ideal-8", "size": "40x30"}


@pytest.fixture
def camera():
    return make(SMALL)


@pytest.fixture
def host(camera):
    return Host(VirtualBackend([camera]))


def refused(call, *arguments):
    with pytest.raises(usb.core.USBError) as info:
        call(*arguments)
    assert info.value.errno == errno.EPIPE


def parts(data):
    """Cut descriptors at their lengths, all of which must add up."""
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
def test_descriptors_count_and_measure_themselves(formats, sizes, rates):
    camera = make({**SMALL, "formats": formats, "sizes": sizes, "fps": rates})
    whole = camera.configuration_descriptor
    assert struct.unpack_from("<H", whole, 2)[0] == len(whole)
    each = parts(whole)
    assert [d[2] for d in each if d[1] == 4] == [0, 1]  # interfaces: control, streaming
    assert [d[5:8] for d in each if d[1] == 4] == [b"\x0e\x01\x00", b"\x0e\x02\x00"]
    assert [d[2:4] for d in each if d[1] == 5] == [b"\x81\x02"]
    streaming = whole.index(next(d for d in each if d[1:3] == b"\x24\x01" and d[3] == len(formats)))
    endpoint = len(whole) - 7
    assert struct.unpack_from("<H", whole, streaming + 4)[0] == endpoint - streaming
    control = whole.index(b"\x0d\x24\x01\x00\x01")
    assert (
        struct.unpack_from("<H", whole, control + 5)[0] == whole.index(each[7], control) - control
    )

    frames = [d for d in each if d[1] == 0x24 and d[2] in (5, 7) and len(d) >= 30]
    wanted = [(40, 30)] + [tuple(map(int, size.split("x"))) for size in sizes]
    assert [struct.unpack_from("<HH", d, 5) for d in frames] == wanted * len(formats)
    for frame in frames:
        intervals = struct.unpack_from(f"<{frame[25]}I", frame, 26)
        assert sorted(intervals) == list(intervals)
        assert {round(1e7 / interval, 1) for interval in intervals} == set(rates)
        assert round(1e7 / struct.unpack_from("<I", frame, 21)[0], 1) == rates[0]  # the default
        least, most = struct.unpack_from("<II", frame, 9)
        assert 0 < least <= most


@pytest.mark.parametrize(("sensor", "transfer"), [("ideal-8", 6), ("consumer", 7)])
def test_the_claimed_curve_is_the_sensors(sensor, transfer):
    camera = make({**SMALL, "sensor": sensor, "formats": ["yuyv"]})
    colours = [d for d in parts(camera.configuration_descriptor) if d[1:3] == b"\x24\x0d"]
    assert [d[4] for d in colours] == [transfer]


def test_each_claimed_control_answers_with_a_range_that_holds_its_value(camera, host):
    each = parts(camera.configuration_descriptor)
    terminal = next(d for d in each if d[1:3] == b"\x24\x02")
    unit = next(d for d in each if d[1:3] == b"\x24\x05")
    claimed = int.from_bytes(terminal[15:18], "little"), int.from_bytes(unit[8:10], "little")
    controls = [getattr(host_side, name) for name in ("MODE", "PRIORITY", "TIME", "BACKLIGHT")]
    controls += [host_side.BRIGHTNESS, GAIN, (2, 5, 1), WHITE, WHITE_AUTO]
    assert sum(bits.bit_count() for bits in claimed) == len(controls)
    for control in controls:
        assert host.ask(control, LEN) == control[2]
        assert host.ask(control, MIN) <= host.ask(control) <= host.ask(control, MAX)
        assert host.ask(control, DEF) == host.ask(control)
        assert host.ask(control, RES) > 0
        assert host.ask(control, INFO) & 3 == 3


def test_what_is_automatic_is_disabled_and_refused(host):
    assert host.ask(TIME, INFO) == 0x0F  # changes itself, disabled
    for control in (TIME, GAIN, WHITE):
        assert host.ask(control, INFO) & 4
        refused(host.set, control, host.ask(control, MIN))
        assert host.why() == 2  # wrong state
    host.be_manual(123)
    host.set(GAIN, 16)
    host.set(WHITE, 5000)
    assert [host.ask(c) for c in (TIME, GAIN, WHITE)] == [123, 16, 5000]
    assert not host.ask(TIME, INFO) & 4


@pytest.mark.parametrize(
    ("control", "value"), [(TIME, 0), (TIME, 2**31), (GAIN, 241), (MODE, 2), (MODE, 9), (MODE, 0)]
)
def test_out_of_range_is_refused_and_changes_nothing(host, control, value):
    host.be_manual()
    before = host.ask(control)
    refused(host.set, control, value)
    assert host.why() == 4
    assert host.ask(control) == before


def test_unknown_controls_and_requests(host):
    refused(host.ask, (1, 9, 1))
    assert host.why() == 6
    refused(host.ask, (2, 2, 2), 0x88)
    assert host.why() == 7


def test_clamping_is_silent_and_ends(camera, host):
    host.be_manual()
    camera.do("clamp", max_s=0.01)
    host.set(TIME, 400)
    assert host.ask(TIME) == 100
    host.set(TIME, 60)
    assert host.ask(TIME) == 60
    camera.do("ok")
    host.set(TIME, 400)
    assert host.ask(TIME) == 400
    with pytest.raises(UsageError):
        camera.do("clamp", max_s=math.nan)


def test_a_hanging_camera_answers_nothing(camera, host):
    camera.do("hang")
    with pytest.raises(usb.core.USBTimeoutError):
        host.ask(TIME)
    camera.do("ok")
    assert host.ask(TIME) == 157


def test_unplugging_forgets_the_settings(camera):
    backend = VirtualBackend([camera])
    Host(backend).be_manual(77)
    camera.do("unplug")
    assert usb.core.find(backend=backend) is None
    camera.do("plug")
    again = Host(backend)
    assert again.ask(TIME) == 157
    assert again.ask(MODE) != 1


def test_a_probe_is_led_to_what_there_is():
    camera = make({**SMALL, "formats": ["yuyv", "mjpg"], "sizes": ["20x10"], "fps": [10, 5]})
    host = Host(VirtualBackend([camera]))
    fields = struct.unpack("<HBBI5HII", host.probe(9, 9, 1_900_000))
    assert fields[1:4] == (2, 2, 2_000_000)
    assert fields[-2] == 20 * 10 * 2
    assert struct.unpack("<HBBI5HII", host.probe(0, 0, 0))[1:4] == (1, 1, 1_000_000)


@given(
    kind=st.sampled_from([0x21, 0xA1, 0x41, 0xC1]),
    request=st.integers(0, 255),
    value=st.integers(0, 0xFFFF),
    index=st.integers(0, 0xFFFF),
    data=st.binary(max_size=40),
)
def test_any_request_is_answered_or_refused(kind, request, value, index, data):
    camera = make(SMALL)
    camera._start = lambda: None
    answer = camera.request(kind, request, value, index, len(data), data)
    assert isinstance(answer, bytes | Refusal)
    assert camera.control(kind, request, value, index, 0, data) is not None


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"formats": ["yuv9"]}, "did you mean yuyv"),
        ({"formats": ["rggb8"]}, "rggb8 for a sensor of 8 bits, mono"),
        ({"formats": ["grey"], "sensor": "machine-vision"}, "grey for a sensor of 12 bits"),
        ({"fps": 0}, "fps"),
        ({"delay": -1}, "delay"),
        ({"sizes": ["big"]}, "WIDTHxHEIGHT"),
        ({"colour": "red"}, "colour"),
    ],
)
def test_configurations_that_do_not_fit_say_so_in_a_line(changes, words):
    with pytest.raises(UsageError, match=words) as info:
        make({**SMALL, **changes})
    assert "\n" not in str(info.value)


def test_numpy_is_not_in_the_state(camera):
    state = camera.do("state")
    assert state["format"] == "yuyv"
    assert not any(
        isinstance(v, np.generic) for v in [*state.values(), *state["controls"].values()]
    )
