"""gphoto2, an independent client, on the same devices through the same kernel drivers."""

import io
from pathlib import Path

import cv2
import gphoto2_client
import guest_processes as guest
import numpy as np
import pytest
import tifffile
import virtual_devices as rig

from camctl.interface.camera import Pixels

REASON = gphoto2_client.missing()
pytestmark = pytest.mark.skipif(REASON is not None, reason=REASON or "")


def decode(data: bytes) -> Pixels:
    """Return the picture of a JPEG or TIFF file."""
    if data[:2] == b"\xff\xd8":
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    else:
        picture = tifffile.imread(io.BytesIO(data))
    return np.asarray(picture, np.uint8)


def check_ramp_at_8_ms(picture: Pixels) -> None:
    assert picture.shape[:2] == rig.SHAPE
    assert 20 < picture.mean() < 80


def test_a_picture_over_ptp(hub: rig.RecordingHub, tmp_path: Path) -> None:
    port = gphoto2_client.usb_port(rig.usb_device(rig.SNAPSHOT))
    with guest.clock_in_step():  # gphoto2 reads a hundred libraries while cameras wait
        data = gphoto2_client.shoot_ptp(tmp_path, port, settings=[("shutterspeed", "0.0080s")])
    assert hub.do(rig.SNAPSHOT.name, "log")["shots"][-1]["time_s"] == pytest.approx(0.008)
    check_ramp_at_8_ms(decode(data))


@pytest.mark.proof  # computes for half a minute, to keep the clocks in step
def test_a_picture_over_a_serial_line(hub: rig.RecordingHub, tmp_path: Path) -> None:
    node = rig.serial_port().resolve()
    with guest.clock_in_step():
        data = gphoto2_client.shoot_coolpix(tmp_path, node, shutter_us=8000)
    assert hub.do(rig.COOLPIX.name, "log")["shots"][-1]["time_s"] == pytest.approx(0.008)
    check_ramp_at_8_ms(decode(data))
