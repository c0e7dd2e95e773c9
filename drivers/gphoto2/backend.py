"""The backend `gphoto2`, for the entry point `camctl.cameras`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import BaseModel, TypeAdapter

from camctl.drivers.common.usb import PTP_MAKES
from camctl.drivers.gphoto2.camera import DRIVER, Gphoto2Camera, Gphoto2Options
from camctl.drivers.gphoto2.process import CameraProcess, is_installed
from camctl.errors import CameraNotFoundError
from camctl.interface.camera import CameraInfo
from camctl.interface.clock import Clock, RealClock

#: How long listing the cameras may take, s; it takes 0.2 s where nothing hangs.
_LISTING_S = 10.0


class Listed(BaseModel):
    """A camera that libgphoto2 has found: its model, its port, and what can be done with it."""

    model: str
    port: str
    captures: bool
    configures: bool
    usb_vendor: int

    @property
    def remark(self) -> str:
        """Which backend to use for it, and why."""
        if not (self.captures and self.configures):
            return "libgphoto2 cannot take pictures with this model"
        make = PTP_MAKES.get(self.usb_vendor)
        if make is not None:
            return f"ptp: is the faster way to a {make}; this one is for models that ptp: refuses"
        return "the way to this make, whose operations ptp: does not know"


_LISTED = TypeAdapter(list[Listed])


class Gphoto2Backend:
    """Opens ``gphoto2:PORT``, or ``gphoto2`` if there is one camera; see `Gphoto2Options`."""

    about = "still cameras that libgphoto2 controls (pip install 'camctl[gphoto2]')"
    local_address = r"|usb:\d+,\d+"

    def discover(self, *, probe: bool = False) -> Sequence[CameraInfo]:
        """Return the cameras that libgphoto2 finds; none where its package is not installed."""
        if not is_installed():
            return []
        return [
            CameraInfo(f"{DRIVER}:{each.port}", "", each.model, "", DRIVER, each.remark)
            for each in _listed(RealClock())
        ]

    def open(self, address: str, options: Mapping[str, Any]) -> Gphoto2Camera:
        parsed = Gphoto2Options.parse(options)
        return Gphoto2Camera(address or _only_port(), parsed).open()


def _listed(clock: Clock) -> list[Listed]:
    with CameraProcess("libgphoto2", clock) as process:
        found = _LISTED.validate_python(process.ask("cameras", silence_s=_LISTING_S))
    return [each for each in found if not each.port.startswith("disk:")]


def _only_port() -> str:
    found = [each for each in _listed(RealClock()) if each.captures]
    if len(found) == 1:
        return found[0].port
    ids = ", ".join(f"{DRIVER}:{each.port}" for each in found)
    raise CameraNotFoundError(
        f"{len(found) or 'no'} cameras for gphoto2 are connected",
        hint=f"name one of them: {ids}" if ids else "plug one in and switch it on",
    )
