"""Cameras are found by names that survive replugging, and known by their serial numbers."""

import errno
import os
import time

import pytest
from v4l2_model import Model

from camctl.errors import CameraError
from drivers.v4l2.abi import Caps
from drivers.v4l2.backend import V4l2Backend
from drivers.v4l2.discovery import find_cameras, node_paths, stable_path

LINK = "usb-Maker_Cam_S1-video-index0"


class System:
    """Several nodes in a folder that stands for the root of a system."""

    def __init__(self, root):
        self.root = root
        self.models = {}
        for folder in ("dev/v4l/by-id", "sys/class/video4linux"):
            (root / folder).mkdir(parents=True)

    def add(self, number, model, link="", **attributes):
        node = self.root / f"dev/video{number}"
        node.touch()
        self.models[os.path.realpath(node)] = model
        if link:
            (self.root / "dev/v4l/by-id" / link).symlink_to(f"../../video{number}")
        usb = self.root / f"sys/devices/usb{number}/1-1"
        (usb / "1-1:1.0").mkdir(parents=True)
        entry = self.root / f"sys/class/video4linux/video{number}"
        entry.mkdir()
        (entry / "device").symlink_to(usb / "1-1:1.0")
        for name, value in attributes.items():
            (usb / name).write_text(value + "\n")

    # The kernel's side.

    def open(self, path):
        self.now = self.models[os.path.realpath(path)]
        return self.now.open(path)

    def ioctl(self, descriptor, request, argument):
        self.now.ioctl(descriptor, request, argument)

    def close(self, descriptor):
        self.now.close(descriptor)


@pytest.fixture
def system(tmp_path):
    return System(tmp_path)


def test_a_webcam_and_its_metadata_node(system):
    who = {"manufacturer": "Maker", "product": "Cam", "serial": "S1"}
    system.add(0, Model(), LINK, **who)
    system.add(1, Model(caps=Caps.STREAMING), "usb-Maker_Cam_S1-video-index1", **who)
    (camera,) = find_cameras(system.root, system)
    assert camera.id == f"v4l2:{system.root}/dev/v4l/by-id/{LINK}"
    assert (camera.make, camera.model, camera.serial) == ("Maker", "Cam", "S1")
    assert camera.driver == "v4l2"
    assert all(model.descriptors == 0 and not model.used for model in system.models.values())


def test_a_camera_without_link_and_serial_number(system):
    system.add(10, Model())
    system.add(9, Model())
    cameras = find_cameras(system.root, system)
    assert [camera.id for camera in cameras] == [
        f"v4l2:{system.root}/dev/video9",
        f"v4l2:{system.root}/dev/video10",
    ]
    assert (cameras[0].make, cameras[0].model, cameras[0].serial) == ("uvcvideo", "A webcam", "")


def test_the_stable_name_of_a_node(system):
    system.add(3, Model(), LINK)
    node = f"{system.root}/dev/video3"
    assert stable_path(node, system.root).endswith(LINK)
    assert stable_path("/dev/null", system.root) == "/dev/null"


def test_one_that_is_denied_does_not_hide_the_others(system):
    system.add(0, Model(first_error=errno.EACCES))
    with pytest.raises(CameraError, match="usermod -aG video"):
        find_cameras(system.root, system)
    system.add(1, Model())
    assert len(find_cameras(system.root, system)) == 1


def test_names_that_are_no_text(system):
    system.add(0, Model(), product="Cam\x1b[2J", serial="x" * 5000)
    (camera,) = find_cameras(system.root, system)
    assert camera.model == "Cam [2J"
    assert len(camera.serial) == 200


def test_no_camera_is_no_error_and_quick(tmp_path):
    began = time.perf_counter()
    assert node_paths(tmp_path) == []
    assert find_cameras(tmp_path) == []
    V4l2Backend().discover()
    assert time.perf_counter() - began < 0.2
