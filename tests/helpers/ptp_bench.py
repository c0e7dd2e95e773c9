"""A virtual PTP camera with our driver on it, in virtual time unless a clock is given."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from typing import Any

from virtual_usb_bus import VirtualBackend

from camctl.drivers.ptp.backend import PtpBackend
from camctl.drivers.ptp.camera import PtpCamera, PtpOptions
from camctl.interface.camera import Camera, Frame
from camctl.interface.controls import ExposureSetting
from camctl.sim.devices.clock import DeviceClock, VirtualDeviceClock
from camctl.sim.devices.common import VirtualSensor
from camctl.sim.devices.ptp.camera import PtpCamera as VirtualCamera
from camctl.sim.devices.ptp.config import PtpConfig
from camctl.sim.devices.ptp.device import PtpDevice
from camctl.sim.scenes.scene import load_scene
from camctl.sim.sensors.sensor import load_sensor

SHAPE = (24, 32)
# Of a transfer in virtual time; USB 2.0 cameras reach about this.
BYTES_PER_S = 40e6


@dataclass(frozen=True)
class Bench:
    """A virtual camera and the bus that it is plugged into."""

    device: VirtualCamera
    backend: VirtualBackend

    @property
    def usb_device(self) -> Any:
        """The camera as pyusb shows it to a host."""
        (found,) = PtpBackend(self.backend)._devices()
        return found

    def camera(self, **options: Any) -> PtpCamera:
        """Return our camera, opened with these options (linear response unless given)."""
        parsed = PtpOptions.parse({"response": "linear", **options})
        return PtpCamera(self.usb_device, parsed, clock=self.device.clock).open()


def in_force(device: PtpDevice) -> ExposureSetting:
    """Return the setting of the last exposure, as the virtual body has kept it."""
    exposure = device.state()["exposure"]
    return ExposureSetting(exposure["time_s"], exposure["gain"], exposure["f_number"])


def virtual_sensor(scene: str = "ramp", sensor: str = "ideal-8") -> VirtualSensor:
    """Return the sensor of the virtual cameras before a scene; it repeats its noise."""
    return VirtualSensor(load_scene(scene, SHAPE), load_sensor(sensor), seed=1, repeat_noise=True)


def bench(
    sensor: str = "ideal-8", scene: str = "ramp", clock: DeviceClock | None = None, **config: Any
) -> Bench:
    """Return a virtual camera with this configuration, plugged in."""
    if clock is not None:
        device = VirtualCamera(PtpConfig(**config), virtual_sensor(scene, sensor), clock)
        return Bench(device, VirtualBackend([device]))
    device = VirtualCamera(PtpConfig(**config), virtual_sensor(scene, sensor), VirtualDeviceClock())
    return Bench(device, VirtualBackend([device], bytes_per_s=BYTES_PER_S))


@contextmanager
def camera_on(
    sensor: str = "ideal-8",
    scene: str = "ramp",
    options: dict[str, Any] | None = None,
    **config: Any,
) -> Iterator[tuple[PtpCamera, VirtualCamera]]:
    """Yield (our camera, the virtual one) in virtual time."""
    pair = bench(sensor, scene, **config)
    with pair.camera(**(options or {})) as camera:
        yield camera, pair.device


def settings_at(camera: Camera, *times_s: float) -> list[ExposureSetting]:
    """Return settings that the camera has near these times."""
    gain = camera.controls.gain.nearest(1.0)
    return [ExposureSetting(camera.controls.time_s.nearest(t), gain) for t in times_s]


def shoot(camera: Camera, settings: list[ExposureSetting]) -> list[Frame]:
    """Return all frames of one sequence."""
    with closing(camera.shoot(settings)) as frames:
        return list(frames)


def operations(device: VirtualCamera) -> list[int]:
    """Return the codes of the operations that the camera was asked for."""
    return [int(str(entry["operation"]), 16) for entry in device.responder.log]
