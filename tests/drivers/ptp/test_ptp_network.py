"""PTP/IP: the same protocol over two TCP connections, its errors, and its own faults."""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from typing import Any, ClassVar

import gphoto2_client
import pytest
from hypothesis import given
from hypothesis import strategies as st
from network_bench import (
    camera_on_network,
    camera_on_tcp,
    our_camera,
    transport_on,
    virtual_camera,
)
from ptp_bench import in_force, settings_at, shoot

import camctl
from camctl.drivers.ptp.codes import OK, Op
from camctl.drivers.ptp.network_link import HEADER, Address, Packet, PacketLink
from camctl.drivers.ptp.session import Session
from camctl.drivers.ptp.transport import EVENT
from camctl.errors import (
    CameraBusyError,
    CameraDisconnectedError,
    CameraError,
    CameraNotFoundError,
    CameraProtocolError,
    CameraTimeoutError,
    UsageError,
)
from camctl.interface.camera import Camera
from camctl.interface.clock import VirtualClock
from camctl.interface.controls import ExposureSetting
from camctl.sim.devices.ptp.network import NetworkCamera as VirtualCamera
from camctl.testing.conformance import CameraConformance

pytestmark = pytest.mark.usefixtures("own_profiles")


class NetworkConformance(CameraConformance):
    """A camera in the network; subclasses change its configuration."""

    run_length = 30  # the same camera on USB takes a hundred
    config: ClassVar[dict[str, Any]] = {}

    device: VirtualCamera

    def open_camera(self) -> Camera:
        self.device = virtual_camera(**self.config)
        return our_camera(self.device).open()

    def open_second(self, camera: Camera) -> Camera:
        return our_camera(self.device).open()

    def unplug(self, camera: Camera) -> None:
        self.device.detach()

    def silence(self, camera: Camera) -> None:
        self.device.do("silence")

    def in_force(self, camera: Camera) -> ExposureSetting:
        return in_force(self.device)

    def middle_s(self, camera: Camera) -> float:
        return camera.controls.time_s.nearest(1 / 125)


class TestStandard(NetworkConformance):
    pass


class TestNikonRaw(NetworkConformance):
    config: ClassVar[dict[str, Any]] = {"vendor": "nikon", "files": "dng"}


class TestCanon(NetworkConformance):
    config: ClassVar[dict[str, Any]] = {"vendor": "canon"}


class TestSlowAndFragmented(NetworkConformance):
    """Every packet comes in pieces of three bytes, slower than a modem."""

    config: ClassVar[dict[str, Any]] = {"chunk_bytes": 3, "bytes_per_s": 2e4}


class TestWithPings(NetworkConformance):
    """The camera ends the session if its pings are not answered."""

    config: ClassVar[dict[str, Any]] = {"ping_s": 3.0}


# ---- the transport


def test_events_pings_and_data_in_both_directions() -> None:
    device = virtual_camera(ping_s=1.0)
    transport = transport_on(device)
    session = Session(transport, transport.name, device.clock)
    session.open()
    assert transport.name == "Virtual PTP camera at 10.0.0.1:15740"
    for _ in range(4):  # the camera's pings are answered while events are awaited
        assert transport.event(1.0) is None
    assert device.responder.session
    iso = session.description(0x500F)
    session.call(Op.SET_PROPERTY, 0x500F, task="set ISO", data=(400).to_bytes(2, "little"))
    assert (iso.current, session.description(0x500F).current) == (100, 400)
    session.call(Op.INITIATE_CAPTURE, 0, 0, task="take a picture")
    codes = []
    while (event := transport.event(1.0)) is not None:
        assert event.kind == EVENT
        codes.append(event.code)
    assert {0x4002, 0x400D} <= set(codes)
    session.close()
    transport.close()
    assert not device.responder.session


def test_a_host_that_answers_no_pings_loses_its_session() -> None:
    device = virtual_camera(ping_s=1.0)
    transport = transport_on(device)
    device.clock.sleep_until(10.0)
    with pytest.raises(CameraDisconnectedError, match="has ended the network connection"):
        transport.event(1.0)


