"""What all roads share: the list of cameras, and permissions."""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
import virtual_devices as rig

NOBODY = 65534


def node_of(camera_id):
    """Return an id with a node's link followed: two links may lead to one serial port."""
    road, _, address = camera_id.partition(":")
    return f"{road}:{os.path.realpath(address) if address.startswith('/') else address}"


def test_the_list_names_all_roads(hub, camctl):
    listed = camctl("cameras", "--probe", "--json")
    assert listed.status == 0, listed.err
    cameras = {node_of(camera["id"]): camera for camera in json.loads(listed.out)}
    for device in rig.DEVICES:
        camera = cameras[node_of(rig.camera_id(device))]
        assert camera["model"]
        assert camera["driver"]
        if device.kind != "sierra":
            assert camera["serial"] == device.serial
    assert {camera["driver"] for camera in cameras.values()} >= {"v4l2", "ptp", "coolpix", "sim"}


def test_without_probing_no_serial_port_is_spoken_to(hub, camctl):
    before = hub.do(rig.COOLPIX.name, "state")
    listed = camctl("cameras", "--json")
    assert listed.status == 0, listed.err
    assert "coolpix" not in {camera["driver"] for camera in json.loads(listed.out)}
    assert hub.do(rig.COOLPIX.name, "state") == before


@pytest.fixture(scope="module")
def readable():
    """Ordinary users may read what Python needs; in the guest that lasts as long as the guest."""
    for place in (sys.prefix, sys.base_prefix, Path(__file__)):
        for folder in Path(place).resolve().parents:
            folder.chmod(folder.stat().st_mode | 0o555)
    Path(sys.prefix).chmod(0o755)


@pytest.mark.parametrize("device", [rig.SPARE, rig.STILL, rig.COOLPIX], ids=lambda d: d.name)
def test_no_permission(hub, readable, device):
    """An ordinary user who may not open the device is told what to do."""
    with tempfile.TemporaryDirectory(dir="/dev/shm") as folder:
        Path(folder).chmod(0o777)
        ran = subprocess.run(
            [Path(sys.executable).with_name("camctl"), "shoot", *rig.words_of(device), "-o", "x"],
            cwd=folder,
            env={**os.environ, "HOME": folder, "CAMCTL_PROFILES": f"{folder}/profiles"},
            user=NOBODY,
            group=NOBODY,
            extra_groups=[],
            capture_output=True,
            text=True,
            timeout=60,
        )
    assert ran.returncode == 1, ran.stderr
    assert ran.stderr.count("\n") == 1, ran.stderr
    assert "permission" in ran.stderr or "not allowed" in ran.stderr
    assert any(word in ran.stderr for word in ("udev", "group", "usermod"))
