"""A serial line behind any pyserial URL, with typed errors and deadlines that count silence."""

from __future__ import annotations

import errno
import re
import termios
import time
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

# pyserial's own time-out is the grain in which silence is counted: changing it on an open port
# configures the port anew, which some kinds of ports do slowly.
_GRAIN_S = 0.02
_WRITE_TIMEOUT_S = 5.0

_WHICH = "camctl cameras --probe asks every serial port"
_TAKE_IT = "close the other program (ModemManager, minicom, gphoto2), then try again"
_PLUG_AGAIN = "plug the cable in, switch the camera on, then try again"
_PERMIT = "run: sudo usermod -aG dialout $USER, then log in again"

# What a port cannot be opened for: type, what, next step.  EIO and ENOTTY come from asking what is
# no line, or has no hardware, for its settings.
_OPENING: dict[int, tuple[type[CameraError], str, str]] = {
    errno.ENOENT: (CameraNotFoundError, "there is no such port", _WHICH),
    errno.ENXIO: (CameraNotFoundError, "nothing is behind that port", _WHICH),
    errno.ENODEV: (CameraNotFoundError, "nothing is behind that port", _WHICH),
    errno.EIO: (CameraNotFoundError, "nothing is behind that port", _WHICH),
    errno.ENOTTY: (CameraNotFoundError, "it is no serial port", _WHICH),
    errno.EISDIR: (CameraNotFoundError, "it is no serial port", _WHICH),
    errno.EACCES: (CameraNotFoundError, "no permission to use it", _PERMIT),
    errno.EPERM: (CameraNotFoundError, "no permission to use it", _PERMIT),
    errno.EBUSY: (CameraBusyError, "another process holds it", _TAKE_IT),
    errno.EAGAIN: (CameraBusyError, "another process holds it", _TAKE_IT),
    errno.ECONNREFUSED: (CameraNotFoundError, "nobody listens there", "start what serves the line"),
}


class SerialLink:
    """An open line of 8 bits, no parity and one stop bit, without flow control.

    Ports of the machine are locked: a second program that asks for the lock is refused.  Lines
    without modem signals (ptys, sockets) work, since none is asked for.

    Args:
        url: a port's name, or any URL that `serial.serial_for_url` knows
        speed: baud

    Raises:
        UsageError: the URL is of no known kind
        CameraNotFoundError: no such port, or no permission to use it
        CameraBusyError: another process holds it
    """

    def __init__(self, url: str, speed: int) -> None:
        self.url = url
        try:
            self._line = serial.serial_for_url(
                url,
                baudrate=speed,
                timeout=_GRAIN_S,
                write_timeout=_WRITE_TIMEOUT_S,
                exclusive=True,
            )
        except (serial.SerialException, termios.error, OSError) as error:
            raise _cannot_open(url, error) from error
        except ValueError as error:
            raise UsageError(
                f"'{url}' is no serial port: {_words(error)}",
                hint="give a port such as /dev/ttyUSB0, or a URL such as socket://HOST:PORT",
            ) from error

    @property
    def has_speed(self) -> bool:
        """False where nothing at this end sets the line's speed: a plain socket carries bytes."""
        return not self.url.startswith("socket://")

    @property
    def speed(self) -> int:
        """The speed the line is set to, baud."""
        return int(self._line.baudrate)

    @speed.setter
    def speed(self, baud: int) -> None:
        with self._typed_errors():
            self._line.baudrate = baud

    def write(self, data: bytes) -> None:
        """Send all of `data`.

        Raises:
            CameraDisconnectedError: the line has gone
            CameraTimeoutError: it takes nothing any more
        """
        with self._typed_errors():
            self._line.write(data)

    def read(self, count: int, silence_s: float) -> bytes:
        """Return `count` bytes, or those that came until the line was silent for `silence_s`.

        Raises:
            CameraDisconnectedError: the line has gone
        """
        data = bytearray()
        deadline_s = time.monotonic() + silence_s
        with self._typed_errors():
            while len(data) < count:
                came = self._line.read(count - len(data))
                data += came
                now_s = time.monotonic()
                if came:
                    deadline_s = now_s + silence_s
                elif now_s >= deadline_s:
                    break
        return bytes(data)

    def waiting(self, limit: int) -> bytes:
        """Return what has come already, up to `limit` bytes."""
        data = bytearray()
        with self._typed_errors():
            while len(data) < limit and self._line.in_waiting:
                data += self._line.read(min(self._line.in_waiting, limit - len(data)))
        return bytes(data)

    def close(self) -> None:
        """Let go of the port; a second call does nothing."""
        try:
            self._line.close()
        except (OSError, termios.error):
            return  # it has gone already: nothing is held any more

    @contextmanager
    def _typed_errors(self) -> Iterator[None]:
        try:
            yield
        except serial.SerialTimeoutException as error:
            raise CameraTimeoutError(
                f"{self.url} has taken nothing for {_WRITE_TIMEOUT_S:g} s", hint=_PLUG_AGAIN
            ) from error
        # Not all kinds of ports turn what the system says into their own exception; one that has
        # been closed has no file descriptor (TypeError).
        except (serial.SerialException, OSError, termios.error, TypeError) as error:
            if "multiple access" in str(error):
                # pyserial cannot tell a line that hung up from one that somebody else reads.
                what = f"the line {self.url} has gone, or another process reads from it"
            else:
                what = f"the line {self.url} has gone"
            raise CameraDisconnectedError(what, hint=_PLUG_AGAIN) from error


def _cannot_open(url: str, error: Exception) -> CameraError:
    number = _number(error)
    if number in _OPENING:
        kind, what, hint = _OPENING[number]
        return kind(f"cannot open {url}: {what}", hint=hint)
    return CameraNotFoundError(f"cannot open {url}: {_words(error)}", hint=_WHICH)


def _number(error: Exception) -> int | None:
    """Return the errno, which pyserial sometimes leaves in its words only."""
    first = error.args[0] if error.args else None
    number = getattr(error, "errno", None) or (first if isinstance(first, int) else None)
    if number is not None:
        return int(number)
    found = re.search(r"\[Errno (\d+)\]|\((\d+), ", str(error))
    return int(found[1] or found[2]) if found else None


def _words(error: Exception) -> str:
    return " ".join(str(error).split())
