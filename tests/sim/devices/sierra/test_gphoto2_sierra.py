"""gphoto2's Sierra driver takes pictures with the virtual CoolPix 990 on a pseudo-terminal."""

import io

import gphoto2_client
import numpy as np
import pytest
import tifffile

from sim.devices.sierra import device as sierra

REASON = gphoto2_client.missing_for_pty()
pytestmark = pytest.mark.skipif(REASON is not None, reason=REASON or "")


@pytest.fixture
def camera():
    device = sierra.make(
        {"scene": "ramp", "sensor": "ideal-8", "size": "64x48", "repeat_noise": True}
    )
    device.attach()
    yield device
    device.detach()


@pytest.fixture
def preload(tmp_path):
    return gphoto2_client.modem_lines(tmp_path)


def test_what_it_says_of_the_camera(camera, preload, tmp_path):
    words = gphoto2_client.coolpix_words(camera.line.path)
    said = gphoto2_client.gphoto2(*words, "--summary", folder=tmp_path, preload=preload)
    assert "Camera Model: E990" in said
    assert "Serial Number: CP990001" in said
    assert "Error" not in said


@pytest.mark.parametrize("speed", [19200, 115200])
def test_a_picture_with_the_exposure_that_was_set(camera, preload, tmp_path, speed):
    camera.camera.write(1, 0x23)  # TIFF: the sensor's own numbers
    data = gphoto2_client.shoot_coolpix(
        tmp_path, camera.line.path, shutter_us=8000, speed=speed, preload=preload
    )
    picture = tifffile.imread(io.BytesIO(data))
    assert np.array_equal(picture[..., 0], camera.body.exposer.expose(0.008))
    assert camera.do("state")["shutter_us"] == 8000
    assert camera.do("state")["pictures"] == 0  # it deletes what it has downloaded


def test_a_jpeg(camera, preload, tmp_path):
    data = gphoto2_client.shoot_coolpix(tmp_path, camera.line.path, preload=preload)
    assert data[:2] == b"\xff\xd8"
