"""The same picture by every backend: one scene, sensor, seed and list of exposures, one sum."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import guest_processes as guest
import numpy as np
import pytest
import tifffile
import virtual_devices as rig
from numpy.typing import NDArray

from camctl import read_report
from camctl.sim.camera import SimulatedCamera
from camctl.sim.scenes.scene import load_scene
from camctl.sim.sensors.sensor import load_sensor

# Largest and mean difference of a frame's sample that a JPEG of quality 95 of this scene may have.
JPEG_MOST, JPEG_MEAN = 6, 1.0

RunCamctl = Callable[..., guest.CommandResult]
Sum = NDArray[Any]
ExpectedSum = Callable[[rig.Device, int], Sum]


@pytest.fixture(scope="module")
def expected_sum() -> ExpectedSum:
    """The sum of the simulated camera's frames, clipped at the white level as every sum is."""
    frames: dict[str, list[Sum]] = {}

    def of(device: rig.Device, white: int) -> Sum:
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
        total: Sum = np.sum([np.minimum(each, np.uint32(white)) for each in frames[sensor]], axis=0)
        return total

    return of


def shoot(
    camctl: RunCamctl, device: rig.Device, suffix: str = "", **options: str
) -> tuple[Sum, int]:
    """Return the sum of a capture by a device's backend, and its white level.

    `suffix` is that of the camera's own files, of a still camera.
    """
    if device.kind == "uvc":
        options["fps"] = "5"  # no exposure is longer than the interval between frames
    arguments = rig.camera_arguments(device, **options)
    done = camctl("shoot", *arguments, *rig.BRACKET, "-o", device.name)
    assert done.status == 0, done.err
    frames = rig.completed_frames(device.name)
    assert [frame.applied_s for frame in frames] == pytest.approx(rig.EXPOSURES_S)
    report = read_report(Path(device.name))
    assert not rig.distrust_warnings(report)
    if device.kind != "uvc":  # the camera's own files are kept beside the frames
        originals = [Path(device.name, str(frame.original)) for frame in frames]
        assert {each.suffix.lower() for each in originals} == {suffix}
        assert all(each.is_file() for each in originals)
    total = np.asarray(tifffile.imread(Path(device.name, "sum.tiff")))
    return total, report.white


@pytest.mark.parametrize(
    ("device", "suffix"),
    [
        pytest.param(rig.WEB, "", id="v4l2-yuyv"),
        pytest.param(rig.MACHINE, "", id="v4l2-y16"),
        pytest.param(rig.STILL, ".tif", id="ptp-tiff"),
        pytest.param(rig.RAW, ".dng", id="ptp-dng"),
    ],
)
def test_bit_for_bit(
    hub: rig.RecordingHub,
    camctl: RunCamctl,
    expected_sum: ExpectedSum,
    device: rig.Device,
    suffix: str,
) -> None:
    total, white = shoot(camctl, device, suffix)
    assert np.array_equal(total, expected_sum(device, white))
    if device.kind == "ptp":
        assert len(hub.do(device.name, "log")["shots"]) >= 3


def test_bit_for_bit_over_a_serial_line_coolpix(
    hub: rig.RecordingHub, camctl: RunCamctl, expected_sum: ExpectedSum
) -> None:
    """A CoolPix's TIFF is RGB: three equal channels of a grey sensor."""
    total, white = shoot(camctl, rig.COOLPIX, ".tif")
    expected = expected_sum(rig.COOLPIX, white)
    assert np.array_equal(total, np.repeat(expected[..., np.newaxis], 3, axis=2))


@pytest.mark.parametrize(
    ("device", "options"),
    [
        pytest.param(rig.WEB, {"format": "mjpg"}, id="v4l2-mjpg"),
        pytest.param(rig.SNAPSHOT, {"suffix": ".jpg"}, id="ptp-jpeg"),
        pytest.param(
            *(rig.COOLPIX, {"suffix": ".jpg", "format": "jpeg"}),
            id="coolpix-jpeg",
            marks=pytest.mark.proof,
        ),
    ],
)
def test_within_the_loss_of_jpeg(
    hub: rig.RecordingHub,
    camctl: RunCamctl,
    expected_sum: ExpectedSum,
    device: rig.Device,
    options: dict[str, str],
) -> None:
    total, white = shoot(camctl, device, **options)
    expected = expected_sum(device, white).astype(np.int64)
    if total.ndim == 3:
        expected = expected[..., np.newaxis]
    difference = np.abs(total.astype(np.int64) - expected)
    assert difference.max() <= JPEG_MOST * len(rig.EXPOSURES_S)
    assert difference.mean() <= JPEG_MEAN * len(rig.EXPOSURES_S)
    assert difference.max() > 0  # else the file is lossless, and the test above should pass
