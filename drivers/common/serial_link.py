"""A serial line behind any pyserial URL, with typed errors and time-outs that count silence."""

from __future__ import annotations

import errno
import math
import re
from collections.abc import Iterator
from contextlib import contextmanager

import serial

from camctl.errors import (
    CameraBusyError,
    CameraDisconnectedError,
    CameraError,
    CameraNotFoundError,
    CameraTimeoutError,
    UsageError,
)

try:
    from termios import error as TermiosError  # noqa: N812 - an exception class
except ImportError:  # not a POSIX system: pyserial raises its own errors alone
    TermiosError = OSError  # type: ignore[assignment,misc]  # the same use, in except clauses

# The time-out of one read; silence is counted in reads that return nothing.  The time-out stays
# constant, since changing it on an open port configures the port anew, which is slow on some.
_READ_TIMEOUT_S = 0.02
_WRITE_TIMEOUT_S = 5.0

_FIND_PORT = "look for a camera at every serial port"
_RELEASE_PORT = "close the other program (ModemManager, minicom, gphoto2), then try again"
_PLUG_IN_AGAIN = "plug the cable in, switch the camera on, then try again"
_GRANT_PERMISSION = "run: sudo usermod -aG dialout $USER, then log in again"
_START_SERVER = "start the program that serves the line"

# errno of opening a port: error type, reason, what to do.  EIO and ENOTTY come from asking a file
# that is no line, or a port without hardware, for its settings.
_OPEN_ERRORS: dict[int, tuple[type[CameraError], str, str]] = {
    errno.ENOENT: (CameraNotFoundError, "there is no such port", _FIND_PORT),
    errno.ENXIO: (CameraNotFoundError, "the port has no hardware", _FIND_PORT),
    errno.ENODEV: (CameraNotFoundError, "the port has no hardware", _FIND_PORT),
    errno.EIO: (CameraNotFoundError, "the port has no hardware", _FIND_PORT),
    errno.ENOTTY: (CameraNotFoundError, "it is not a serial port", _FIND_PORT),
    errno.EISDIR: (CameraNotFoundError, "it is not a serial port", _FIND_PORT),
    errno.EACCES: (CameraNotFoundError, "no permission to use it", _GRANT_PERMISSION),
    errno.EPERM: (CameraNotFoundError, "no permission to use it", _GRANT_PERMISSION),
    errno.EBUSY: (CameraBusyError, "another process holds it", _RELEASE_PORT),
    errno.EAGAIN: (CameraBusyError, "another process holds it", _RELEASE_PORT),
    errno.ECONNREFUSED: (CameraNotFoundError, "no server listens at that address", _START_SERVER),
}


class SerialLink:
    """An open line of 8 bits, no parity and one stop bit, without flow control.

    Local ports are locked, so that a second program that asks for the lock is refused.  Lines
    without modem signals (pseudo-terminals, sockets) work, since none is used.  All waiting is done
    by pyserial, which is given the time-outs.

    Args:
        url: name of a port, or any URL that `serial.serial_for_url` accepts
        speed: baud

    Raises:
        UsageError: the kind of URL is unknown
        CameraNotFoundError: no such port, or no permission to use it
        CameraBusyError: another process holds it
    """

    def __init__(self, url: str, speed: int) -> None:
        self.url = url
        try:
            self._line = serial.serial_for_url(
                url,
                baudrate=speed,
                timeout=_READ_TIMEOUT_S,
                write_timeout=_WRITE_TIMEOUT_S,
                exclusive=True,
            )
        except (serial.SerialException, TermiosError, OSError) as error:
            raise _open_error(url, error) from error
        except ValueError as error:
            raise UsageError(
                f"'{url}' is not a serial port: {_one_line(error)}",
                hint="give a port such as /dev/ttyUSB0, or a URL such as socket://HOST:PORT",
            ) from error

    @property
    def has_speed(self) -> bool:
        """False for a plain socket, which carries bytes and has no speed that we could set."""
        return not self.url.startswith("socket://")

    @property
    def speed(self) -> int:
        """The speed of the line, baud."""
        return int(self._line.baudrate)

    @speed.setter
    def speed(self, baud: int) -> None:
        with self._typed_errors():
            self._line.baudrate = baud

    def write(self, data: bytes) -> None:
        """Send all of `data`.

        Raises:
            CameraDisconnectedError: the line was disconnected
            CameraTimeoutError: the other end accepts nothing
        """
        with self._typed_errors():
            self._line.write(data)

    def read(self, count: int, silence_s: float) -> bytes:
        """Return `count` bytes, or those that came before `silence_s` seconds without any.

        Raises:
            CameraDisconnectedError: the line was disconnected
        """
        data = bytearray()
        limit = max(1, math.ceil(silence_s / _READ_TIMEOUT_S))
        silent_reads = 0
        with self._typed_errors():
            while len(data) < count and silent_reads < limit:
                part = self._line.read(count - len(data))
                data += part
                silent_reads = 0 if part else silent_reads + 1
        return bytes(data)

    def read_waiting(self, limit: int) -> bytes:
        """Return the bytes that have already arrived, up to `limit`; raises as `read`."""
        data = bytearray()
        with self._typed_errors():
            while len(data) < limit and self._line.in_waiting:
                data += self._line.read(min(self._line.in_waiting, limit - len(data)))
        return bytes(data)

    def close(self) -> None:
        """Close the port; a second call does nothing."""
        try:
            self._line.close()
        except (OSError, TermiosError):
            return  # it was disconnected: there is nothing left to close

    @contextmanager
    def _typed_errors(self) -> Iterator[None]:
        try:
            yield
        except serial.SerialTimeoutException as error:
            raise CameraTimeoutError(
                f"the line {self.url} has accepted no data for {_WRITE_TIMEOUT_S:g} s",
                hint=_PLUG_IN_AGAIN,
            ) from error
        # Some kinds of ports pass on the system's errors as they are; a closed port has no file
        # descriptor (TypeError).
        except (serial.SerialException, OSError, TermiosError, TypeError) as error:
            what = f"the line {self.url} was disconnected"
            if "multiple access" in str(error):  # pyserial cannot distinguish the two
                what += ", or another process reads from it"
            raise CameraDisconnectedError(what, hint=_PLUG_IN_AGAIN) from error


def _open_error(url: str, error: Exception) -> CameraError:
    number = _errno(error)
    if number in _OPEN_ERRORS:
        kind, what, hint = _OPEN_ERRORS[number]
    else:
        kind, what, hint = CameraNotFoundError, _one_line(error), _FIND_PORT
    remedies = {"probe_ports": None} if hint == _FIND_PORT else None
    return kind(f"cannot open {url}: {what}", hint=hint, remedies=remedies)


def _errno(error: Exception) -> int | None:
    """Return the errno, which pyserial sometimes puts into its text alone."""
    first = error.args[0] if error.args else None
    number = getattr(error, "errno", None) or (first if isinstance(first, int) else None)
    if number is not None:
        return int(number)
    found = re.search(r"\[Errno (\d+)\]|\((\d+), ", str(error))
    return int(found[1] or found[2]) if found else None


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
