"""The CFA635 panel against a simulated one on a pseudo-terminal."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest
from panel_fakes import FakeJob
from virtual_cfa635 import User, VirtualCfa635, checksum

from camctl.errors import UsageError
from camctl.menu.app import run
from camctl.menu.panels.cfa635 import Cfa635Panel
from camctl.menu.panels.cfa635_packets import LONGEST_DATA, Packet, PacketReader
from camctl.menu.ports import Line, Mood, PanelDisconnectedError, Screen

ENDING = (("exit", "[Set]"), ("exit", "Quit the menu?"), ("right", "[Quit]"), ("enter", ""))
SHOOTING = (
    ("", "[Set]"),
    ("enter", "Desired response"),
    ("enter", "Dynamic range"),
    ("enter", "Exposures"),
    ("enter", "Review"),
    ("enter", "Done"),
)


def operate(device: VirtualCfa635, keys: tuple[tuple[str, str], ...]) -> None:
    """Press keys, each followed by a wait for a text on the display."""
    for key, text in keys:
        if key:
            device.press(key)
        if text:
            device.wait_for(text)


SLOW = pytest.mark.slow  # an answer that is lost is waited for in real time


@pytest.mark.parametrize(
    ("loss", "damage"),
    [
        (0.0, 0.0),
        pytest.param(0.04, 0.04, marks=SLOW),
        pytest.param(0.1, 0.0, marks=SLOW),
        pytest.param(0.0, 0.2, marks=SLOW),
        pytest.param(0.08, 0.08, marks=SLOW),
    ],
)
def test_capture_is_taken_with_the_keys_of_the_panel(loss: float, damage: float) -> None:
    job = FakeJob()
    with VirtualCfa635(loss=loss, damage=damage, seed=3) as device:
        user = User(lambda: operate(device, SHOOTING + ENDING))
        summary = run(Cfa635Panel(device.path), lambda: job)
        user.finish()
        assert summary is not None
        assert device.lines() == [" " * 20] * 4
        assert device.lights() == (0, 0)
    assert len(job.shot) == 1


def test_lights_show_ready_shooting_and_error() -> None:
    with VirtualCfa635() as device, Cfa635Panel(device.path) as panel:
        found = []
        for mood in (Mood.READY, Mood.BUSY, Mood.ERROR):
            panel.show(Screen(Line(("x",)), mood=mood))
            found.append(device.lights())
        assert found == [(0, 100), (60, 100), (100, 0)]
        assert device.backlight == 100
        panel.show(Screen(Line(("x",)), is_dark=True))
        assert (device.lights(), device.backlight) == ((0, 0), 0)


def test_only_rows_that_differ_are_written() -> None:
    with VirtualCfa635() as device, Cfa635Panel(device.path) as panel:
        panel.show(Screen(Line(("Title",)), lines=(Line(("one",)),)))
        before = device.commands.count(0x1F)
        panel.show(Screen(Line(("Title",)), lines=(Line(("two",)),)))
        assert device.commands.count(0x1F) == before + 1
        assert device.lines()[1] == f"{'two':<20}"


def test_panel_that_is_unplugged_shows_the_screen_again_when_it_is_back(tmp_path: Path) -> None:
    job = FakeJob()
    link = tmp_path / "panel"  # as /dev/serial/by-id names a panel at whatever port
    with VirtualCfa635() as device:
        link.symlink_to(device.path)

        def use() -> None:
            operate(device, SHOOTING[:4])
            device.unplug()
            link.unlink()
            device.plug_in()
            link.symlink_to(device.path)
            device.wait_for("Exposures")
            operate(device, SHOOTING[4:] + ENDING)

        user = User(use)
        panel = Cfa635Panel(str(link))
        assert run(panel, lambda: job, wait=lambda _: time.sleep(0.02)) is not None
        user.finish()
    assert len(job.shot) == 1


class UnplugsAtUse:
    """A serial port whose device is unplugged just before the nth use of one of its members."""

    def __init__(self, port: Any, device: VirtualCfa635, uses: int) -> None:
        vars(self).update(port=port, device=device, left=uses)

    def _use(self) -> None:
        vars(self)["left"] -= 1
        if self.left == 0:
            self.device.unplug()

    def __getattr__(self, name: str) -> Any:
        self._use()
        return getattr(self.port, name)

    def __setattr__(self, name: str, value: Any) -> None:
        self._use()
        setattr(self.port, name, value)


@pytest.mark.parametrize("uses", range(1, 9))
def test_panel_that_is_unplugged_at_any_use_of_its_port_is_disconnected(uses: int) -> None:
    with VirtualCfa635() as device, Cfa635Panel(device.path) as panel:
        panel._port = UnplugsAtUse(panel._port, device, uses)
        with pytest.raises(PanelDisconnectedError, match="was disconnected"):
            panel.show(Screen(Line(("Title",)), lines=(Line(("one",)), Line(("two",)))))


def test_port_that_is_not_there_is_one_line() -> None:
    with pytest.raises(PanelDisconnectedError, match=r"cannot open .*nothing.*; connect it"):
        Cfa635Panel("/dev/nothing").__enter__()


def test_url_that_pyserial_does_not_know_is_refused() -> None:
    with pytest.raises(UsageError, match=r"invalid serial port 'nix://x'; use cfa635"):
        Cfa635Panel("nix://x").__enter__()


def test_device_that_does_not_answer_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("camctl.menu.panels.cfa635._ANSWER_S", 0.02)
    message = "does not answer; check its cable"
    with VirtualCfa635(loss=1.0) as device, pytest.raises(PanelDisconnectedError, match=message):
        Cfa635Panel(device.path).__enter__()


@pytest.mark.parametrize("damaged", range(8))
def test_packet_after_a_damaged_one_is_found(damaged: int) -> None:
    first = bytearray(Packet(0x41, b"abcd").encoded())
    first[damaged] ^= 0x11
    second = Packet(0x80, b"\x05")
    reader = PacketReader()
    found = list(reader.feed(bytes(first) + second.encoded()))
    for _ in range(LONGEST_DATA + 4):  # a damaged length waits for bytes that do not come
        reader.give_up()
        found += reader.feed(b"")
    assert found[-1] == second


def test_checksum_agrees_with_the_simulated_panel() -> None:
    for data in (b"", b"123456789", bytes(range(22))):
        body = bytes((0x1F, len(data))) + data
        assert Packet(0x1F, data).encoded() == body + checksum(body)
