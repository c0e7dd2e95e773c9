"""The frame buffer panel on a file in place of the device, and keys from named pipes."""

from __future__ import annotations

import os
import struct
from pathlib import Path

import numpy as np
import pytest

from camctl.errors import CamctlError, UsageError
from camctl.interface.clock import VirtualClock
from camctl.menu.drawing import Drawing, draw
from camctl.menu.panels.framebuffer import FramebufferPanel
from camctl.menu.panels.input_keys import InputKeys
from camctl.menu.ports import Key, Line, Screen

SCREEN = Screen(Line(("Ready",)), lines=(Line(("one",)),), actions=("Set",))
RGB565 = ((11, 5), (5, 6), (0, 5))
RGB888 = ((16, 8), (8, 8), (0, 8))


def variable_info(
    columns: int, rows: int, bits: int, channels: tuple[tuple[int, int], ...], top: int = 0
) -> bytes:
    """Return the beginning of `struct fb_var_screeninfo`."""
    fields = [value for first, size in channels for value in (first, size, 0)]
    head = struct.pack("@8I", columns, rows, columns, rows, 0, top, bits, 0)
    return (head + struct.pack("@12I", *fields, 0, 0, 0)).ljust(160, b"\0")


def fixed_info(line_bytes: int) -> bytes:
    """Return `struct fb_fix_screeninfo`, laid out by hand as a 64-bit kernel does."""
    data = bytearray(80)
    struct.pack_into("@16s", data, 0, b"simulated")
    struct.pack_into("@I", data, 48, line_bytes)
    return bytes(data)


@pytest.fixture
def device(tmp_path: Path) -> Path:
    path = tmp_path / "fb0"
    path.write_bytes(os.urandom(1 << 20))
    return path


def panel_on(
    device: Path, variable: bytes, fixed: bytes, clock: VirtualClock | None = None
) -> FramebufferPanel:
    """Return a panel that finds these structures where the kernel would give them."""

    class OnFile(FramebufferPanel):
        def _infos(self, descriptor: int) -> tuple[bytes, bytes]:
            return variable, fixed

    return OnFile(f"{device},{device.parent}/event*", clock=clock or VirtualClock())


