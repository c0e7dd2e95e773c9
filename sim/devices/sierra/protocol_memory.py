"""A serial line inside this process, which pyserial opens by a URL such as memory://1.

For a URL NAME://... pyserial imports the module protocol_NAME from one of the packages registered
with it and opens the class `Serial` of that module; hence the name of this module.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from functools import partial
from itertools import count

import serial

from camctl.sim.devices.clock import DeviceClock
from camctl.sim.devices.sierra.line import BITS_A_BYTE, BYTES_AT_ONCE, Line

if __package__ not in serial.protocol_handler_packages:
    serial.protocol_handler_packages.append(__package__)

_lines: dict[str, MemoryLine] = {}  # open lines by URL
_numbers = count(1)


class MemoryLine(Line):
    """A camera's line that needs no terminal, no thread and no real time.

    With a virtual clock, the camera and a host on this line run in one virtual time.

    Args:
        received: called with the bytes that the host sends, in the host's thread
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
        _lines[self.path] = self

    def close(self) -> None:
        host, self.host = self.host, None
        if host is not None:
            host.hang_up()
        _lines.pop(self.path, None)

    def send(self, data: bytes, speed: int = 0) -> None:
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
        line = _lines.get(self.port)
        if line is None:
            raise serial.SerialException(f"cannot open {self.port}: no camera is there")
        if line.host is not None:
            raise serial.SerialException(f"cannot open {self.port}: another host has it open")
        self._line, line.host = line, self
        self.is_open = True

    def close(self) -> None:
        if self._line is not None:
            self._line.host = None
        self._line = None
        self.is_open = False

    @property
    def in_waiting(self) -> int:
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
        """Send bytes to the camera, which processes them before this returns."""
        self._connected().received(bytes(data))
        return len(data)

    def arrive(self, data: bytes) -> None:
        with self._lock:
            self._buffer += data
        self._arrived.set()

    def hang_up(self) -> None:
        """End the connection: the camera has been unplugged."""
        self._line = None
        self._arrived.set()

    def _connected(self) -> MemoryLine:
        if self._line is None:
            raise serial.SerialException(f"the camera at {self.port} has been unplugged")
        return self._line

    def _reconfigure_port(self) -> None:
        """Accept all settings; only the speed has an effect (`MemoryLine.host_speed`)."""
