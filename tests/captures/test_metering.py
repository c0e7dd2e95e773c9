"""Metering: the highlights end up just below saturation, from wherever it starts."""

import numpy as np
import pytest

from camctl.captures.metering import GLINTS, meter
from camctl.errors import CaptureError, UsageError


def uniform(value, shape=(40, 50)):
    return np.full(shape, value, np.float32)


@pytest.mark.parametrize("sensor", ["standard", "ideal-4", "phone", "machine-vision", "consumer"])
@pytest.mark.parametrize("brightness", [1e-3, 0.1, 1.0, 50.0, 2000.0])
def test_highlights_lie_just_below_white(make_camera, sensor, brightness):
    light = uniform(brightness)
    light[:20] *= 0.01
    # Lines so short that every time is on offer.
    with make_camera(sensor, light=light, line_s=1e-7, time_minimum_s=1e-7) as camera:
        metering = meter(camera)
        controls = camera.controls
        limit = controls.time_s.nearest(metering.limit_s)
        full = limit * controls.sensitivity * brightness
    # The aim is as sharp as the levels are, and ends with the longest exposure.
    assert full <= 1.0
    assert full >= 0.87 - 2 / controls.levels.M or limit == controls.time_s.maximum
    assert metering.clipped <= GLINTS


def test_the_fullest_channel_is_metered(make_camera):
    light = np.full((40, 50, 3), 0.05, np.float32)
    light[..., 2] = 1.0
    with make_camera(light=light, layout="rggb", line_s=1e-7, time_minimum_s=1e-7) as camera:
        blue = meter(camera).limit_s * camera.controls.sensitivity * 1.0
    assert 0.85 <= blue <= 1.0


def test_glints_are_let_go_and_reported(make_camera):
    light = uniform(0.1, (200, 300))
    light[0, :4] = 1e4
    with make_camera(light=light, line_s=1e-7, time_minimum_s=1e-7) as camera:
        metering = meter(camera)
        assert metering.limit_s * camera.controls.sensitivity * 0.1 > 0.8
    assert metering.clipped == pytest.approx(4 / 60_000)


def test_a_lens_cap_is_found(make_camera):
    with (
        make_camera(light=uniform(1e-12)) as camera,
        pytest.raises(CaptureError, match="take the lens cap off"),
    ):
        meter(camera)


def test_a_blown_scene_is_found(make_camera):
    with (
        make_camera(light=uniform(1e9)) as camera,
        pytest.raises(CaptureError, match="all is white even at 1e-05 s"),
    ):
        meter(camera)


class Mechanical:
    """A camera without a preview."""

    def __init__(self, camera):
        self._camera = camera
        self.shots = 0

    info = property(lambda self: self._camera.info)
    controls = property(lambda self: self._camera.controls)
    clock = property(lambda self: self._camera.clock)

    def shoot(self, settings):
        self.shots += len(settings)
        return self._camera.shoot(settings)

    def close(self):
        self._camera.close()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()


def test_a_mechanical_shutter_is_spent_only_on_request(make_camera):
    with Mechanical(make_camera()) as camera:
        with pytest.raises(UsageError, match="--meter"):
            meter(camera)
        assert camera.shots == 0
        metering = meter(camera, spend_shutter=True)
    assert metering.frames == camera.shots > 0
