"""A virtual CoolPix with our driver on it, in virtual time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from drivers.coolpix.camera import CoolpixCamera, CoolpixOptions
from sim.devices.clock import DeviceClock, VirtualDeviceClock
from sim.devices.sierra.device import SierraDevice, make

SCENERY = {"scene": "ramp", "sensor": "standard", "seed": 3, "size": "32x24", "repeat_noise": True}


@contextmanager
def virtual_coolpix(clock: DeviceClock | None = None, **config: Any) -> Iterator[SierraDevice]:
    """Yield a camera at a line in this process, in virtual time unless a clock is given."""
    own = {"name": "coolpix", "kind": "sierra", "line": "memory", **SCENERY, **config}
    device = make(own, clock if clock is not None else VirtualDeviceClock())
    device.attach()
    try:
        yield device
    finally:
        device.detach()


def coolpix_on(device: SierraDevice, url: str | None = None, **arguments: Any) -> CoolpixCamera:
    """Return our camera, opened; linear TIFF unless options say otherwise.

    Arguments that are not of `CoolpixCamera` itself are options.
    """
    own = {name: arguments.pop(name) for name in ("progress", "timeout_s") if name in arguments}
    options = CoolpixOptions.parse({"format": "tiff", "response": "linear", **arguments})
    camera = CoolpixCamera(url or device.line.path, options, clock=device.clock, **own)
    return camera.open()
