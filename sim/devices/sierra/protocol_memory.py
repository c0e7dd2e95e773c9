"""A serial line inside this process: pyserial opens it by a URL such as memory://1.

pyserial looks for the module protocol_NAME of a URL NAME://... in the packages that are registered
with it, and opens the class `Serial` of that module.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from functools import partial
from itertools import count

import serial

from sim.devices.clock import DeviceClock
from sim.devices.sierra.line import BITS_A_BYTE, BYTES_AT_ONCE

if __package__ not in serial.protocol_handler_packages:
    serial.protocol_handler_packages.append(__package__)

_lines: dict[str, MemoryLine] = {}  # those that are plugged in, by URL
_numbers = count(1)


class MemoryLine:
    """A camera's line without terminal, thread and real time; see `sim.devices.sierra.line.Line`.

    With a virtual clock, a host and the camera at this line run in one virtual time.

    Args:
        received: takes the bytes that the host sends, in the host's thread
        clock: on which the host's time-outs and the line's speed are counted

    Attributes:
        path: the URL that pyserial opens
    """

    def __init__(self, received: Callable[[bytes], None], clock: DeviceClock) -> None:
        self.path = f"memory://{next(_numbers)}"
        self.received = received
        self.clock = clock
        self.host: Serial | None = None
        self._arrived_s = -math.inf  # when the last byte of what was sent arrives

    @property
    def host_speed(self) -> int | None:
        """The speed that the host has set; None where no host has opened the line."""
        return None if self.host is None else int(self.host.baudrate)

    def open(self) -> None:
        """Plug it in."""
        _lines[self.path] = self

    def close(self) -> None:
        """Pull the plug: the host's next read or write fails."""
        host, self.host = self.host, None
        if host is not None:
            host.hang_up()
        _lines.pop(self.path, None)

    def send(self, data: bytes, speed: int = 0) -> None:
        """Send bytes to the host at `speed` bits a second, or at once (0)."""
        if self.host is None:
            return
        if not speed:
            self.host.arrive(data)
            return
        for at in range(0, len(data), BYTES_AT_ONCE):
            part = data[at : at + BYTES_AT_ONCE]
            began_s = max(self._arrived_s, self.clock.now())
            self._arrived_s = began_s + len(part) * BITS_A_BYTE / speed
            self.clock.call_at(self._arrived_s, partial(self.host.arrive, part))


class Serial(serial.SerialBase):  # type: ignore[misc]  # pyserial has no types
    """The host's end of a `MemoryLine`, as `serial.serial_for_url` opens it."""

    def __init__(self, *arguments: object, **options: object) -> None:
        self._line: MemoryLine | None = None
        self._buffer = bytearray()
        self._lock = threading.Lock()  # of the buffer
        self._arrived = threading.Event()
        super().__init__(*arguments, **options)

    def open(self) -> None:
        """Open the line (SerialException: no such line, or another host has it open)."""
        line = _lines.get(self.port)
        if line is None:
            raise serial.SerialException(f"cannot open {self.port}: nothing is plugged in there")
        if line.host is not None:
            raise serial.SerialException(f"cannot open {self.port}: another host has it open")
        self._line, line.host = line, self
        self.is_open = True

    def close(self) -> None:
        """Close the line; a second call does nothing."""
        if self._line is not None:
            self._line.host = None
        self._line = None
        self.is_open = False

    @property
    def in_waiting(self) -> int:
        """How many bytes have arrived and have not been read."""
        self._connected()
        return len(self._buffer)

    def read(self, size: int = 1) -> bytes:
        """Return `size` bytes, or fewer where the time-out ends before they have arrived."""
        clock = self._connected().clock
        deadline_s = math.inf if self.timeout is None else clock.now() + self.timeout
        is_in_time = True
        while is_in_time:
            self._arrived.clear()
            self._connected()
            if len(self._buffer) >= size:
                break
            is_in_time = clock.wait_for(self._arrived, deadline_s)
        with self._lock:
            data = bytes(self._buffer[:size])
            del self._buffer[: len(data)]
        return data

    def write(self, data: bytes) -> int:
        """Send bytes to the camera, which answers before this returns unless its line is paced."""
        self._connected().received(bytes(data))
        return len(data)

    def reset_input_buffer(self) -> None:
        """Forget what has arrived and has not been read."""
        with self._lock:
            self._buffer.clear()

    def arrive(self, data: bytes) -> None:
        """Take bytes from the camera."""
        with self._lock:
            self._buffer += data
        self._arrived.set()

    def hang_up(self) -> None:
        """Fail from now on: the camera has been unplugged."""
        self._line = None
        self._arrived.set()

    def _connected(self) -> MemoryLine:
        if self._line is None:
            raise serial.SerialException(f"nothing is plugged in at {self.port}")
        return self._line

    def _reconfigure_port(self) -> None:
        """Take settings as they are; `MemoryLine.host_speed` reads the speed."""
