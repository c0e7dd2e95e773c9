"""Cameras are found by paths that stay the same after replugging, with their serial numbers."""

from __future__ import annotations

import ctypes
import errno
import os
from pathlib import Path

import pytest
from v4l2_model import Model

from camctl.drivers.v4l2.abi import Caps, Request
from camctl.drivers.v4l2.backend import find_cameras
from camctl.drivers.v4l2.kernel import Memory
from camctl.drivers.v4l2.system import node_paths, stable_path
from camctl.errors import CameraError

LINK = "usb-Maker_Cam_S1-video-index0"


class System:
    """Several nodes in a folder that takes the place of the root folder; a `Kernel` for them."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.models: dict[str, Model] = {}
        for folder in ("dev/v4l/by-id", "sys/class/video4linux"):
            (root / folder).mkdir(parents=True)

    def add(self, number: int, model: Model, link: str = "", **attributes: str) -> None:
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

    def open(self, path: str) -> int:
        self.opened = self.models[os.path.realpath(path)]
        return self.opened.open(path)

    def ioctl(self, descriptor: int, request: Request, argument: ctypes.Structure) -> None:
        self.opened.ioctl(descriptor, request, argument)

    def close(self, descriptor: int) -> None:
        self.opened.close(descriptor)

    def map(self, descriptor: int, offset: int, length: int) -> Memory:
        raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))

    def wait(self, descriptor: int, timeout_s: float) -> bool:
        return False


@pytest.fixture
def system(tmp_path: Path) -> System:
    return System(tmp_path)


def test_webcam_with_a_metadata_node_is_one_camera(system: System) -> None:
    usb = {"manufacturer": "Maker", "product": "Cam", "serial": "S1"}
    system.add(0, Model(), LINK, **usb)
    system.add(1, Model(caps=Caps.STREAMING), "usb-Maker_Cam_S1-video-index1", **usb)
    (camera,) = find_cameras(system.root, system)
    assert camera.id == f"v4l2:{system.root}/dev/v4l/by-id/{LINK}"
    assert (camera.make, camera.model, camera.serial) == ("Maker", "Cam", "S1")
    assert camera.driver == "v4l2"
    assert all(model.descriptors == 0 and not model.used for model in system.models.values())


def test_cameras_without_links_and_serial_numbers(system: System) -> None:
    system.add(10, Model())
    system.add(9, Model())
    cameras = find_cameras(system.root, system)
    assert [camera.id for camera in cameras] == [
        f"v4l2:{system.root}/dev/video9",
        f"v4l2:{system.root}/dev/video10",
    ]
    assert (cameras[0].make, cameras[0].model, cameras[0].serial) == ("uvcvideo", "A webcam", "")


def test_stable_path_of_a_node(system: System) -> None:
    system.add(3, Model(), LINK)
    node = f"{system.root}/dev/video3"
    assert stable_path(node, system.root) == f"{system.root}/dev/v4l/by-id/{LINK}"
    assert stable_path("/dev/null", system.root) == "/dev/null"


def test_camera_without_permission_does_not_hide_the_others(system: System) -> None:
    system.add(0, Model(first_error=errno.EACCES))
    with pytest.raises(CameraError, match="usermod -aG video"):
        find_cameras(system.root, system)
    system.add(1, Model())
    assert len(find_cameras(system.root, system)) == 1


def test_usb_attributes_are_made_printable_and_short(system: System) -> None:
    system.add(0, Model(), product="Cam\x1b[2J", serial="x" * 5000)
    (camera,) = find_cameras(system.root, system)
    assert camera.model == "Cam [2J"
    assert len(camera.serial) == 200


def test_no_nodes_are_no_cameras(tmp_path: Path) -> None:
    assert node_paths(tmp_path) == []
    assert find_cameras(tmp_path) == []
