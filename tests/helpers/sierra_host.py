"""A host of the Sierra protocol, written byte by byte, for the virtual CoolPix."""

from __future__ import annotations

import struct
from typing import Any

import serial

from camctl.sim.devices.clock import VirtualDeviceClock
from camctl.sim.devices.sierra import device as sierra

ACK, NAK, ENQ, INVALID, SESSION_ERROR = b"\x06", b"\x15", b"\x05", b"\x11", b"\xfc"
FIRST, NEXT = b"\x1b\x53", b"\x1b\x43"  # type and subtype of a command
LAST = b"\x03"  # type of the last data packet
CAPTURE, DELETE, DELETE_ALL = 2, 7, 1  # actions


class Host:
    """A small host for the Sierra protocol."""

    def __init__(self, device: sierra.SierraDevice) -> None:
        self.port: Any = serial.serial_for_url(device.line.path, 19200, timeout=3)
        self.device = device
        self.has_session = False

    def send_nul(self) -> bytes:
        """Send the byte that opens a session; return the answer."""
        self.port.write(b"\0")
        return bytes(self.port.read())

    @staticmethod
    def packet(head: bytes, data: bytes, sum_error: int = 0) -> bytes:
        total = (sum(data) + sum_error) & 0xFFFF
        return head + struct.pack("<H", len(data)) + data + struct.pack("<H", total)

    def command(self, *data: int) -> bytes:
        """Send a command; return the first byte of the answer."""
        head = NEXT if self.has_session else FIRST
        self.has_session = True
        self.port.write(self.packet(head, bytes(data)))
        return bytes(self.port.read())

    def data_packet(self) -> tuple[int, bytes]:
        """Return (number, data) of the data packet whose first byte has been read."""
        number, length = struct.unpack("<BH", self.port.read(3))
        data = self.port.read(length)
        assert int.from_bytes(self.port.read(2), "little") == sum(data) & 0xFFFF
        return number, data

    def text(self, register: int) -> bytes | None:
        """Return a text register, or None if it is refused."""
        kind = self.command(4, register)
        if kind == INVALID:
            return None
        data, numbers = b"", []
        while True:
            number, part = self.data_packet()
            numbers.append(number)
            data += part
            self.port.write(ACK)
            if kind == LAST:
                assert numbers == [i % 256 for i in range(len(numbers))]
                return data
            kind = bytes(self.port.read())

    def file(self, register: int = 14) -> bytes:
        """Return the file in a register."""
        data = self.text(register)
        assert data is not None
        return data

    def number(self, register: int) -> int:
        """Return a numeric register, which must not be refused."""
        assert self.command(1, register) == LAST
        _, data = self.data_packet()
        self.port.write(ACK)
        return int.from_bytes(data, "little")

    def set(self, register: int, value: int) -> bytes:
        """Set a numeric register; return the answer."""
        return self.command(0, register, *struct.pack("<I", value))

    def set_speed(self, number: int, baud: int) -> bytes:
        """Change the speed of both ends; return the answer."""
        answer = self.set(17, number)
        if answer == ACK:
            self.port.baudrate = baud
        return answer

    def act(self, action: int) -> None:
        """Execute an action, which must succeed."""
        assert self.command(2, action, 0) == ACK
        assert bytes(self.port.read()) == ENQ

    def sleep(self, time_s: float) -> None:
        clock = self.device.clock
        clock.sleep_until(clock.now() + time_s)


def connected(**config: Any) -> tuple[sierra.SierraDevice, Host]:
    """Return a camera in virtual time that sees a ramp, and its host."""
    config = {"scene": "ramp", "sensor": "ideal-8", "size": "48x32", **config}
    device = sierra.make({"repeat_noise": True, "line": "memory", **config}, VirtualDeviceClock())
    device.attach()
    return device, Host(device)
