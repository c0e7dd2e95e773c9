"""Opening a CoolPix: options, kinds of serial lines, and ports that are probed."""

from __future__ import annotations

import os
import select
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
import serial
from coolpix_bench import SETTINGS, coolpix_on, shoot, virtual_coolpix

from camctl.drivers.coolpix.backend import CoolpixBackend, probe_lines
from camctl.drivers.coolpix.camera import CoolpixCamera, CoolpixOptions
from camctl.errors import CameraDisconnectedError, CameraNotFoundError, UsageError
from camctl.sim.devices.clock import RealDeviceClock
from camctl.sim.devices.sierra.device import SierraDevice

pytestmark = pytest.mark.usefixtures("own_profiles")


@contextmanager
def served(path: str) -> Iterator[str]:
    """Serve a terminal on a socket, at the speed at which a camera begins; yield the URL."""
    line = serial.Serial(path, 19200, timeout=0)
    listener = socket.create_server(("127.0.0.1", 0))
    over = threading.Event()

    def serve() -> None:
        client, _ = listener.accept()
        with client:
            while not over.is_set():
                ready, _, _ = select.select([client, line.fileno()], [], [], 0.05)
                if client in ready:
                    # Or each of our acknowledgements waits 40 ms for that of the server.
                    client.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)
                    line.write(client.recv(4096))
                if line.fileno() in ready:
                    client.sendall(line.read(4096))

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield f"socket://127.0.0.1:{listener.getsockname()[1]}"
    finally:
        over.set()
        thread.join()
        listener.close()
        line.close()


class TestRealTime:
    """On pseudo-terminals of the kernel, in real time."""

    @pytest.fixture
    def device(self) -> Iterator[SierraDevice]:
        with virtual_coolpix(RealDeviceClock(), line="pty") as device:
            yield device

    def test_a_pseudo_terminal(self, device: SierraDevice) -> None:
        with coolpix_on(device) as camera:
            frames = shoot(camera)
            assert "at 115200 baud" in camera.controls.notes[0]
        for frame, setting in zip(frames, SETTINGS, strict=True):
            exposed = device.body.sensor.expose(setting.time_s)
            assert np.array_equal(frame.pixels[..., 0], exposed)

    def test_a_socket(self, device: SierraDevice) -> None:
        with served(device.line.path) as url, coolpix_on(device, url) as camera:
            (frame,) = shoot(camera, SETTINGS[:1])
            assert "at 19200 baud" in camera.controls.notes[0]
        assert np.array_equal(frame.pixels[..., 0], device.body.sensor.expose(0.002))


class TestOpening:
    def test_the_constructor_sends_nothing_and_open_can_be_repeated(
        self, device: SierraDevice
    ) -> None:
        camera = CoolpixCamera(device.line.path, CoolpixOptions(format="tiff"), clock=device.clock)
        assert device.do("state")["packets"] == 0
        for use in (lambda: camera.controls, lambda: camera.info, lambda: camera.shoot([])):
            with pytest.raises(CameraDisconnectedError, match="is not open; open it first"):
                use()
        for _ in range(2):
            with camera:
                assert len(shoot(camera)) == 2
            assert not device.do("state")["session"]

    def test_options_of_the_command_line(self, device: SierraDevice) -> None:
        options = CoolpixOptions.parse(
            {"format": "TIFF", "speed": "19200", "response": "power:2.2"}
        )
        with CoolpixCamera(device.line.path, options, clock=device.clock) as camera:
            assert camera.controls.response is not None
            assert camera.controls.response.M == 255
            assert "at 19200 baud" in camera.controls.notes[0]

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"size": "1x1"}, "unknown camera option 'size'"),
            ({"format": "raw"}, "invalid camera option format=raw; .* 'jpeg' or 'tiff'"),
            ({"speed": "1200"}, "invalid camera option speed=1200; the camera has the speeds 9600"),
            ({"response": "film"}, "unknown camera response 'film'"),
            ({"response": "power:x"}, "invalid response 'power:x'"),
            ({"response": "power:0"}, "expected 0.05 to 20"),
            ({"response": "srgb:2"}, "unknown camera response 'srgb:2'"),
        ],
    )
    def test_invalid_options_are_usage_errors_before_the_line_is_opened(
        self, options: dict[str, str], message: str
    ) -> None:
        with pytest.raises(UsageError, match=message):
            CoolpixBackend().open("/dev/no-such-port", options)

    def test_the_port_is_required(self) -> None:
        with pytest.raises(UsageError, match="ttyUSB0"):
            CoolpixBackend().open("", {})


class TestProbing:
    """In real time, since each port is asked in a thread of its own."""

    def test_ports_are_left_alone_without_probe(self, monkeypatch: pytest.MonkeyPatch) -> None:
        def fail() -> list[str]:
            raise AssertionError("ports were listed")

        monkeypatch.setattr("camctl.drivers.coolpix.backend.serial_ports", fail)
        assert CoolpixBackend().discover() == ()

    def test_a_camera_is_found_among_other_ports(self, monkeypatch: pytest.MonkeyPatch) -> None:
        clock = RealDeviceClock()
        with virtual_coolpix(clock) as device, virtual_coolpix(clock) as dead:
            dead.do("hang")
            urls = [device.line.path, dead.line.path, "/dev/no-such-port"]
            monkeypatch.setattr("camctl.drivers.coolpix.backend.serial_ports", lambda: urls)
            monkeypatch.setattr("camctl.drivers.coolpix.backend._PROBE_S", 60.0)
            monkeypatch.setattr("camctl.drivers.coolpix.backend._PORT_TIMEOUT_S", 60.0)
            (found,) = CoolpixBackend().discover(probe=True)
            assert found.id == f"coolpix:{device.line.path}"
            assert (found.make, found.model, found.serial) == ("NIKON", "E990", "CP990001")
            with coolpix_on(device) as camera:
                assert camera.info == found

    def test_a_port_that_blocks_is_not_waited_for(self, monkeypatch: pytest.MonkeyPatch) -> None:
        end = threading.Event()

        def blocking(url: str, speed: int) -> None:
            end.wait()
            raise CameraNotFoundError(f"there is no {url}")

        monkeypatch.setattr("camctl.drivers.coolpix.backend.SerialLink", blocking)
        try:
            assert probe_lines(["/dev/ttyS0"], 0.05) == []
        finally:
            end.set()

    def test_a_device_that_is_no_camera_receives_one_byte(self) -> None:
        near, far = os.openpty()
        try:
            assert probe_lines([os.ttyname(far)], 60.0) == []
            os.set_blocking(near, False)
            assert os.read(near, 100) == b"\0"
        finally:
            os.close(near)
            os.close(far)
