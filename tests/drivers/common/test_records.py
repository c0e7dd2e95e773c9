"""Recordings of cameras: nothing private is in them, and they open as the camera did.

Files that owners have sent lie in `tests/drivers/records`: each is opened again here.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
from ptp_bench import bench
from replayed_records import NodeReplay, ReplayedCamera
from v4l2_model import Model

from camctl.drivers.ptp import recording as ptp
from camctl.drivers.ptp.codes import Op
from camctl.drivers.ptp.transport import DATA, EVENT, Container
from camctl.drivers.v4l2 import recording as v4l2
from camctl.drivers.v4l2.node import Node
from camctl.errors import CameraError
from camctl.interface.clock import VirtualClock

SENT = sorted((Path(__file__).parent.parent / "records").glob("*.json"))
pytestmark = pytest.mark.usefixtures("own_profiles")


def replayed(record: dict[str, Any]) -> dict[str, Any]:
    """Return what a recorded camera is found to be, when its answers are given again."""
    if "calls" in record:
        with Node("/dev/video0", NodeReplay(record["calls"])) as node:
            return v4l2.described(node)
    camera = ReplayedCamera(record)
    try:
        with camera:
            found = {"model": camera.info.model, "times_s": ptp.times_of(camera)}
    except CameraError as error:
        return {"error": str(error)}
    assert not camera.replay.unknown
    return found


@pytest.mark.parametrize("maker", [None, "nikon", "canon", "sony", "fuji", "olympus", "panasonic"])
def test_a_recorded_body_opens_as_it_did(maker: str | None) -> None:
    config: dict[str, Any] = {} if maker is None else {"vendor": maker}
    pair = bench(**config)
    record = json.loads(json.dumps(ptp.record(pair.usb_device, pair.device.clock)))
    assert len(record["found"]["times_s"]) > 10
    assert replayed(record) == record["found"]
    assert pair.device.do("state")["pictures"] == 0


def test_serial_number_and_texts_are_hidden() -> None:
    pair = bench(vendor="canon")
    record = ptp.record(pair.usb_device, pair.device.clock)
    with pair.camera() as camera:
        serial = camera.info.serial
    assert serial
    everything = json.dumps(record)
    for text in (serial, serial.lower()):
        assert text.encode("utf-16-le").hex() not in everything
        assert text.encode().hex() not in everything
        assert text not in everything


@pytest.mark.parametrize(
    ("data", "hidden"),
    [
        ("\0".join("Ann Example") + "\0\0\0", "\0".join("xxx xxxxxxx") + "\0\0\0"),
        ("\0".join("6000x4000") + "\0\0\0", "\0".join("6000x4000") + "\0\0\0"),
        ("\1\0Ann Example 1971\0", "\1\0xxx xxxxxxx xxxx\0"),
        ("\1\0\2\0ab\0\0", "\1\0\2\0ab\0\0"),  # numbers
    ],
)
def test_texts_of_an_owner_become_x(data: str, hidden: str) -> None:
    recording = ptp.RecordingTransport(ReplayedCamera({"usb": _USB, "packets": []}).replay)
    found = recording._without_private(data.encode("latin-1"), keep_texts=False)
    assert found.decode("latin-1") == hidden


@pytest.mark.parametrize(
    "name", ["Ann", "José", "Müller", "Jürgen Groß", "山田太郎", "Иван Петров"]
)
def test_names_in_any_script_are_hidden(name: str) -> None:
    recording = ptp.RecordingTransport(ReplayedCamera({"usb": _USB, "packets": []}).replay)
    text = name.encode("utf-16-le")
    data = b"\x1e\x50\xff\xff\1" + bytes([len(name) + 1]) + text + b"\0\0\0\0\0"
    found = recording._without_private(data, keep_texts=False)
    assert len(found) == len(data)
    shown = found[6 : 6 + len(text)].decode("utf-16-le")
    assert shown == "".join(" " if each == " " else "x" for each in name)
    many = (name + " " + name + " " + name).encode()
    left = recording._without_private(b"\0" + many + b"\0", keep_texts=False)
    assert set(left) <= set(b"\0x ")


def test_texts_of_information_that_cannot_be_read_are_hidden() -> None:
    text = bytes([9]) + "12345678".encode("utf-16-le") + b"\0\0"
    recording = ptp.RecordingTransport(ReplayedCamera({"usb": _USB, "packets": []}).replay)
    recording._operation = Op.GET_DEVICE_INFO
    recording._keep("received", Container(DATA, Op.GET_DEVICE_INFO, 1, text))
    (packet,) = recording.packets
    assert packet["received"][2] == (bytes([9]) + b"x\0" * 8 + b"\0\0").hex()


def test_texts_that_are_sent_and_a_serial_number_in_an_event_are_hidden() -> None:
    recording = ptp.RecordingTransport(Mock())
    recording._hide("12345678")
    name = bytes([4]) + "Ann".encode("utf-16-le") + b"\0\0"
    recording.send(Op.SET_PROPERTY, 2, [0x501F], name)
    recording._keep("event", Container(EVENT, 0x4002, 2, b"12345678"))
    sent, event = recording.packets
    assert sent["sent"]["data"] == (bytes([4]) + b"x\0" * 3 + b"\0\0").hex()
    assert event["event"][2] == b"xxxxxxxx".hex()


def test_numbers_are_kept() -> None:
    recording = ptp.RecordingTransport(ReplayedCamera({"usb": _USB, "packets": []}).replay)
    times = [1, 2, 4, 100, 125, 256, 512, 1024, 0, 3200]
    for kind in ("<H", "<I"):
        data = b"".join(struct.pack(kind, each) for each in [len(times), *times, 0])
        assert recording._without_private(data, keep_texts=False) == data


_USB = {"vendor": 0x04A9, "product": 1}


def test_a_body_that_cannot_be_opened_is_recorded_with_the_reason() -> None:
    pair = bench()
    with pair.camera():
        record = ptp.record(pair.usb_device, pair.device.clock)
    assert "error" in record["found"]


@pytest.mark.parametrize("planes", [0, 1])
def test_a_recorded_node_is_described_again(planes: int, tmp_path: Path) -> None:
    model = Model(formats=("YUYV", "MJPG"), planes=planes)
    record = json.loads(json.dumps(v4l2.record("/dev/video0", model, tmp_path)))
    assert record["found"]["formats"]
    assert record["found"]["controls"]
    assert replayed(record) == record["found"]
    assert record["descriptors"] == ""


def test_descriptors_of_a_usb_camera_are_recorded(tmp_path: Path) -> None:
    folder = tmp_path / "sys/devices/usb1/1-1"
    (folder / "1-1:1.0").mkdir(parents=True)
    (folder / "descriptors").write_bytes(b"\x12\x01\0\2")
    (folder / "serial").write_text("12345678")
    (tmp_path / "sys/class/video4linux/video0").mkdir(parents=True)
    (tmp_path / "sys/class/video4linux/video0/device").symlink_to(folder / "1-1:1.0")
    record = v4l2.record("/dev/video0", Model(), tmp_path)
    assert record["descriptors"] == "12010002"
    assert "12345678" not in json.dumps(record)


def test_there_are_recordings() -> None:
    assert SENT


@pytest.mark.parametrize("file", SENT, ids=lambda file: file.stem)
def test_what_owners_have_sent_opens_as_it_did(file: Path) -> None:
    for record in json.loads(file.read_text("utf-8"))["cameras"]:
        assert replayed(record) == record["found"]


def test_clock_of_a_replay_is_virtual() -> None:
    assert isinstance(ReplayedCamera({"usb": _USB, "packets": []}).clock, VirtualClock)
