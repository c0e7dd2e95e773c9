"""The panels for boards on the kernel's own devices; runs inside the guest.

The menu on the guest's frame buffer, worked with the guest's keyboard; then the DRM panel on the
same display (driver bochs).  The panel hd44780 writes to i2c-stub, which keeps what it was sent.

Lines for the host, which `display` obeys: "press KEY", and "picture NAME" for a picture of what the
display shows.  What it should show is in /guest_out/NAME.npy.
"""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import smbus2
from panel_fakes import CAMERA, READING, FakeJob

from camctl.menu.app import run
from camctl.menu.drawing import draw
from camctl.menu.layout import grid
from camctl.menu.model import Model, State
from camctl.menu.panels.drm import DrmPanel
from camctl.menu.panels.framebuffer import FramebufferPanel
from camctl.menu.panels.hd44780 import Hd44780Panel, encoded
from camctl.menu.ports import PanelDisconnectedError, Screen
from camctl.menu.screens import screen

OUT = Path("/guest_out")
MODULES = ("bochs", "evdev")
STEPS = (
    ("", "Ready"),
    ("ret", "Desired response"),
    ("down", "Desired response"),
    ("up", "Desired response"),
    ("ret", "Dynamic range"),
    ("ret", "Exposures"),
    ("ret", "Review"),
    ("ret", "Done"),
    ("esc", "Ready"),
    ("esc", "Quit the menu?"),
)
"""Keys, as QEMU names them, each with the title of the screen that it leads to."""
PICTURES = {"Ready": 0, "Desired response": 2, "Done": 7}
"""Titles of the screens that are compared, each after this step."""
NO_KEYS = "keys=/nowhere/event*"
SHOWN = screen(Model(state=State.IDLE, reading=READING, camera=CAMERA))
AT, OTHER = 0x27, 0x3F
TEXT, ENABLE = 0x09, 0x04
"""Outputs: register select and light; enable."""
SETTLED_S = 1.0
"""After this time the kernel has copied the memory of the frame buffer to the display."""


class Watched(FramebufferPanel):
    """Keeps the last screen, and counts the screens."""

    def __init__(self) -> None:
        super().__init__()
        self.changed = threading.Condition()
        self.last = Screen(title=None)  # type: ignore[arg-type]  # no screen yet
        self.shown = 0

    def show(self, screen: Screen) -> int:
        last_offset = super().show(screen)
        with self.changed:
            self.last, self.shown = screen, self.shown + 1
            self.changed.notify_all()
        return last_offset

    def wait_for(self, title: str, after: int) -> None:
        with self.changed:
            self.changed.wait_for(lambda: self.shown > after and title in self.last.title.texts[0])


def ask(words: str) -> None:
    """Ask the host for a key or for a picture of the display."""
    print(words, flush=True)


def take_picture(name: str, screen: Screen, size: tuple[int, int]) -> None:
    """Let the host take a picture, and compare it with what the display should show."""
    np.save(OUT / f"{name}.npy", draw(screen, *size).pixels)
    time.sleep(SETTLED_S)
    ask(f"picture {name}")
    while not (OUT / f"{name}.done").exists():
        time.sleep(0.2)


def work_the_menu() -> bool:
    """Take a capture with the keyboard; return whether it was taken."""
    for module in MODULES:
        subprocess.run(["modprobe", module], check=True)
    while not Path("/dev/fb0").exists() or not list(Path("/dev/input").glob("event*")):
        time.sleep(0.1)
    # The text console draws its cursor on the same frame buffer.
    for console in Path("/sys/class/vtconsole").glob("vtcon*"):
        if "frame buffer" in (console / "name").read_text():
            (console / "bind").write_text("0")
    job, panel = FakeJob(), Watched()
    menu = threading.Thread(target=run, args=(panel, lambda: job), daemon=True)
    menu.start()
    for step, (key, title) in enumerate(STEPS):
        before = panel.shown
        if key:
            ask(f"press {key}")
        panel.wait_for(title, before if key else 0)
        for name, wanted in PICTURES.items():
            if step == wanted:
                time.sleep(SETTLED_S)
                with panel.changed:  # nothing is drawn meanwhile
                    take_picture(name.split()[0].lower(), panel.last, panel.size)
    ask("press right")
    time.sleep(SETTLED_S)
    ask("press ret")
    menu.join()
    print(f"captures {len(job.shot)} on {panel_size()}", flush=True)
    return len(job.shot) == 1


def panel_size() -> str:
    """Return the size of the frame buffer, as the kernel states it."""
    return Path("/sys/class/graphics/fb0/virtual_size").read_text().strip()


def show_on_drm() -> None:
    """Show a screen on the display, twice."""
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
    is_taken = work_the_menu()
    show_on_drm()
    return int(not is_taken)


if __name__ == "__main__":
    sys.exit(main())
