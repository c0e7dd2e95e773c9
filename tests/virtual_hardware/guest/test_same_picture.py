"""The same picture by four roads: one scene, sensor, seed and list of exposures, one sum."""

import numpy as np
import pytest
import tifffile
import virtual_devices as rig

from camctl import read_report
from sim.camera import SimulatedCamera
from sim.scenes.scene import load_scene
from sim.sensors.sensor import load_sensor

# Largest and mean difference of a frame's sample that a JPEG of quality 95 of this scene may have.
JPEG_MOST, JPEG_MEAN = 6, 1.0


@pytest.fixture(scope="module")
def pure():
    """The sum of the in-process camera's frames, cut at a road's white as every sum is."""
    frames = {}

    def of(device, white):
        sensor = device.model["sensor"]
        if sensor not in frames:
            camera = SimulatedCamera(
                load_scene(device.model["scene"], shape=rig.SHAPE),
                load_sensor(sensor),
                seed=device.model["seed"],
                repeat_noise=True,
            )
            settings = [rig.setting(camera, time_s) for time_s in rig.EXPOSURES_S]
            frames[sensor] = [frame.pixels for frame in camera.shoot(settings)]
        return np.sum([np.minimum(each, np.uint32(white)) for each in frames[sensor]], axis=0)

    return of


def sum_by(camctl, device, **options):
    """Return the sum that a road gives, and its white."""
    if device.kind == "uvc":
        options["fps"] = "5"  # no exposure is longer than the interval between frames
    done = camctl("shoot", *rig.words_of(device, **options), *rig.BRACKET, "-o", device.name)
    assert done.status == 0, done.err
    report = read_report(rig.here() / device.name)
    assert [frame.applied_s for frame in report.frames] == pytest.approx(rig.EXPOSURES_S)
    return tifffile.imread(rig.here() / device.name / "sum.tiff"), report.white


@pytest.mark.parametrize(
    "device",
    [
        pytest.param(rig.WEB, id="v4l2-yuyv"),
        pytest.param(rig.MACHINE, id="v4l2-y16"),
        pytest.param(rig.STILL, id="ptp-tiff"),
        pytest.param(rig.RAW, id="ptp-dng"),
    ],
)
def test_bit_for_bit(hub, camctl, pure, device):
    total, white = sum_by(camctl, device)
    assert np.array_equal(total, pure(device, white))


def test_bit_for_bit_over_a_serial_line_coolpix(hub, camctl, pure):
    """A CoolPix's TIFF is RGB: three equal channels of a grey sensor."""
    total, white = sum_by(camctl, rig.COOLPIX)
    expected = pure(rig.COOLPIX, white)
    assert np.array_equal(total, np.repeat(expected[..., np.newaxis], 3, axis=2))


@pytest.mark.parametrize(
    ("device", "options"),
    [
        pytest.param(rig.WEB, {"format": "mjpg"}, id="v4l2-mjpg"),
        pytest.param(rig.SNAPSHOT, {}, id="ptp-jpeg"),
        pytest.param(rig.COOLPIX, {"format": "jpeg"}, id="coolpix-jpeg"),
    ],
)
def test_within_the_loss_of_jpeg(hub, camctl, pure, device, options):
    total, white = sum_by(camctl, device, **options)
    expected = pure(device, white).astype(np.int64)
    if total.ndim == 3:
        expected = expected[..., np.newaxis]
    difference = np.abs(total.astype(np.int64) - expected)
    assert difference.max() <= JPEG_MOST * len(rig.EXPOSURES_S)
    assert difference.mean() <= JPEG_MEAN * len(rig.EXPOSURES_S)
    assert difference.max() > 0  # else it is no JPEG, and the test above is the one to pass
