"""The serial line: URLs, errors, and how long it waits."""

from __future__ import annotations

import errno
import os
import socket
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import serial
from error_lines import one_line

from camctl.drivers.common.serial_link import SerialLink
from camctl.errors import (
    CameraBusyError,
    CameraDisconnectedError,
    CameraError,
    CameraNotFoundError,
    CameraTimeoutError,
    UsageError,
)


@pytest.fixture
def pty() -> Iterator[tuple[int, str]]:
    """(far end, name) of a pseudo-terminal; the near end stays open."""
    far, near = os.openpty()
    yield far, os.ttyname(near)
    for end in (far, near):
        try:
            os.close(end)
        except OSError as error:
            assert error.errno == errno.EBADF  # noqa: PT017 - the test has closed it


class ScriptedLine:
    """A pyserial line whose reads return the given parts; b"" stands for a read's time-out."""

    def __init__(self, parts: list[bytes]) -> None:
        self.parts = parts

    def read(self, count: int) -> bytes:
        return self.parts.pop(0)


def scripted(parts: list[bytes], monkeypatch: pytest.MonkeyPatch) -> tuple[SerialLink, float]:
    """Return a link on a scripted line, and the time-out that pyserial was given for a read."""
    given: dict[str, Any] = {}

    def open_line(url: str, **options: Any) -> ScriptedLine:
        given.update(options)
        return ScriptedLine(parts)

    monkeypatch.setattr(serial, "serial_for_url", open_line)
    return SerialLink("scripted", 19200), given["timeout"]


class TestOpening:
    def test_a_missing_port(self) -> None:
        with pytest.raises(CameraNotFoundError, match="/dev/no-such-port: there is no") as caught:
            SerialLink("/dev/no-such-port", 19200)
        one_line(caught.value)

    @pytest.mark.parametrize("name", ["file", "."])
    def test_a_file_or_folder(self, tmp_path: Path, name: str) -> None:
        (tmp_path / "file").write_text("")
        with pytest.raises(CameraNotFoundError, match="it is not a serial port") as caught:
            SerialLink(str(tmp_path / name), 19200)
        one_line(caught.value)

    @pytest.mark.parametrize(
        ("number", "kind", "message"),
        [
            (errno.EACCES, CameraNotFoundError, r"no permission to use it; .*usermod -aG dialout"),
            (errno.EBUSY, CameraBusyError, r"another process holds it; close"),
            (errno.EIO, CameraNotFoundError, r"the port has no hardware; "),
            (errno.EPROTO, CameraNotFoundError, r"Protocol error; "),
        ],
    )
    def test_errors_of_the_system_are_typed(
        self,
        monkeypatch: pytest.MonkeyPatch,
        number: int,
        kind: type[CameraError],
        message: str,
    ) -> None:
        def refuse(*_: object) -> None:
            raise OSError(number, os.strerror(number))

        monkeypatch.setattr(serial.serialposix.os, "open", refuse)
        with pytest.raises(kind, match=message) as caught:
            SerialLink("/dev/ttyS0", 19200)
        assert type(caught.value) is kind
        one_line(caught.value)

    def test_a_port_that_is_already_open(self, pty: tuple[int, str]) -> None:
        first = SerialLink(pty[1], 19200)
        with closing(first), pytest.raises(CameraBusyError, match="another process holds it"):
            SerialLink(pty[1], 19200)
        SerialLink(pty[1], 19200).close()

    def test_an_unknown_kind_of_url(self) -> None:
        with pytest.raises(UsageError, match="'telepathy://camera' is not a serial port") as caught:
            SerialLink("telepathy://camera", 19200)
        one_line(caught.value)

    def test_a_socket_without_a_port_number(self) -> None:
        with pytest.raises(CameraNotFoundError, match="cannot open socket://nowhere") as caught:
            SerialLink("socket://nowhere", 19200)
        one_line(caught.value)

    def test_a_socket_without_a_server(self) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            url = f"socket://127.0.0.1:{free.getsockname()[1]}"
            with pytest.raises(CameraNotFoundError, match="no server listens") as caught:
                SerialLink(url, 19200)
        one_line(caught.value)


class TestReading:
    """A read ends with all its bytes, or after silence; pyserial waits, in short reads."""

    def test_it_waits_until_the_line_is_silent(self, monkeypatch: pytest.MonkeyPatch) -> None:
        trickle = [b"x", *[b""] * 4, b"x", *[b""] * 4, b"x"]
        link, timeout_s = scripted([*trickle, *[b""] * 100], monkeypatch)
        assert link.read(10, 5 * timeout_s) == b"xxx"
        assert len(link._line.parts) == 95

    def test_it_ends_as_soon_as_all_bytes_have_come(self, monkeypatch: pytest.MonkeyPatch) -> None:
        link, timeout_s = scripted([b"ab", b"", b"cd", b"more"], monkeypatch)
        assert link.read(4, 60.0) == b"abcd"
        assert link._line.parts == [b"more"]
        assert timeout_s <= 0.05

    def test_no_silence_at_all_is_one_read(self, monkeypatch: pytest.MonkeyPatch) -> None:
        link, _ = scripted([b"", b"x"], monkeypatch)
        assert link.read(1, 0.0) == b""

    def test_bytes_that_wait_are_read_up_to_a_limit(self) -> None:
        with closing(SerialLink("loop://", 19200)) as link:
            link.write(b"abc")
            assert link.read_waiting(2) == b"ab"
            assert link.read_waiting(2) == b"c"
            assert link.read_waiting(2) == b""


class TestLine:
    def test_a_terminal_without_modem_signals_works(self, pty: tuple[int, str]) -> None:
        far, name = pty
        with closing(SerialLink(name, 19200)) as link:
            link.speed = 115200
            assert link.speed == 115200
            link.write(b"hello")
            assert os.read(far, 10) == b"hello"
            os.write(far, b"\x00\x11\x13\xff\n\r")
            assert link.read(6, 60.0) == b"\x00\x11\x13\xff\n\r"

    @pytest.mark.parametrize(
        "act",
        [
            lambda link: link.read(1, 1.0),
            lambda link: link.write(b"x"),
            lambda link: link.read_waiting(1),
            lambda link: setattr(link, "speed", 9600),
        ],
        ids=["read", "write", "read_waiting", "speed"],
    )
    def test_a_line_that_hangs_up_is_disconnected(
        self, pty: tuple[int, str], act: Callable[[SerialLink], object]
    ) -> None:
        far, name = pty
        with closing(SerialLink(name, 19200)) as link:
            os.close(far)
            with pytest.raises(CameraDisconnectedError, match=f"{name} was disc") as caught:
                act(link)
            one_line(caught.value)

    def test_a_closed_line_is_disconnected_and_may_be_closed_again(
        self, pty: tuple[int, str]
    ) -> None:
        link = SerialLink(pty[1], 19200)
        link.close()
        link.close()
        with pytest.raises(CameraDisconnectedError):
            link.read(1, 0.1)

    def test_a_line_that_accepts_nothing_is_a_time_out(
        self, pty: tuple[int, str], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr("camctl.drivers.common.serial_link._WRITE_TIMEOUT_S", 0.2)
        link = SerialLink(pty[1], 19200)
        with closing(link), pytest.raises(CameraTimeoutError, match="accepted no data"):
            link.write(bytes(1 << 20))
