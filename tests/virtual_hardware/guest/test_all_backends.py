"""What all backends share: the list of cameras, and permissions."""

from __future__ import annotations

import json
import os
import re
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import guest_processes as guest
import pytest
import virtual_devices as rig

RunCamctl = Callable[..., guest.CommandResult]


def with_real_path(camera_id: str) -> str:
    """Return an id with links resolved: two links may lead to one serial port."""
    backend, _, address = camera_id.partition(":")
    return f"{backend}:{os.path.realpath(address) if address.startswith('/') else address}"


def test_the_list_names_the_cameras_of_all_backends(
    hub: rig.RecordingHub, camctl: RunCamctl
) -> None:
    listed = camctl("cameras", "--probe", "--json")
    assert listed.status == 0, listed.err
    cameras = {with_real_path(camera["id"]): camera for camera in json.loads(listed.out)["cameras"]}
    for device in rig.DEVICES:
        camera = cameras[with_real_path(rig.camera_id(device))]
        assert camera["model"]
        assert camera["driver"]
        if device.kind != "sierra":
            assert camera["serial"] == device.serial
    assert {camera["driver"] for camera in cameras.values()} >= {"v4l2", "ptp", "coolpix", "sim"}


def test_without_probing_nothing_is_sent_to_serial_ports(
    hub: rig.RecordingHub, camctl: RunCamctl
) -> None:
    before = hub.do(rig.COOLPIX.name, "state")
    listed = camctl("cameras", "--json")
    assert listed.status == 0, listed.err
    assert "coolpix" not in {camera["driver"] for camera in json.loads(listed.out)["cameras"]}
    assert hub.do(rig.COOLPIX.name, "state") == before


@pytest.fixture(scope="module")
def readable() -> None:
    """Let ordinary users read what Python needs; it lasts as long as the guest."""
    for place in (sys.prefix, sys.base_prefix, Path(__file__)):
        for folder in Path(place).resolve().parents:
            folder.chmod(folder.stat().st_mode | 0o555)
    Path(sys.prefix).chmod(0o755)


@pytest.fixture
def folder_for_all() -> Iterator[Path]:
    """A folder that every user may write to."""
    with tempfile.TemporaryDirectory(dir="/dev/shm") as folder:
        Path(folder).chmod(0o777)
        yield Path(folder)


@pytest.mark.parametrize(
    ("device", "message"),
    [
        pytest.param(
            rig.WEB,
            r"cannot open /dev/v4l/by-id/\S+: you are not allowed to use it; join its group "
            r"\(sudo usermod -aG video \$USER, then log in again\) or add a udev rule: "
            r'SUBSYSTEM=="video4linux", TAG\+="uaccess"',
            id="v4l2",
        ),
        pytest.param(
            rig.STILL,
            r"Virtual PTP camera at USB \d+:\d+ cannot be opened: no permission; install the udev "
            r"rules, then plug it in again \(camctl cameras --udev-rules \| sudo tee "
            r"/etc/udev/rules\.d/70-camctl\.rules && sudo udevadm control --reload\)",
            id="ptp",
        ),
        pytest.param(
            rig.COOLPIX,
            r"cannot open /dev/serial/by-id/\S+: no permission to use it; run: sudo usermod -aG "
            r"dialout \$USER, then log in again",
            id="coolpix",
        ),
    ],
)
def test_no_permission(
    hub: rig.RecordingHub, readable: None, folder_for_all: Path, device: rig.Device, message: str
) -> None:
    arguments = rig.camera_arguments(device)
    done = guest.camctl_as_nobody(folder_for_all, "shoot", *arguments, "-o", "x")
    assert re.fullmatch(message, done.error), done.error