@pytest.mark.parametrize(
    ("bits", "channels"),
    [(16, RGB565), (24, RGB888), (32, RGB888), (32, ((0, 8), (8, 8), (16, 8)))],
)
def test_screen_is_drawn_in_the_format_of_the_display(
    device: Path, bits: int, channels: tuple[tuple[int, int], ...]
) -> None:
    columns, rows, line_bytes, top = 240, 240, 240 * 4 + 64, 2
    before = device.read_bytes()
    variable = variable_info(columns, rows, bits, channels, top)
    with panel_on(device, variable, fixed_info(line_bytes)) as panel:
        assert panel.size == (columns, rows)
        panel.show(SCREEN)
        data = device.read_bytes()
        wanted = draw(SCREEN, columns, rows).pixels
        for row, column in ((0, 0), (5, 17), (120, 60), (239, 239), (230, 12)):
            first = (row + top) * line_bytes + column * bits // 8
            value = int.from_bytes(data[first : first + bits // 8], "little")
            found = [(value >> start & (1 << size) - 1) << 8 - size for start, size in channels]
            mask = [256 - (1 << 8 - size) for _, size in channels]
            assert found == [int(v) & m for v, m in zip(wanted[row, column], mask, strict=True)]
        # What is beside the visible part of each line stays as it was.
        beside = np.frombuffer(data, np.uint8)[top * line_bytes :][: rows * line_bytes]
        was = np.frombuffer(before, np.uint8)[top * line_bytes :][: rows * line_bytes]
        padding = slice(columns * bits // 8, None)
        np.testing.assert_array_equal(
            beside.reshape(rows, -1)[:, padding], was.reshape(rows, -1)[:, padding]
        )
    assert device.read_bytes() == before, "the display shows again what it showed before"


@pytest.mark.parametrize(
    ("variable", "message"),
    [
        (variable_info(84, 48, 16, RGB565), "has only 84 x 48 pixels; the menu needs 96 x 16"),
        (variable_info(320, 240, 8, ((0, 8), (0, 8), (0, 8))), "has 8 bits a pixel"),
        (variable_info(320, 240, 16, ((11, 5), (5, 6), (0, 0))), "cannot draw"),
    ],
)
def test_display_that_cannot_be_drawn_on_is_refused(
    device: Path, variable: bytes, message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        panel_on(device, variable, fixed_info(640)).__enter__()


def test_device_that_is_no_frame_buffer_is_refused() -> None:
    with pytest.raises(UsageError, match="/dev/null is no frame buffer; use framebuffer:/dev/fb0"):
        FramebufferPanel("/dev/null").__enter__()


def test_device_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(CamctlError, match=r"cannot open .*: No such file or directory; connect"):
        FramebufferPanel(str(tmp_path / "fb0")).__enter__()


def test_device_without_permission_says_which_group(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> int:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(CamctlError, match="Permission denied; add the user to the group video"):
        FramebufferPanel(str(tmp_path / "fb0")).__enter__()


def test_input_devices_without_permission_are_shown_until_one_can_be_read(
    device: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    input_device = device.parent / "event0"
    os.mkfifo(input_device)
    is_denied, open_device = True, os.open

    def refuse(path: str, flags: int) -> int:
        if is_denied and path == str(input_device):
            raise PermissionError(13, "Permission denied")
        return open_device(path, flags)

    monkeypatch.setattr(os, "open", refuse)
    clock = VirtualClock()
    panel = panel_on(device, variable_info(240, 240, 32, RGB888), fixed_info(960), clock)
    texts: list[tuple[str, ...]] = []

    def drawn(screen: Screen, columns: int, rows: int) -> Drawing:
        texts.append((*screen.title.texts, *screen.paragraphs))
        return draw(screen, columns, rows)

    monkeypatch.setattr("camctl.menu.panels.pixels.draw", drawn)
    with panel:
        panel.show(SCREEN)
        assert panel.key(0) is None
        problem = f"cannot read {input_device}: Permission denied; "
        hint = "add the user to the group input, or run as root"
        assert texts == [("Ready",), ("No keys", problem + hint)]
        is_denied = False
        clock.sleep_until(10.0)
        assert panel.key(0) is None
        assert texts[2:] == [("Ready",)]


def event(kind: int, code: int, value: int) -> bytes:
    """Return a record of 24 bytes: two times of 8 bytes, two numbers of 2 bytes, one of 4."""
    return (
        bytes(16)
        + kind.to_bytes(2, "little")
        + code.to_bytes(2, "little")
        + struct.pack("<i", value)
    )


def test_keys_come_from_all_devices_and_survive_unplugging(tmp_path: Path) -> None:
    keys = InputKeys(f"{tmp_path}/event*")
    now_s = 0.0
    assert keys.key(0, now_s) is None
    first = tmp_path / "event0"
    os.mkfifo(first)
    now_s += 10
    assert keys.key(0, now_s) is None  # it is opened
    with first.open("wb", buffering=0) as writer:
        writer.write(event(1, 103, 1) + event(0, 0, 0) + event(1, 103, 0) + event(1, 28, 1)[:7])
        assert keys.key(1, now_s) is Key.UP
        assert keys.key(0, now_s) is None
        writer.write(event(1, 28, 1)[7:] + event(1, 30, 1) + event(1, 1, 1))
        assert [keys.key(1, now_s), keys.key(1, now_s)] == [Key.ENTER, Key.EXIT]
    assert keys.key(0, now_s) is None  # its other end is closed: it is gone
    first.unlink()
    os.mkfifo(first)
    now_s += 10
    assert keys.key(0, now_s) is None
    with first.open("wb", buffering=0) as writer:
        writer.write(event(1, 108, 1))
        assert keys.key(1, now_s) is Key.DOWN
    keys.close()


def test_key_that_is_held_selects_on_but_does_nothing_twice(tmp_path: Path) -> None:
    keys = InputKeys(f"{tmp_path}/event*")
    os.mkfifo(tmp_path / "event3")
    assert keys.key(0, 0.0) is None
    with (tmp_path / "event3").open("wb", buffering=0) as writer:
        writer.write(event(1, 28, 1) + event(1, 28, 2) * 3 + event(1, 108, 1) + event(1, 108, 2))
        found = [keys.key(0, 0.0) for _ in range(5)]
    assert found == [Key.ENTER, Key.DOWN, Key.DOWN, None, None]
    keys.close()