def test_a_cancelled_transaction_is_answered_and_the_session_goes_on() -> None:
    device = virtual_camera(event_order="before")  # the response comes after the exposure
    transport = transport_on(device)
    session = Session(transport, "the camera", device.clock, silence_s=2.0)
    session.open()
    session.call(Op.SET_PROPERTY, 0x500D, task="set", data=(300_000).to_bytes(4, "little"))
    with pytest.raises(CameraTimeoutError):
        session.attempt(Op.INITIATE_CAPTURE, 0, 0)
    assert session.attempt(Op.GET_STORAGE_IDS).code == OK
    assert session.times_recovered == 1


@given(st.binary(max_size=200), st.integers(1, 50))
def test_any_bytes_are_packets_or_an_error(data: bytes, piece: int) -> None:
    class Bytes:
        def __init__(self) -> None:
            self.left = data

        def send(self, data: bytes, timeout_s: float) -> None: ...

        def receive(self, size: int, timeout_s: float) -> bytes:
            part, self.left = self.left[: min(size, piece)], self.left[min(size, piece) :]
            return part

        def close(self) -> None: ...

    link, read = PacketLink(Bytes(), "the camera", VirtualClock()), 0
    with suppress(CameraError):  # any other error fails the test
        while True:
            kind, body = link.receive(1.0)
            assert data[read : read + 8] == struct.pack("<II", len(body) + 8, kind)
            assert data[read + 8 : read + 8 + len(body)] == body
            read += 8 + len(body)
    assert read <= len(data)


# ---- faults


def test_half_of_an_object_is_fetched_again() -> None:
    for answers in (True, False):
        with camera_on_network() as (camera, device):
            settings = settings_at(camera, 1 / 100)
            shoot(camera, settings)
            device.do("truncate", count=1, answers=answers)
            assert len(shoot(camera, settings)) == 1


def test_a_camera_that_hangs_once_is_connected_anew() -> None:
    with camera_on_network() as (camera, device):
        settings = settings_at(camera, 1 / 100)
        shoot(camera, settings)
        device.do("garbage", count=1)
        assert len(shoot(camera, settings)) == 1


def test_reset_connections_are_a_disconnected_camera() -> None:
    with camera_on_network() as (camera, device):
        frames = camera.shoot(settings_at(camera, 1 / 100, 1 / 50))
        next(frames)
        device.do("reset")
        with pytest.raises(CameraDisconnectedError, match="has ended the network connection"):
            next(frames)
    device.clock.sleep_until(device.clock.now() + 1.0)  # the exposure that was running has ended
    with our_camera(device).open() as again:
        assert len(shoot(again, settings_at(again, 1 / 100))) == 1


def test_a_silent_connection_is_noticed_by_pings_before_the_time_out() -> None:
    with camera_on_network() as (camera, device):
        shoot(camera, settings_at(camera, 1 / 100))
        device.do("silence")
        began_s = device.clock.now()
        with pytest.raises(CameraDisconnectedError, match="has not answered in the network"):
            shoot(camera, settings_at(camera, 1 / 50))
        assert device.clock.now() - began_s < 20.0


@pytest.mark.parametrize("pause_s", [0.0, 0.4])
@pytest.mark.parametrize("vendor", ["none", "canon", "nikon", "sony"])
def test_a_picture_of_an_exposure_before_the_link_broke_is_set_aside(
    vendor: str, pause_s: float, caplog: pytest.LogCaptureFixture
) -> None:
    with camera_on_network(vendor=vendor) as (camera, device):
        frames = camera.shoot(settings_at(camera, 1 / 100, 2.0))
        next(frames)
        device.do("reset")
        with pytest.raises(CameraDisconnectedError):
            next(frames)
    device.clock.sleep_until(device.clock.now() + pause_s)
    with our_camera(device).open() as again:
        settings = settings_at(again, 1 / 50, 1 / 10)
        assert [frame.applied for frame in shoot(again, settings)] == settings
    assert "it is of an exposure before, and left on the card; shooting again" in caplog.text


def test_it_is_said_what_is_waited_for_and_until_when(caplog: pytest.LogCaptureFixture) -> None:
    with camera_on_network() as (camera, device), caplog.at_level("INFO"):
        shoot(camera, settings_at(camera, 1 / 100))
        device.do("hang")
        began_s = device.clock.now()
        frames = camera.shoot(settings_at(camera, 1 / 50))
        with pytest.raises(KeyboardInterrupt), interrupted_at(device, began_s + 8):
            next(frames)
        assert "has sent nothing for 5 s: waiting for its answer for up to 15 s more" in caplog.text
        camera.close()
        assert device.clock.now() < began_s + 8 + 3


