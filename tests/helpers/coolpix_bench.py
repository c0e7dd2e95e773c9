"""A virtual CoolPix with our driver on it, in virtual time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from typing import Any

import pytest
from error_lines import one_line

from camctl.drivers.coolpix.camera import CoolpixCamera, CoolpixOptions
from camctl.errors import CameraDisconnectedError
from camctl.interface.camera import Camera, Frame
from camctl.interface.controls import Choices, Control, ExposureSetting
from camctl.sim.devices.clock import DeviceClock, VirtualDeviceClock
from camctl.sim.devices.sierra.device import SierraDevice, make

SCENERY = {"scene": "ramp", "sensor": "standard", "seed": 3, "size": "32x24", "repeat_noise": True}
SETTINGS = [ExposureSetting(0.002), ExposureSetting(0.008)]


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
    own = {name: arguments.pop(name) for name in ("timeout_s",) if name in arguments}
    options = CoolpixOptions.parse({"format": "tiff", "response": "linear", **arguments})
    camera = CoolpixCamera(url or device.line.path, options, clock=device.clock, **own)
    return camera.open()


def shoot(camera: Camera, settings: Sequence[ExposureSetting] = SETTINGS) -> list[Frame]:
    with closing(camera.shoot(settings)) as frames:
        return list(frames)


def learn_format(camera: Camera) -> None:
    """Make the camera learn the format of its files, so that the next picture is a frame."""
    assert camera.controls.shape == (24, 32)


def check_unplugged(device: SierraDevice) -> None:
    """Unplug a camera at its second frame; check the error."""
    with coolpix_on(device) as camera:
        learn_format(camera)
        frames = camera.shoot(SETTINGS)
        next(frames)
        device.do("unplug")
        with pytest.raises(CameraDisconnectedError) as caught:
            next(frames)
    one_line(caught.value)


def do_once(camera: CoolpixCamera, method: str, argument: int, act: Callable[[], object]) -> None:
    """Call `act` just before the next call of `method` of the session with this argument."""
    sierra: Any = camera._body.sierra
    plain = getattr(sierra, method)

    def patched(first: int, *others: Any, **named: Any) -> Any:
        if first == argument:
            setattr(sierra, method, plain)
            act()
        return plain(first, *others, **named)

    setattr(sierra, method, patched)


def choices(control: Control | None) -> tuple[float, ...]:
    assert isinstance(control, Choices)
    return control.values


def data_of(frame: Frame) -> bytes:
    assert frame.original is not None
    return frame.original.data
