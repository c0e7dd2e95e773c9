"""The virtual CoolPix 990 on a pseudo-terminal, in real time."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import serial

from camctl.errors import CameraNotFoundError
from camctl.sim.devices.sierra import device as sierra

BASE = {"scene": "ramp", "sensor": "ideal-8", "size": "48x32"}
NAK = b"\x15"
SILENCE_S = 60.0  # after which a test gives up
READ_BATTERY = bytes([0x1B, 0x53, 2, 0, 1, 16, 17, 0])


@pytest.fixture
def device(tmp_path: Path) -> Iterator[sierra.SierraDevice]:
    device = sierra.make({**BASE, "link": str(tmp_path / "camera"), "silence_s": SILENCE_S})
    device.attach()
    yield device
    device.detach()


@pytest.fixture
def port(device: sierra.SierraDevice) -> Iterator[Any]:
    port = serial.Serial(device.line.path, 19200, timeout=SILENCE_S)
    yield port
    port.close()


def test_bytes_at_another_speed_are_ignored(
    device: sierra.SierraDevice, port: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    is_processed = threading.Event()

    def process(data: bytes) -> None:
        device.received(data)
        is_processed.set()

    monkeypatch.setattr(device.line, "_received", process)
    port.baudrate = 38400
    port.write(b"\0")
    assert is_processed.wait(SILENCE_S)
    port.baudrate = 19200
    port.write(READ_BATTERY)
    assert len(port.read(10)) == 10  # no NAK before it
    assert device.do("state")["packets"] == 1


def use_forever(port: Any) -> None:
    while True:
        port.write(b"\0")
        port.read()


def test_the_link_exists_while_the_camera_is_plugged_in(
    device: sierra.SierraDevice, port: Any, tmp_path: Path
) -> None:
    link = tmp_path / "camera"
    assert os.path.realpath(link) == device.line.path
    device.do("unplug")
    assert not link.is_symlink()
    with pytest.raises(OSError):  # noqa: PT011 - a SerialException, or the terminal's own error
        use_forever(port)
    device.do("plug")
    with serial.Serial(str(link), 19200, timeout=SILENCE_S) as again:
        again.write(b"\0")
        assert again.read() == NAK


@pytest.mark.parametrize(
    ("node", "message"),
    [
        ("/dev/nothing", "cannot open the virtual camera's line /dev/nothing: No such file"),
        ("/dev/null", "the virtual camera's line /dev/null is not a terminal"),
    ],
)
def test_a_node_that_is_not_a_serial_line(node: str, message: str) -> None:
    device = sierra.make({**BASE, "line": node})
    with pytest.raises(CameraNotFoundError, match=message):
        device.attach()
    device.detach()
