"""Packets of the Crystalfontz CFA635: command, length, data, CRC; found again after damage.

The CRC is CRC-16/X-25: polynomial 0x1021 reflected, start 0xFFFF, inverted, low byte first.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

LONGEST_DATA = 22
"""Bytes of data in a packet at most."""

RESPONSE, REPORT, ERROR = 0x40, 0x80, 0xC0
"""The two highest bits of a packet's command: an answer, a report such as a key, an error."""

CLEAR, BACKLIGHT, KEY_REPORTING, TEXT, LED = 0x06, 0x0E, 0x17, 0x1F, 0x22
"""Commands: clear the display, set its brightness, which keys are reported, write text at column
and row, and the brightness of a half of a light (general-purpose outputs 5 to 12)."""

KEY_ACTIVITY = 0x80
"""The report of a key: 1 to 6 for up, down, left, right, enter, exit pressed, 7 to 12 released."""


@dataclass(frozen=True)
class Packet:
    """One packet of either direction."""

    command: int
    data: bytes = b""

    def encoded(self) -> bytes:
        body = bytes((self.command, len(self.data))) + self.data
        return body + crc(body).to_bytes(2, "little")


def crc(data: bytes) -> int:
    """Return the CRC of a packet's command, length and data.

    >>> hex(crc(b"123456789"))
    '0x906e'
    """
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0x8408 if value & 1 else 0)
    return value ^ 0xFFFF


class PacketReader:
    """Finds the packets in a stream of bytes; bytes that begin none are skipped."""

    def __init__(self) -> None:
        self._received = bytearray()

    def feed(self, data: bytes) -> Iterator[Packet]:
        """Yield the packets that are complete with `data`."""
        self._received += data
        while len(self._received) >= 4:
            length = self._received[1]
            end = length + 4
            if length > LONGEST_DATA:
                del self._received[0]
                continue
            if len(self._received) < end:
                return
            body = bytes(self._received[: end - 2])
            if crc(body) != int.from_bytes(self._received[end - 2 : end], "little"):
                del self._received[0]
                continue
            del self._received[:end]
            yield Packet(body[0], body[2:])

    def give_up(self) -> None:
        """Skip a byte of a packet that stays incomplete, since its length may be damaged."""
        del self._received[:1]