@contextmanager
def interrupted_at(device: VirtualCamera, time_s: float) -> Iterator[None]:
    """Press Control-C when a wait reaches that time."""
    wait_for = device.clock.wait_for

    def waited(event: threading.Event, deadline_s: float) -> bool:
        if deadline_s < time_s:
            return wait_for(event, deadline_s)
        wait_for(event, time_s)
        raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(device.clock, "wait_for", waited)
        yield


def test_a_transfer_that_breaks_off_is_a_disconnected_camera() -> None:
    with camera_on_network() as (camera, device):
        shoot(camera, settings_at(camera, 1 / 100))
        device.do("unplug", after_bytes=300)
        with pytest.raises(CameraDisconnectedError):
            shoot(camera, settings_at(camera, 1 / 50))
    with pytest.raises(ConnectionRefusedError):
        our_camera(device).open()


# ---- refused, in one line each


def test_a_second_host_is_refused_and_the_first_goes_on() -> None:
    with camera_on_network() as (camera, device):
        with pytest.raises(CameraBusyError, match="is in use by another computer or program"):
            our_camera(device).open()
        assert len(shoot(camera, settings_at(camera, 1 / 100))) == 1


def test_a_host_that_is_not_paired_is_refused() -> None:
    guid = "00112233445566778899aabbccddeeff"
    device = virtual_camera(guid=guid)
    with pytest.raises(CameraError, match=r"refuses this computer \(GUID [0-9a-f]{32}\); pair"):
        our_camera(device).open()
    with our_camera(device, guid=guid.upper()).open() as camera:
        assert camera.info.model == "Virtual PTP camera"


@pytest.mark.parametrize(
    ("text", "host", "port", "id_"),
    [
        ("camera.local", "camera.local", 15740, "camera.local"),
        ("10.0.0.1:15740", "10.0.0.1", 15740, "10.0.0.1"),
        ("10.0.0.1:99", "10.0.0.1", 99, "10.0.0.1:99"),
        ("[fe80::1]:99", "fe80::1", 99, "[fe80::1]:99"),
    ],
)
def test_addresses(text: str, host: str, port: int, id_: str) -> None:
    address = Address.parse(text)
    assert (address.host, address.port, str(address)) == (host, port, id_)


@pytest.mark.parametrize(
    "text", ["a b", "host:", "host:0", "host:65536", "host:x", "http://h", ":1"]
)
def test_invalid_addresses(text: str) -> None:
    with pytest.raises(UsageError, match="invalid address of a camera in the network"):
        camctl.open_camera(f"ptpip:{text}")


def test_an_invalid_guid_is_a_usage_error() -> None:
    with pytest.raises(UsageError, match="invalid camera option guid=12; write 32 hexadecimal"):
        camctl.open_camera("ptpip:10.0.0.1", guid="12")


def test_without_an_address_the_error_says_how_to_give_one() -> None:
    with pytest.raises(UsageError, match="ptpip:HOST"):
        camctl.open_camera("ptpip")


def test_an_unknown_host_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(*_: object) -> None:
        raise socket.gaierror(-2, "Name or service not known")

    monkeypatch.setattr(socket, "create_connection", unknown)
    with pytest.raises(CameraNotFoundError, match="there is no host 'nikon' in the network"):
        camctl.open_camera("ptpip:nikon")


