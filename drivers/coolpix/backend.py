"""The backend `coolpix`: finds a CoolPix on serial ports, for the entry point `camctl.cameras`."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from contextlib import closing, suppress

from serial.tools import list_ports

from camctl.drivers.common.serial_link import SerialLink
from camctl.drivers.coolpix.camera import CoolpixCamera, CoolpixOptions, identity
from camctl.drivers.coolpix.sierra.packets import FIRST_SPEED
from camctl.drivers.coolpix.sierra.session import Sierra
from camctl.errors import CamctlError, UsageError
from camctl.interface.camera import CameraInfo
from camctl.interface.clock import RealClock

# All ports together have this long to answer, since listing cameras should take a second at most.
_PROBE_S = 0.9
# Time-out of one port; below the time for all, so that a camera found late is still listed.
_PORT_TIMEOUT_S = 0.6


class CoolpixBackend:
    """Opens ``coolpix:PORT``, where PORT is any pyserial URL; see `CoolpixOptions`."""

    about = "Nikon CoolPix 990 on a serial port, looked for on request; any pyserial URL opens"
    local_address = r"/dev/(tty|cu\.)[\w.-]+|/dev/serial/by-(id|path)/[\w.:+-]+|COM\d+"

    def discover(self, *, probe: bool = False) -> Sequence[CameraInfo]:
        """Return the cameras that answer on the machine's serial ports; none without `probe`."""
        return probe_lines(serial_ports(), _PROBE_S) if probe else ()

    def open(self, address: str, options: Mapping[str, str]) -> CoolpixCamera:
        parsed = CoolpixOptions.parse(options)
        if not address:
            raise UsageError(
                "a CoolPix needs its serial port",
                hint="give it, such as coolpix:/dev/ttyUSB0, or look for it",
                remedies={"probe_ports": None},
            )
        return CoolpixCamera(address, parsed).open()


def probe_lines(urls: Sequence[str], limit_s: float) -> list[CameraInfo]:
    """Return the cameras that answer on these lines within `limit_s`, all asked at once.

    A line is sent one NUL byte at 19,200 baud, and more only if a camera answers it.  Opening a
    port sets its modem signals once, and closing it resets them.
    """
    found: dict[str, CameraInfo | None] = {}
    changed = threading.Condition()

    def probe(url: str) -> None:
        info = None
        with suppress(CamctlError):
            info = _probe_line(url)
        with changed:
            found[url] = info
            changed.notify()

    for url in urls:
        threading.Thread(target=probe, args=(url,), daemon=True).start()
    with changed:
        changed.wait_for(lambda: len(found) == len(set(urls)), limit_s)
        answers = [found.get(url) for url in urls]
    return [info for info in answers if info is not None]


def _probe_line(url: str) -> CameraInfo | None:
    with closing(SerialLink(url, FIRST_SPEED)) as link:
        sierra = Sierra(link, RealClock(), speed=FIRST_SPEED, timeout_s=_PORT_TIMEOUT_S)
        if not sierra.answers():
            return None
        info = identity(sierra, url)
        sierra.close()
        return info


def serial_ports() -> list[str]:
    """Return the serial ports of the machine."""
    return sorted(port.device for port in list_ports.comports())
