"""A virtual PTP camera and our driver on it, for several test modules."""

from contextlib import contextmanager

from camctl.controls import ExposureSetting
from drivers.ptp.backend import PtpBackend
from drivers.ptp.camera import PtpCamera
from sim.devices.common import VirtualSensor
from sim.devices.ptp.camera import PtpCamera as VirtualCamera
from sim.devices.ptp.config import PtpConfig
from sim.devices.usb.backend import VirtualBackend
from sim.scenes.scene import load_scene
from sim.sensors.sensor import load_sensor

SHAPE = (24, 32)
SILENCE_S = 0.5


def exposer(scene="ramp", sensor="ideal-8"):
    return VirtualSensor(load_scene(scene, SHAPE), load_sensor(sensor), seed=1, repeat_noise=True)


def virtual(sensor="ideal-8", scene="ramp", **config):
    """Return a virtual camera and the backend it is plugged into."""
    device = VirtualCamera(PtpConfig(**config), exposer(scene, sensor))
    return device, VirtualBackend([device])


def usb_device(backend):
    (device,) = PtpBackend(backend)._devices()
    return device


def open_quick(backend, **options):
    """Return our camera with time-outs that fit a test."""
    return PtpCamera(
        usb_device(backend),
        **{"silence_s": SILENCE_S, "capture_s": 1.0, "response": "linear", **options},
    )


@contextmanager
def camera_on(sensor="ideal-8", scene="ramp", options=None, **config):
    """Yield (our camera, the virtual one)."""
    device, backend = virtual(sensor, scene, **config)
    with open_quick(backend, **(options or {})) as camera:
        yield camera, device


def settings_at(camera, *times_s):
    """Return settings that the camera has near these times."""
    gain = camera.controls.gain.nearest(1.0)
    return [ExposureSetting(camera.controls.time_s.nearest(t), gain) for t in times_s]