@contextmanager
def server(answer: bytes | None) -> Iterator[int]:
    """Yield the port of a server that sends `answer` and closes; None: it stays silent."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        links = []

        def serve() -> None:
            link, _ = listener.accept()
            links.append(link)
            if answer is not None:
                link.recv(100)
                link.sendall(answer)
                link.close()

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield listener.getsockname()[1]
        thread.join()
        for link in links:
            link.close()


def test_a_refused_connection_is_one_clear_line() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    with pytest.raises(CameraNotFoundError, match=f"127.0.0.1:{port} refuses the connection"):
        camctl.open_camera(f"ptpip:127.0.0.1:{port}")


@pytest.mark.parametrize(
    "answer", [b"", b"HTTP/1.1 400 Bad Request\r\n\r\n", b"SSH-2.0-OpenSSH\r\n"]
)
def test_a_server_that_is_no_camera_is_named(answer: bytes) -> None:
    with (
        server(answer) as port,
        pytest.raises(CameraProtocolError, match=f"127.0.0.1:{port} is not a PTP/IP camera"),
    ):
        camctl.open_camera(f"ptpip:127.0.0.1:{port}")


def test_a_server_that_says_nothing_times_out(caplog: pytest.LogCaptureFixture) -> None:
    device = virtual_camera()
    device.is_silent = True
    with (
        caplog.at_level("INFO"),
        pytest.raises(CameraTimeoutError, match="sends no PTP/IP answer"),
    ):
        transport_on(device)
    assert device.clock.now() == 20
    assert "has sent nothing for 5 s: waiting for its answer for up to 15 s more" in caplog.text


class _EndlessLink:
    """Sends one header and then any number of zeros; counts what is taken."""

    def __init__(self, header: bytes) -> None:
        self._header, self.taken = header, 0

    def send(self, data: bytes, timeout_s: float) -> None:
        del data, timeout_s

    def receive(self, size: int, timeout_s: float) -> bytes:
        del timeout_s
        head, self._header = self._header, b""
        self.taken += size
        return head + bytes(size - len(head))

    def close(self) -> None:
        pass


@pytest.mark.parametrize("kind", list(Packet))
@pytest.mark.parametrize("length", [(1 << 31) + 8, (1 << 32) - 1, 100_000, 7])
def test_no_length_is_believed_that_the_kind_of_packet_cannot_have(
    kind: Packet, length: int
) -> None:
    link = _EndlessLink(HEADER.pack(length, kind))
    with pytest.raises(CameraProtocolError, match="no PTP/IP packet"):
        PacketLink(link, "camera", VirtualClock()).receive(1.0, data_bytes=99_000)
    assert link.taken <= 4096


# ---- over TCP


def test_our_camera_over_tcp() -> None:
    with (
        camera_on_tcp(files="dng") as (device, port),
        camctl.open_camera(f"ptpip:127.0.0.1:{port}", response="linear") as camera,
    ):
        frames = shoot(camera, settings_at(camera, 1 / 500, 1 / 250, 1 / 125))
        assert len(frames) == device.state()["shots"] - 1  # one to learn the format
        with closing(camera.shoot(settings_at(camera, 1 / 100))) as stream:
            device.do("reset")
            with pytest.raises(CameraDisconnectedError):
                next(stream)


def test_a_switched_off_camera_refuses_and_comes_back() -> None:
    with camera_on_tcp() as (device, port):
        device.detach()
        with pytest.raises(CameraNotFoundError, match="refuses the connection"):
            camctl.open_camera(f"ptpip:127.0.0.1:{port}")
        device.attach()
        with camctl.open_camera(f"ptpip:127.0.0.1:{port}") as camera:
            assert camera.info.id == f"ptpip:127.0.0.1:{port}"


@pytest.mark.skipif(gphoto2_client.missing() is not None, reason=str(gphoto2_client.missing()))
@pytest.mark.parametrize("vendor", ["none", pytest.param("nikon", marks=pytest.mark.slow)])
def test_gphoto2_takes_the_same_picture_from_the_virtual_camera(vendor: str, tmp_path: Any) -> None:
    with camera_on_tcp(vendor=vendor) as (device, port):
        address = f"ptpip:127.0.0.1:{port}"
        port_of_gphoto2 = f"{address}:{port}"  # of the commands, and of the events
        summary = gphoto2_client.gphoto2("--port", port_of_gphoto2, "--summary", folder=tmp_path)
        assert device.responder.identity.model in summary
        data = gphoto2_client.shoot_ptp(tmp_path, port_of_gphoto2)
        with _opened_when_free(address) as camera:
            setting = settings_at(camera, device.state()["exposure"]["time_s"])
            (frame,) = shoot(camera, setting)
    assert frame.original is not None
    assert frame.original.data == data


def _opened_when_free(address: str) -> Camera:
    """Open a camera once it has noticed that its last program closed the connection."""
    for _ in range(200):
        with suppress(CameraBusyError):
            return camctl.open_camera(address, response="linear")
        time.sleep(0.05)
    raise TimeoutError(address)
