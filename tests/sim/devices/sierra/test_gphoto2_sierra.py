"""gphoto2's Sierra driver takes pictures with the virtual CoolPix 990 on a pseudo-terminal."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path

import gphoto2_client
import numpy as np
import pytest
import tifffile

from camctl.sim.devices.sierra import device as sierra

REASON = gphoto2_client.missing_for_pty()
pytestmark = pytest.mark.skipif(REASON is not None, reason=REASON or "")

# gphoto2 may be stopped for so long on a busy machine without losing its session.
SILENCE_S = 60.0


@pytest.fixture
def camera() -> Iterator[sierra.SierraDevice]:
    device = sierra.make(
        {
            "scene": "ramp",
            "sensor": "ideal-8",
            "size": "64x48",
            "repeat_noise": True,
            "silence_s": SILENCE_S,
        }
    )
    device.attach()
    yield device
    device.detach()


@pytest.fixture
def preload(tmp_path: Path) -> Path:
    return gphoto2_client.modem_lines(tmp_path)


def test_gphoto2_identifies_the_camera(
    camera: sierra.SierraDevice, preload: Path, tmp_path: Path
) -> None:
    arguments = gphoto2_client.coolpix_arguments(camera.line.path)
    output = gphoto2_client.gphoto2(*arguments, "--summary", folder=tmp_path, preload=preload)
    assert "Camera Model: E990" in output
    assert "Serial Number: CP990001" in output
    assert "Error" not in output


@pytest.mark.slow
@pytest.mark.parametrize("speed", [19200, 115200])
def test_gphoto2_takes_a_picture_with_the_exposure_it_set(
    camera: sierra.SierraDevice, preload: Path, tmp_path: Path, speed: int
) -> None:
    camera.camera.write(1, 0x23)  # TIFF: the sensor's digital numbers
    data = gphoto2_client.shoot_coolpix(
        tmp_path, camera.line.path, shutter_us=8000, speed=speed, preload=preload
    )
    picture = tifffile.imread(io.BytesIO(data))
    assert np.array_equal(picture[..., 0], camera.body.sensor.expose(0.008))
    assert camera.do("state")["shutter_us"] == 8000
    assert camera.do("state")["pictures"] == 0  # gphoto2 deletes what it has downloaded


@pytest.mark.slow
def test_gphoto2_takes_a_jpeg(camera: sierra.SierraDevice, preload: Path, tmp_path: Path) -> None:
    data = gphoto2_client.shoot_coolpix(tmp_path, camera.line.path, preload=preload)
    assert data[:2] == b"\xff\xd8"
