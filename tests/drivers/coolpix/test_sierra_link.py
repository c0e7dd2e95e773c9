"""The serial line: what a URL may be, what goes wrong with it, and how long it waits."""

import errno
import os
import socket
import threading
import time
from contextlib import closing

import pytest
import serial

from camctl.errors import (
    CameraBusyError,
    CameraDisconnectedError,
    CameraNotFoundError,
    CameraTimeoutError,
    UsageError,
)
from drivers.common.serial_link import SerialLink
from drivers.coolpix.sierra.packets import Register
from drivers.coolpix.sierra.session import Sierra


@pytest.fixture
def pty():
    """(far end, name) of a pseudo-terminal, whose near end stays open."""
    far, near = os.openpty()
    yield far, os.ttyname(near)
    for end in (far, near):
        try:
            os.close(end)
        except OSError as error:
            assert error.errno == errno.EBADF  # noqa: PT017 - the test has closed it


def one_line(error):
    assert error.hint
    assert "\n" not in str(error)
    return str(error)


class TestOpening:
    def test_no_such_port(self):
        with pytest.raises(CameraNotFoundError, match="/dev/no-such-port: there is no") as caught:
            SerialLink("/dev/no-such-port", 19200)
        one_line(caught.value)

    def test_a_file_and_a_folder_are_no_ports(self, tmp_path):
        (tmp_path / "file").write_text("")
        for path in (tmp_path, tmp_path / "file"):
            with pytest.raises(CameraNotFoundError, match="it is no serial port") as caught:
                SerialLink(str(path), 19200)
            one_line(caught.value)

    @pytest.mark.parametrize(
        ("number", "error", "words"),
        [
            (errno.EACCES, CameraNotFoundError, r"no permission.*usermod -aG dialout"),
            (errno.EBUSY, CameraBusyError, r"another process holds it"),
            (errno.EIO, CameraNotFoundError, r"nothing is behind"),
            (errno.EPROTO, CameraNotFoundError, r"Protocol error"),
        ],
    )
    def test_what_the_system_says_is_typed(self, monkeypatch, number, error, words):
        def refuse(*_):
            raise OSError(number, os.strerror(number))

        monkeypatch.setattr(serial.serialposix.os, "open", refuse)
        with pytest.raises(error, match=words) as caught:
            SerialLink("/dev/ttyS0", 19200)
        one_line(caught.value)

    def test_a_second_one_is_told_that_the_port_is_held(self, pty):
        first = SerialLink(pty[1], 19200)
        with closing(first), pytest.raises(CameraBusyError, match="another process holds it"):
            SerialLink(pty[1], 19200)
        SerialLink(pty[1], 19200).close()

    @pytest.mark.parametrize("url", ["telepathy://camera", "socket://nowhere"])
    def test_a_url_that_nobody_knows(self, url):
        with pytest.raises((UsageError, CameraNotFoundError)) as caught:
            SerialLink(url, 19200)
        one_line(caught.value)

    def test_nobody_listens_at_a_socket(self):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        with pytest.raises(CameraNotFoundError, match="nobody listens") as caught:
            SerialLink(f"socket://127.0.0.1:{port}", 19200)
        one_line(caught.value)


class TestLine:
    def test_a_terminal_without_modem_signals_works(self, pty):
        far, name = pty
        with closing(SerialLink(name, 19200)) as link:
            link.speed = 115200
            assert link.speed == 115200
            link.write(b"hello")
            assert os.read(far, 10) == b"hello"
            os.write(far, b"\x00\x11\x13\xff\n\r")
            assert link.read(6, 1.0) == b"\x00\x11\x13\xff\n\r"

    def test_it_waits_for_silence_and_not_for_the_whole(self, pty):
        far, name = pty

        def trickle():
            for _ in range(6):
                time.sleep(0.1)
                os.write(far, b"x")

        thread = threading.Thread(target=trickle)
        with closing(SerialLink(name, 19200)) as link:
            thread.start()
            began = time.monotonic()
            assert link.read(10, 0.25) == b"x" * 6
            assert 0.8 < time.monotonic() - began < 1.3
            thread.join()

    def test_it_returns_as_soon_as_all_is_there(self, pty):
        far, name = pty
        with closing(SerialLink(name, 19200)) as link:
            os.write(far, bytes(2054))
            began = time.monotonic()
            assert len(link.read(2054, 5.0)) == 2054
            assert time.monotonic() - began < 1.0
            os.write(far, b"abc")
            time.sleep(0.05)
            assert link.waiting(2) == b"ab"
            assert link.waiting(2) == b"c"
            assert link.waiting(2) == b""

    @pytest.mark.parametrize(
        "act",
        [
            lambda link: link.read(1, 1.0),
            lambda link: link.write(b"x"),
            lambda link: link.waiting(1),
            lambda link: setattr(link, "speed", 9600),
        ],
        ids=["read", "write", "waiting", "speed"],
    )
    def test_a_line_that_hangs_up_is_gone(self, pty, act):
        far, name = pty
        with closing(SerialLink(name, 19200)) as link:
            os.close(far)
            with pytest.raises(CameraDisconnectedError) as caught:
                act(link)
            assert name in one_line(caught.value)

    def test_a_closed_line_is_gone_and_closes_again(self, pty):
        link = SerialLink(pty[1], 19200)
        link.close()
        link.close()
        with pytest.raises(CameraDisconnectedError):
            link.read(1, 0.1)

    def test_a_line_that_takes_nothing_is_silent(self, pty, monkeypatch):
        monkeypatch.setattr("drivers.common.serial_link._WRITE_TIMEOUT_S", 0.2)
        link = SerialLink(pty[1], 19200)
        with closing(link), pytest.raises(CameraTimeoutError, match="taken nothing"):
            link.write(bytes(1 << 20))


class TestOtherUrls:
    def test_a_loop_answers_itself_and_is_no_camera(self):
        with closing(SerialLink("loop://", 19200)) as link:
            began = time.monotonic()
            with pytest.raises(CameraTimeoutError):
                Sierra(link, timeout_s=0.5).open()
            assert time.monotonic() - began < 1.5

    def test_a_camera_behind_a_socket(self):
        """Its speed is the server's to set, so that it stays as it is."""
        listener = socket.create_server(("127.0.0.1", 0))

        def serve():
            line, _ = listener.accept()
            with line:
                heard = b""
                while part := line.recv(100):
                    heard += part
                    if heard == b"\0":
                        line.sendall(b"\x15")
                    elif heard[:2] == b"\x1b\x53" and len(heard) == 8:
                        line.sendall(b"\x03\x00\x04\x00\x07\x00\x00\x00\x07\x00")
                    elif heard == b"\x06":
                        return
                    else:
                        continue
                    heard = b""

        thread = threading.Thread(target=serve)
        thread.start()
        url = f"socket://127.0.0.1:{listener.getsockname()[1]}"
        with closing(listener), closing(SerialLink(url, 19200)) as link:
            sierra = Sierra(link, timeout_s=3.0)
            sierra.open()
            assert sierra.get(Register.PICTURES) == 7
            thread.join()
            with pytest.raises(CameraDisconnectedError):
                sierra.get(Register.PICTURES)
