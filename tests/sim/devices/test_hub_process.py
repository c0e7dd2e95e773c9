"""The process that holds virtual devices, and the socket for its control commands."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from camctl.errors import CameraTimeoutError, DataError, UsageError
from camctl.sim.devices.hub import CONTROL, Hub, make_device, read_config, run
from camctl.sim.devices.ptp.camera import PtpCamera
from camctl.sim.devices.usb.vhci import VhciPort
from camctl.sim.devices.uvc.camera import UvcCamera

SCENE = {"scene": "ramp", "sensor": "ideal-8", "size": "40x30"}
COOLPIX = {"name": "coolpix", "kind": "sierra", "line": "pty", **SCENE}


def write_config(directory: Path, devices: Sequence[dict[str, Any]]) -> Path:
    path = directory / "config.json"
    path.write_text(json.dumps({"devices": devices}))
    return path


@pytest.fixture
def directory(tmp_path: Path) -> Iterator[Path]:
    """The directory of a hub with one serial camera, which runs in a thread."""
    config, stop = write_config(tmp_path, [COOLPIX]), threading.Event()
    thread = threading.Thread(target=run, args=(tmp_path, config, stop))
    thread.start()
    while thread.is_alive() and not (tmp_path / CONTROL).exists():
        stop.wait(0.01)
    yield tmp_path
    stop.set()
    thread.join()
    assert not (tmp_path / CONTROL).exists()


def test_a_control_command_is_executed(directory: Path) -> None:
    hub = Hub(directory)
    assert hub.do("coolpix", "state")["session"] is False
    assert hub.do("coolpix", "nak", count=2) == {}
    with (directory / "coolpix").open("r+b", buffering=0) as line:
        assert os.isatty(line.fileno())


@pytest.mark.parametrize(
    ("device", "command", "arguments", "message"),
    [
        ("coolpixx", "state", {}, "unknown device 'coolpixx'; did you mean coolpix"),
        ("coolpix", "explode", {}, "unknown control command 'explode'"),
        ("coolpix", "nak", {"number": 2}, "invalid request: TypeError: .*'number'"),
    ],
)
def test_an_invalid_command_is_an_error_of_one_line(
    directory: Path, device: str, command: str, arguments: dict[str, Any], message: str
) -> None:
    with pytest.raises(UsageError, match=message) as caught:
        Hub(directory).do(device, command, **arguments)
    assert "\n" not in str(caught.value)


def test_an_invalid_request_does_not_end_the_connection(directory: Path) -> None:
    with socket.socket(socket.AF_UNIX) as connection:
        connection.connect(str(directory / CONTROL))
        with connection.makefile("rb") as replies:
            for request in (b"{", b"[]", b"3", b"null", b"\xff\xfe", b'{"device": 1}', b""):
                connection.sendall(request + b"\n")
                assert "invalid request" in json.loads(replies.readline())["error"]
            connection.sendall(b'{"device": "coolpix", "do": "state"}\n')
            assert json.loads(replies.readline())["ok"] is True


def test_without_a_hub_a_command_is_a_timeout_of_one_line(tmp_path: Path) -> None:
    with pytest.raises(CameraTimeoutError, match=r"does not reply: .*; is it running") as caught:
        Hub(tmp_path).do("cam0", "state")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text", ["", "{}", "[]", '{"devices": 3}', '{"devices": [{"kind": "uvc"}]}', '{"devices": [3]}']
)
def test_a_configuration_without_a_list_of_devices_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "c.json"
    path.write_text(text)
    with pytest.raises(DataError, match="has no list of devices"):
        read_config(path)


def test_two_devices_of_the_same_name_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="has two devices of the same name"):
        read_config(write_config(tmp_path, [COOLPIX, COOLPIX]))


def test_each_usb_device_has_a_port_of_the_kernels_controller(tmp_path: Path) -> None:
    webcam = make_device({"name": "w", "kind": "uvc", **SCENE}, tmp_path)
    still = make_device({"name": "s", "kind": "ptp", **SCENE}, tmp_path)
    assert isinstance(webcam, UvcCamera)
    assert isinstance(still, PtpCamera)
    assert isinstance(webcam.port, VhciPort)
    assert isinstance(still.port, VhciPort)
    assert webcam.port is not still.port


def test_a_serial_device_without_a_line_has_a_link_with_its_name(tmp_path: Path) -> None:
    device = make_device({k: v for k, v in COOLPIX.items() if k != "line"}, tmp_path)
    device.attach()
    try:
        assert (tmp_path / "coolpix").is_symlink()
    finally:
        device.detach()


def test_an_unknown_kind_of_device_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="unknown kind of virtual device 'uvcc'; did you mean uvc"):
        make_device({"name": "w", "kind": "uvcc", **SCENE}, tmp_path)


@pytest.mark.skipif(
    Path("/sys/devices/platform/vhci_hcd.0").exists(), reason="this kernel has the controller"
)
def test_without_the_kernels_controller_the_error_says_how_to_load_it(tmp_path: Path) -> None:
    config = write_config(tmp_path, [COOLPIX, {"name": "w", "kind": "uvc", **SCENE}])
    command = [sys.executable, "-m", "camctl.sim.devices", "--dir", str(tmp_path), str(config)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 1
    assert "this kernel has no virtual USB controller; run modprobe vhci-hcd" in ended.stderr
    assert ended.stderr.count("\n") == 1
    assert not (tmp_path / "coolpix").is_symlink()  # devices that were attached are detached
