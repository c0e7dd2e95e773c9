"""The radiance picture against the scene itself, in units of the predicted standard deviation."""

import numpy as np
import OpenEXR
import pytest

from camctl.captures.request import CaptureRequest
from camctl.captures.sequencer import capture
from camctl.exposure.effective import EffectiveCamera
from sim.camera import SimulatedCamera
from sim.scenes.scene import load_scene
from sim.sensors.sensor import load_sensor

LUMINANCE = np.float32([0.2126, 0.7152, 0.0722])


def errors(scene, sensor, request, directory):
    """Return |error| / predicted standard deviation over all samples in range."""
    with SimulatedCamera(scene, sensor) as camera:
        report = capture(camera, request, directory)
        effective = EffectiveCamera.of(
            camera.controls.levels, [frame.exposure for frame in report.frames]
        )
    with OpenEXR.File(str(directory / "radiance.exr"), separate_channels=True) as file:
        channels = {name: channel.pixels for name, channel in file.channels().items()}
    truth = scene.irradiance
    if scene.is_coloured and "Y" in channels:
        truth = truth @ LUMINANCE
    truth = np.atleast_3d(truth)
    full_scale = report.irradiance.full_scale_exposure
    gains = np.array([frame.applied.gain for frame in report.frames])
    found = []
    for index, name in enumerate("RGB" if "R" in channels else "Y"):
        E = truth[..., min(index, truth.shape[2] - 1)].astype(np.float64) * full_scale
        inside = (channels["mask." + name] == 0) & (1 / request.dynamic_range <= E) & (E < 1)
        predicted = effective.standard_deviation(
            E[inside],
            electrons_per_level=sensor.electrons_per_dn / gains,
            read_noise_levels=sensor.read_noise_e / sensor.electrons_per_dn * gains,
        )
        found.append(np.abs(channels[name][inside] * full_scale - E[inside]) / predicted)
    return np.concatenate(found)


@pytest.mark.parametrize("name", ["standard", "machine-vision"])
@pytest.mark.parametrize(
    ("response", "dynamic_range", "count"),
    [("log", 1000.0, 3), ("gamma", 1000.0, 3), ("linear", 256.0, 2)],
)
def test_errors_are_as_large_as_the_sensor_predicts(tmp_path, name, response, dynamic_range, count):
    scene = load_scene("tile-floor", (240, 320))
    request = CaptureRequest(response, dynamic_range, count)
    median = np.median(errors(scene, load_sensor(name), request, tmp_path / "out"))
    # A normal error has its median at 0.674 standard deviations, rounding alone at 0.866.
    assert 0.6 <= median <= 0.75


def test_the_church_agrees_with_its_radiance_map(tmp_path, real_data, capsys):
    scene = load_scene(real_data / "memorial" / "memorial.hdr")
    sensor = load_sensor("standard")
    found = errors(scene, sensor, CaptureRequest("log", 16000.0, 4), tmp_path / "out")
    with capsys.disabled():
        print(f"\nmemorial.hdr: median |error| / predicted {np.median(found):.3f}")
    assert 0.6 <= np.median(found) <= 0.75
