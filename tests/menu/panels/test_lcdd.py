"""Debian's LCDd drives the simulated CFA635: an implementation of its packets that is not ours."""

from __future__ import annotations

import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from virtual_cfa635 import KEYS, VirtualCfa635

LCDD = shutil.which("LCDd") or shutil.which("LCDd", path="/usr/sbin")
DRIVERS = sorted(Path("/usr/lib").glob("*/lcdproc/CFontzPacket.so"))
KEY_NAMES = dict(zip(KEYS, ("Up", "Down", "Left", "Right", "Enter", "Escape"), strict=True))
CONFIGURATION = """\
[server]
DriverPath={drivers}/
Driver=CFontzPacket
Bind=127.0.0.1
Port={port}
User=root
Foreground=yes
ServerScreen=blank
WaitTime=1
Report=4
Hello="LCDd"
[CFontzPacket]
Model=635
Device={device}
Contrast=560
Brightness=700
OffBrightness=50
Reboot=no
Size=20x4
USB=no
[menu]
MenuKey=none
"""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(LCDD is None or not DRIVERS, reason="apt-get install lcdproc"),
]


class Client:
    """A client of LCDd, which answers in lines of text."""

    def __init__(self, port: int, server: subprocess.Popen[bytes]) -> None:
        while True:
            try:
                self._socket = socket.create_connection(("127.0.0.1", port), 60)
                break
            except OSError:
                assert server.poll() is None, "LCDd has ended"
                time.sleep(0.02)
        self._answers = self._socket.makefile("r")

    def send(self, line: str) -> None:
        """Send a command; it must be accepted."""
        self._socket.sendall(line.encode() + b"\n")
        while (answer := self._answers.readline().split())[0] in ("listen", "ignore"):
            pass
        assert answer[0] in ("success", "connect"), answer

    def key(self) -> str:
        """Return the next key that is reported."""
        while (words := self._answers.readline().split())[0] != "key":
            pass
        return words[1]

    def close(self) -> None:
        self._answers.close()
        self._socket.close()


@pytest.fixture
def device() -> Iterator[VirtualCfa635]:
    with VirtualCfa635() as opened:
        yield opened


@pytest.fixture
def client(device: VirtualCfa635, tmp_path: Path) -> Iterator[Client]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    path = tmp_path / "LCDd.conf"
    path.write_text(CONFIGURATION.format(drivers=DRIVERS[0].parent, port=port, device=device.path))
    assert LCDD is not None
    with (tmp_path / "log").open("wb") as log:
        server = subprocess.Popen([LCDD, "-f", "-c", str(path)], stdout=log, stderr=log)
    try:
        opened = Client(port, server)
        opened.send("hello")
        yield opened
        opened.close()
    finally:
        server.terminate()
        server.wait()


def test_text_of_lcdd_is_shown_and_keys_reach_it(device: VirtualCfa635, client: Client) -> None:
    client.send("screen_add s")
    client.send("screen_set s -priority foreground -heartbeat off -backlight on")
    for row, text in enumerate(("exposures 1, 9.58,", "82.5", "", "constant contrast"), start=1):
        client.send(f"widget_add s row{row} string")
        client.send(f'widget_set s row{row} 1 {row} "{text}"')
    client.send(f"client_add_key {' '.join(KEY_NAMES.values())}")
    device.wait_for("constant contrast")
    device.wait_for("exposures 1, 9.58,")
    assert device.lines()[1].rstrip() == "82.5"
    for key, name in KEY_NAMES.items():
        device.press(key)
        assert client.key() == name
    assert {0x0D, 0x0E, 0x1F} <= set(device.commands)  # contrast, backlight, text
