"""The picture that a calibrated virtual webcam promises, and the one that it makes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import guest_processes as guest
import numpy as np
import virtual_devices as rig

from camctl import CaptureReport, read_report
from camctl.sim.camera import SimulatedCamera
from camctl.sim.scenes.scene import load_scene
from camctl.sim.sensors.sensor import Sensor
from camctl.studies.scene_errors import scene_truth

#: Light, of what saturates the shortest exposure, up to which columns of the ramp are compared.
_COMPARED = 0.98


@dataclass(frozen=True)
class LinearPicture:
    """A picture in linear brightness by a webcam that states nothing of its response.

    Attributes:
        columns: number of columns of the ramp that are compared
        error: largest difference of a column's mean from the promised brightness, full scale = 1
        effective_levels: of the capture, as its report says
    """

    columns: int
    error: float
    effective_levels: float


def calibrate_and_shoot(
    device: rig.Device, camctl: Callable[..., guest.CommandResult], calibration: str
) -> LinearPicture:
    """Calibrate `rig.CURVED`, or one like it, shoot three exposures, and compare with the ramp.

    Args:
        device: the webcam, before the ramp
        camctl: runs a command line
        calibration: what `camctl calibrate` measures before: all, or response
    """
    arguments = rig.camera_arguments(device)
    done = camctl("calibrate", calibration, *arguments, "--json")
    assert done.status == 0, done.err
    done = camctl("shoot", *arguments, "--response", "linear", "-n", "3", "-o", "linear")
    assert done.status == 0, done.err
    assert "using the profile" in done.err
    report = read_report(Path("linear"))
    assert isinstance(report, CaptureReport)
    assert report.achieved is not None
    picture = report.image() / 65535
    scene = load_scene(device.model["scene"], shape=(picture.shape[0], picture.shape[1]))
    with SimulatedCamera(scene, Sensor.model_validate(rig.CURVED_SENSOR)) as camera:
        light = scene_truth(camera) * min(frame.applied.exposure for frame in report.frames)
    promised = report.plan.desired.u(np.clip(light, 0, 1)).mean(axis=0)
    inside = light.mean(axis=0) < _COMPARED
    error = np.abs(picture.mean(axis=0) - promised)[inside]
    return LinearPicture(int(inside.sum()), float(error.max()), report.achieved.effective_levels)
