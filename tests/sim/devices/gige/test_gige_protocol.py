"""The control protocol of the virtual GigE Vision camera, spoken by hand."""

from __future__ import annotations

import socket
import struct
import time
import xml.etree.ElementTree as ET
from collections.abc import Iterator

import pytest
from gige_bench import virtual_camera

from camctl.errors import CameraBusyError, UsageError
from camctl.sim.devices.gige.camera import GigeCamera, make
from camctl.sim.devices.gige.control import PORT, PRIVILEGE
from camctl.sim.devices.gige.features import BASE, SLOT

OK, WRITE_PROTECT, DENIED, INVALID = 0, 0x8004, 0x8006, 0x8002
READ, WRITE, READ_MEMORY, WRITE_MEMORY = 0x80, 0x82, 0x84, 0x86


class Client:
    """A controller that knows nothing but the packets."""

    def __init__(self, ip: str) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.settimeout(2.0)
        self.address = (ip, PORT)
        self.number = 0

    def ask(self, command: int, data: bytes) -> tuple[int, bytes]:
        self.number += 1
        head = struct.pack(">BBHHH", 0x42, 1, command, len(data), self.number)
        self.socket.sendto(head + data, self.address)
        reply = self.socket.recv(2048)
        status, answer, size, number = struct.unpack_from(">HHHH", reply)
        assert (answer, number) == (command + 1, self.number)
        assert len(reply) == 8 + size
        return status, reply[8:]

    def write(self, address: int, value: int) -> int:
        return self.ask(WRITE, struct.pack(">II", address, value))[0]

    def memory(self, address: int, size: int) -> bytes:
        status, data = self.ask(READ_MEMORY, struct.pack(">IHH", address, 0, size))
        assert status == OK
        return data[4:]


@pytest.fixture
def device() -> Iterator[GigeCamera]:
    with virtual_camera(refused=["GammaEnable"]) as device:
        yield device


@pytest.fixture
def client(device: GigeCamera) -> Iterator[Client]:
    made = Client(device.config.ip)
    yield made
    made.socket.close()


def address_of(device: GigeCamera, name: str) -> int:
    return BASE + SLOT * [each.name for each in device.features].index(name)


def test_discovery_and_description(device: GigeCamera, client: Client) -> None:
    status, data = client.ask(0x02, b"")
    assert (status, len(data)) == (OK, 0xF8)
    assert data[0xD8:0xE8].rstrip(b"\0").decode() == device.config.serial
    url = client.memory(0x200, 64).rstrip(b"\0").decode()
    _, place, size = url.split(";")
    text = b""
    while len(text) < int(size, 16):
        text += client.memory(int(place, 16) + len(text), 512)
    root = ET.fromstring(text[: int(size, 16)])
    names = {node.get("Name") for node in root}
    wanted = {"ExposureTime", "TriggerSoftware", "SequencerSetNext", "ChunkExposureTime"}
    assert wanted <= names
    used = {node.text for node in root.iter() if node.tag.endswith(("pValue", "pFeature"))}
    assert used <= names, "every node that is named exists"


def test_only_the_controller_writes(device: GigeCamera, client: Client) -> None:
    place = address_of(device, "ExposureAuto")
    assert client.write(place, 0) == DENIED
    assert client.write(PRIVILEGE, 2) == OK
    assert client.write(place, 0) == OK
    other = Client(device.config.ip)
    assert other.write(place, 2) == DENIED
    assert other.write(PRIVILEGE, 2) == DENIED
    other.socket.close()
    assert client.write(address_of(device, "GammaEnable"), 0) == WRITE_PROTECT
    assert client.write(place, 77) == INVALID
    assert client.write(PRIVILEGE, 0) == OK
    assert client.write(place, 0) == DENIED


def test_automatic_exposure_refuses_a_time(device: GigeCamera, client: Client) -> None:
    client.write(PRIVILEGE, 2)
    place = address_of(device, "ExposureTime")
    time_us = struct.pack(">I", place) + struct.pack(">d", 1234.4)
    assert client.ask(WRITE_MEMORY, time_us)[0] == DENIED
    client.write(address_of(device, "ExposureAuto"), 0)
    assert client.ask(WRITE_MEMORY, time_us)[0] == OK
    assert struct.unpack(">d", client.memory(place, 8)) == (1234.0,)


def test_silent_controller_loses_control(device: GigeCamera, client: Client) -> None:
    client.write(PRIVILEGE, 2)
    client.write(0x938, 100)  # ms
    assert device.state()["has_controller"]
    deadline_s = time.monotonic() + 5
    while device.state()["has_controller"] and time.monotonic() < deadline_s:
        time.sleep(0.02)
    assert not device.state()["has_controller"]


def test_one_camera_at_an_address(device: GigeCamera) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.99.0.1", PORT))
        with pytest.raises(CameraBusyError):
            make({"ip": "127.99.0.1", "size": "16x16"}).attach()
    with pytest.raises(UsageError):
        make({"ip": "10.0.0.1"})
