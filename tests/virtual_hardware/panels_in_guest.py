"""The panels for boards on the kernel's own devices; runs inside the guest.

The DRM panel works on the display of QEMU (driver bochs), and the host compares pictures of it, as
in `display_in_guest`.  The panel hd44780 writes to i2c-stub, which keeps what it was sent.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import smbus2
from display_in_guest import take_picture
from panel_fakes import CAMERA, READING

from camctl.menu.layout import grid
from camctl.menu.model import Model, State
from camctl.menu.panels.drm import DrmPanel
from camctl.menu.panels.hd44780 import Hd44780Panel, encoded
from camctl.menu.ports import PanelDisconnectedError
from camctl.menu.screens import screen

NO_KEYS = "keys=/nowhere/event*"
SHOWN = screen(Model(state=State.IDLE, reading=READING, camera=CAMERA))
AT, OTHER = 0x27, 0x3F
TEXT, ENABLE = 0x09, 0x04
"""Outputs: register select and light; enable."""


def show_on_drm() -> None:
    """Show a screen on the display, twice."""
    subprocess.run(["modprobe", "bochs"], check=True)
    for name in ("drm-first", "drm-second"):  # the first one must release the display
        with DrmPanel(f"/dev/dri/card0,{NO_KEYS}") as panel:
            panel.show(SHOWN)
            take_picture(name, SHOWN, panel.size)
    driver = Path("/sys/class/drm/card0/device/driver").resolve().name
    print(f"drm: driver {driver}", flush=True)


def write_to_i2c() -> None:
    """Show a screen on i2c-stub; an address without a chip is one line."""
    subprocess.run(["modprobe", "i2c-dev"], check=True)
    subprocess.run(["modprobe", "i2c-stub", f"chip_addr={AT:#x}"], check=True)
    (name,) = [
        each
        for each in Path("/sys/class/i2c-dev").iterdir()
        if "stub" in (each / "name").read_text()
    ]
    bus = f"/dev/{name.name}"
    with Hd44780Panel(f"{bus},at={AT:#x},{NO_KEYS}") as panel:
        panel.show(SHOWN)
        panel._check()
        # The stub takes the first byte of a block for a register, and the others for what follows.
        # Text is sent in blocks of 33 bytes, each character in four; the first byte is its first.
        first = encoded(grid(SHOWN, 16, 2).lines[-1])[0]
        upper, lower = first & 0xF0, first << 4 & 0xF0
        with smbus2.SMBus(bus) as stub:
            kept = stub.read_i2c_block_data(AT, upper | TEXT | ENABLE, 3)
        assert kept == [upper | TEXT, lower | TEXT | ENABLE, lower | TEXT], (kept, first)
    try:
        with Hd44780Panel(f"{bus},at={OTHER:#x},{NO_KEYS}"):
            raise AssertionError("no chip is there")
    except PanelDisconnectedError as error:
        print(f"i2c: {error}", flush=True)


def main() -> int:
    """Return the exit status."""
    write_to_i2c()
    show_on_drm()
    return 0


if __name__ == "__main__":
    sys.exit(main())
