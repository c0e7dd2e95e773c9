"""gphoto2, an independent client, on the same devices through the same kernel drivers."""

import io

import cv2
import gphoto2_client
import numpy as np
import pytest
import tifffile
import virtual_devices as rig

REASON = gphoto2_client.missing()
pytestmark = pytest.mark.skipif(REASON is not None, reason=REASON or "")


def test_a_picture_over_ptp(hub, tmp_path):
    port = gphoto2_client.usb_port(rig.usb_device(rig.SNAPSHOT))
    data = gphoto2_client.shoot_ptp(tmp_path, port, settings=[("shutterspeed", "0.0080s")])
    assert hub.do(rig.SNAPSHOT.name, "log")["shots"][-1]["time_s"] == pytest.approx(0.008)
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert picture.shape[:2] == rig.SHAPE
    assert 20 < picture.mean() < 80  # the ramp at 8 ms


def test_a_picture_over_a_serial_line_coolpix(hub, tmp_path):
    data = gphoto2_client.shoot_coolpix(tmp_path, rig.tty_node().resolve(), shutter_us=8000)
    assert hub.do(rig.COOLPIX.name, "log")["shots"][-1]["time_s"] == pytest.approx(0.008)
    if data[:2] == b"\xff\xd8":
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    else:
        picture = tifffile.imread(io.BytesIO(data))
    assert picture.shape[:2] == rig.SHAPE
    assert 20 < picture.mean() < 80
