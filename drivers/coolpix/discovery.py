"""Looking for a CoolPix on the machine's serial ports, by asking what hangs there."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from contextlib import closing, suppress

from serial.tools import list_ports

from camctl.camera import CameraInfo
from camctl.errors import CamctlError
from drivers.common.serial_link import SerialLink
from drivers.coolpix.sierra.packets import FIRST_SPEED, RefusedCommandError, Register
from drivers.coolpix.sierra.session import Sierra

DRIVER = "coolpix"
_DEADLINE_S = 0.9
_TIMEOUT_S = 0.6


def describe(sierra: Sierra, url: str) -> CameraInfo:
    """Return who the camera in session is."""

    def words(register: Register) -> str:
        try:
            return sierra.text(register)
        except RefusedCommandError:
            return ""

    return CameraInfo(
        id=f"{DRIVER}:{url}",
        make=words(Register.MAKER) or "unknown",
        model=words(Register.MODEL) or "camera of the Sierra protocol",
        serial=words(Register.SERIAL_NUMBER),
        driver=DRIVER,
    )


def ask(urls: Sequence[str]) -> list[CameraInfo]:
    """Return the cameras that answer on these lines, all asked at once, within a second.

    A line is asked with one NUL byte at 19,200 baud, and only what answers as a camera does is
    sent more.  Opening a port raises its modem signals and closing it drops them, once.
    """
    found: dict[str, CameraInfo] = {}

    def ask_one(url: str) -> None:
        with suppress(CamctlError), closing(SerialLink(url, FIRST_SPEED)) as link:
            sierra = Sierra(link, speed=FIRST_SPEED, timeout_s=_TIMEOUT_S)
            if sierra.hears():
                found[url] = describe(sierra, url)
                sierra.close()

    threads = [threading.Thread(target=ask_one, args=(url,), daemon=True) for url in urls]
    for thread in threads:
        thread.start()
    deadline_s = time.monotonic() + _DEADLINE_S
    for thread in threads:
        thread.join(max(0.0, deadline_s - time.monotonic()))
    return [found[url] for url in urls if url in found]


def ports() -> list[str]:
    """Return the serial ports of the machine."""
    return sorted(port.device for port in list_ports.comports())
