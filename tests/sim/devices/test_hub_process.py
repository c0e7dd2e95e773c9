"""The process that holds virtual devices, and the socket that tells it what shall go wrong."""

import json
import os
import socket
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from camctl.errors import CameraTimeoutError, DataError, UsageError
from sim.devices import hub as hub_module
from sim.devices.hub import CONTROL, Hub, make_device, read_config, run
from sim.devices.ptp.camera import PtpCamera
from sim.devices.usb.vhci import VhciPort
from sim.devices.uvc.camera import UvcCamera

SEEN = {"scene": "ramp", "sensor": "ideal-8", "size": "40x30"}
LINE = {"name": "coolpix", "kind": "sierra", "line": "pty", **SEEN}


def written(directory, devices):
    path = directory / "config.json"
    path.write_text(json.dumps({"devices": devices}))
    return path


@pytest.fixture
def directory(tmp_path):
    """A hub with one serial camera, in a thread."""
    config, stop = written(tmp_path, [LINE]), threading.Event()
    thread = threading.Thread(target=run, args=(tmp_path, config, stop))
    thread.start()
    while thread.is_alive() and not (tmp_path / CONTROL).exists():
        stop.wait(0.01)
    yield tmp_path
    stop.set()
    thread.join(10)
    assert not thread.is_alive()
    assert not (tmp_path / CONTROL).exists()


def test_a_device_does_what_it_is_told(directory):
    hub = Hub(directory)
    assert hub.do("coolpix", "state")["session"] is False
    assert hub.do("coolpix", "nak", count=2) == {}
    with (directory / "coolpix").open("r+b", buffering=0) as line:
        assert os.isatty(line.fileno())


@pytest.mark.parametrize(
    ("device", "verb", "arguments", "words"),
    [
        ("coolpixx", "state", {}, "did you mean coolpix"),
        ("coolpix", "explode", {}, "explode"),
        ("coolpix", "nak", {"number": 2}, "number"),
    ],
)
def test_what_it_cannot_do_is_one_line(directory, device, verb, arguments, words):
    with pytest.raises(UsageError, match=words) as info:
        Hub(directory).do(device, verb, **arguments)
    assert "\n" not in str(info.value)


def test_rubbish_on_the_socket_is_answered_and_the_line_goes_on(directory):
    with socket.socket(socket.AF_UNIX) as line:
        line.settimeout(5)
        line.connect(str(directory / CONTROL))
        answers = line.makefile("rb")
        for rubbish in (b"{", b"[]", b"3", b"null", b"\xff\xfe", b'{"device": 1}', b""):
            line.sendall(rubbish + b"\n")
            assert "error" in json.loads(answers.readline())
        line.sendall(b'{"device": "coolpix", "do": "state"}\n')
        assert json.loads(answers.readline())["ok"] is True
        answers.close()


def test_one_that_keeps_its_line_open_keeps_nobody_out(directory):
    with socket.socket(socket.AF_UNIX) as idle:
        idle.connect(str(directory / CONTROL))
        assert Hub(directory).do("coolpix", "state")


def test_no_hub_is_a_timeout_in_one_line(tmp_path):
    with pytest.raises(CameraTimeoutError, match="is it running"):
        Hub(tmp_path).do("cam0", "state")


@pytest.mark.parametrize(
    "text", ["", "{}", "[]", '{"devices": 3}', '{"devices": [{"kind": "uvc"}]}', '{"devices": [3]}']
)
def test_configurations_that_list_no_devices(tmp_path, text):
    path = tmp_path / "c.json"
    path.write_text(text)
    with pytest.raises(DataError, match="no list of devices"):
        read_config(path)


def test_two_of_one_name(tmp_path):
    with pytest.raises(DataError, match="two devices of one name"):
        read_config(written(tmp_path, [LINE, LINE]))


@given(st.binary(max_size=60))
def test_any_file_is_read_or_refused(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "any.json"
    path.write_bytes(data)
    with pytest.raises(DataError):
        read_config(path)


def test_usb_kinds_go_to_the_kernels_controller(tmp_path):
    web = make_device({"name": "w", "kind": "uvc", **SEEN}, tmp_path)
    still = make_device({"name": "s", "kind": "ptp", **SEEN}, tmp_path)
    assert isinstance(web, UvcCamera)
    assert isinstance(still, PtpCamera)
    assert isinstance(web.port, VhciPort)
    assert web.port is not still.port


def test_a_serial_device_is_linked_by_its_name(tmp_path):
    device = make_device({k: v for k, v in LINE.items() if k != "line"}, tmp_path)
    device.attach()
    try:
        assert (tmp_path / "coolpix").is_symlink()
    finally:
        device.detach()


def test_an_unknown_kind(tmp_path):
    with pytest.raises(UsageError, match="did you mean uvc"):
        make_device({"name": "w", "kind": "uvcc", **SEEN}, tmp_path)


def test_all_kinds_have_a_module_that_makes_them():
    for module in hub_module.KINDS.values():
        assert callable(__import__(module, fromlist=["make"]).make)


@pytest.mark.skipif(
    Path("/sys/devices/platform/vhci_hcd.0").exists(), reason="this kernel has the controller"
)
def test_without_the_kernels_controller_the_next_step_is_named(tmp_path):
    config = written(tmp_path, [LINE, {"name": "w", "kind": "uvc", **SEEN}])
    words = [sys.executable, "-m", "sim.devices", "--dir", str(tmp_path), str(config)]
    ended = subprocess.run(words, capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 1
    assert "modprobe vhci-hcd" in ended.stderr
    assert ended.stderr.count("\n") == 1
    assert not (tmp_path / "coolpix").is_symlink()  # the devices before it have been put away
