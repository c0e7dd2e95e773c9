"""The Nikon CoolPix 990 on a serial line, as a camera: what it can set, and frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from camctl.camera import CameraInfo
from camctl.errors import CameraNotFoundError, unknown_name
from drivers.coolpix.camera import _OPTIONS, CoolpixCamera, _speed
from drivers.coolpix.discovery import ask, ports


class CoolpixBackend:
    """Opens ``coolpix:PORT``; options: format (jpeg, tiff), speed (baud), response."""

    about = "Nikon CoolPix 990 on a serial port, looked for with --probe; any pyserial URL opens"

    def discover(self, *, probe: bool = False) -> Sequence[CameraInfo]:
        """Return the cameras that answer on the machine's serial ports; none without `probe`."""
        return ask(ports()) if probe else ()

    def open(self, address: str, options: Mapping[str, str]) -> CoolpixCamera:
        """Open the camera on the port or URL `address`.

        Raises:
            UsageError: an unknown option or value
            CameraError: as `CoolpixCamera`
        """
        for option in options:
            if option not in _OPTIONS:
                raise unknown_name("option of the CoolPix", option, _OPTIONS)
        if not address:
            raise CameraNotFoundError(
                "a CoolPix needs its serial port",
                hint="give it, such as coolpix:/dev/ttyUSB0; camctl cameras --probe looks for it",
            )
        return CoolpixCamera(
            address,
            format=options.get("format", "jpeg").lower(),
            speed=_speed(options.get("speed", "115200")),
            response=options.get("response", "srgb").lower(),
        )
