"""What keeps the menu running: reports to the service manager, and settings on disk."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from panel_fakes import FakeJob, ScriptedPanel, quit_from

from camctl import menu
from camctl.menu.app import run
from camctl.menu.data import Settings
from camctl.menu.service import ServiceNotifier
from camctl.menu.settings_file import VERSION, load_settings, save_settings


@pytest.fixture
def received(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], list[str]]]:
    """Yield a function that returns the messages that were sent to NOTIFY_SOCKET."""
    path = tmp_path / "notify"
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    listener.bind(str(path))
    listener.setblocking(False)
    monkeypatch.setenv("NOTIFY_SOCKET", str(path))

    def take() -> list[str]:
        messages = []
        while True:
            try:
                messages.append(listener.recv(4096).decode())
            except BlockingIOError:
                return messages

    yield take
    listener.close()


def test_service_reports_ready_its_screen_and_its_end(received: Callable[[], list[str]]) -> None:
    run(ScriptedPanel(quit_from("[Set]")[1:]), FakeJob)
    messages = received()
    assert messages[0] == "READY=1\nSTATUS=Starting"
    assert "STATUS=Ready" in messages
    assert messages[-1] == "STOPPING=1"


def test_watchdog_hears_twice_in_each_interval(
    received: Callable[[], list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("WATCHDOG_USEC", "10000000")
    monkeypatch.setenv("WATCHDOG_PID", str(os.getpid()))
    now = [0.0]
    notifier = ServiceNotifier(lambda: now[0])
    for tenths in range(300):
        now[0] = tenths / 10
        notifier.alive()
    assert received() == ["WATCHDOG=1"] * 6
    monkeypatch.setenv("WATCHDOG_PID", "1")
    other = ServiceNotifier(lambda: now[0])
    other.alive()
    assert received() == []


PANELS = (
    "framebuffer:/dev/fb0",
    "drm:/dev/dri/card0",
    "cfa635:/dev/ttyUSB0",
    "hd44780:/dev/i2c-1,at=0x27,size=20x4,turn=17:18,enter=27",
    "luma:st7789,interface=spi,gpio-data-command=24,gpio-reset=25",
    "web:0.0.0.0:8080",
    "mqtt:broker.local",
    "mqtt:broker.local",
)


@pytest.mark.parametrize("panel", PANELS)
def test_the_unit_has_few_rights(tmp_path: Path, panel: str) -> None:
    program = shutil.which("systemd-analyze")
    if program is None or "--offline" not in subprocess.getoutput(f"{program} --help"):
        pytest.skip("needs systemd-analyze of systemd 250 or later")
    unit = tmp_path / "camctl-menu.service"
    text = (Path(menu.__path__[0]) / unit.name).read_text()
    assert f"MENU_PANEL={PANELS[0]}\n" in text
    text = text.replace(PANELS[0], panel)
    unit.write_text(text.replace("dialout plugdev", "dialout plugdev i2c spi gpio"))
    for command in (("verify",), ("security", "--offline=true", "--threshold=30")):
        ran = subprocess.run(
            ["systemd-analyze", *command, str(unit)], capture_output=True, text=True, check=False
        )
        assert ran.returncode == 0, ran.stdout + ran.stderr


def test_settings_survive_a_restart(tmp_path: Path) -> None:
    path = tmp_path / "state" / "menu.json"
    assert load_settings(path) == (Settings(), "")
    kept = Settings(response=2, stops=16, camera="ptp:Größe 7")
    save_settings(path, kept)
    assert load_settings(path) == (kept, "")
    assert [each.name for each in path.parent.iterdir()] == ["menu.json"]


@pytest.mark.parametrize(
    ("content", "why"),
    [
        ("", "the file of the settings is damaged"),
        ("{", "the file of the settings is damaged"),
        ('{"version": 1}', "the file of the settings is damaged"),
        (json.dumps({"version": 99, "settings": {}}), "their file has version 99, not 2"),
        (
            json.dumps({"version": VERSION, "settings": {"response": 4}}),
            "their file has an invalid value of response",
        ),
        (
            json.dumps({"version": VERSION, "settings": {"camera": "\x1b[2J"}}),
            "their file has an invalid value of camera",
        ),
        ("[" * 4000, "the file of the settings is damaged"),
        (" " * 5000, "larger than"),
    ],
)
def test_damaged_settings_are_the_defaults_and_say_so(
    tmp_path: Path, content: str, why: str
) -> None:
    path = tmp_path / "menu.json"
    path.write_text(content)
    settings, remark = load_settings(path)
    assert settings == Settings()
    assert remark.startswith("Settings are the defaults: ")
    assert why in remark or "expected at most" in remark or "too large" in remark


@given(st.binary(max_size=200))
def test_no_content_of_the_settings_file_fails(content: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "menu.json"
        path.write_bytes(content)
        assert load_settings(path)[0] == Settings()


def test_link_in_place_of_the_settings_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "secret").write_text("x")
    path = tmp_path / "menu.json"
    path.symlink_to(tmp_path / "secret")
    assert "symbolic link" in load_settings(path)[1]
