"""Packets and single bytes of the Sierra protocol on a serial line.

Sources: Eugene Crosser's description of the protocol (protocol.htm of photopc 3.07) and the Sierra
driver of libgphoto2.  A packet has a type, a subtype or sequence number, a length (u16), up to
2,048 bytes of data, and the sum of the data (u16), all little-endian; all else is single bytes.
"""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import NamedTuple

from camctl.drivers.common.serial_link import SerialLink
from camctl.errors import CameraDisconnectedError, CameraProtocolError

NUL, DATA, LAST_DATA, ENQ, ACK, DC1, NAK, COMMAND = 0x00, 0x02, 0x03, 0x05, 0x06, 0x11, 0x15, 0x1B
WRONG_SPEED, SESSION_ERROR, SESSION_END = 0x8C, 0xFC, 0xFF  # what a camera answers
FIRST_COMMAND, NEXT_COMMAND = 0x53, 0x43  # subtypes of a command

SET_INTEGER, GET_INTEGER, ACT, SET_DATA, GET_DATA = range(5)  # first byte of a command

MAX_DATA = 2048  # bytes of a packet
#: Speed at the start of a session, baud; then the codes of all speeds.
FIRST_SPEED = 19_200
SPEEDS = {9_600: 1, 19_200: 2, 38_400: 3, 57_600: 4, 115_200: 5}

SESSION_OVER = (WRONG_SPEED, SESSION_ERROR, SESSION_END)
_SINGLE_BYTES = (NUL, ENQ, ACK, DC1, NAK, *SESSION_OVER)
_ANY_SUM = 0xFFFF  # the CoolPix 880 computes no sum and sends this (libgphoto2)

# Silence that ends an incomplete packet.
_WITHIN_PACKET_S = 1.0
# Silence that ends what is discarded, and most bytes discarded: far more than one packet.
_QUIET_S = 0.1
DRAIN_BYTES = 1 << 16


class Register(IntEnum):
    """Registers of integers (u32) and of data."""

    RESOLUTION = 1
    SHUTTER_US = 3
    PICTURE = 4
    APERTURE = 5
    FLASH = 7
    PICTURES = 10
    PICTURES_LEFT = 11
    PICTURE_BYTES = 12
    PICTURE_DATA = 14
    BATTERY_PERCENT = 16
    SPEED = 17
    ADJUSTMENT = 19
    WHITE_BALANCE = 20
    SERIAL_NUMBER = 25
    MODEL = 27
    PICTURE_SUMMARY = 47
    MAKER = 48
    CARD = 51
    PICTURE_NAME = 79


class Action(IntEnum):
    """Actions of a camera."""

    TAKE_PICTURE = 2
    END_SESSION = 4


class RefusedCommandError(CameraProtocolError):
    """The camera understood a command and refused it (DC1)."""


class SessionOverError(CameraDisconnectedError):
    """The camera has ended the session and returned to 19,200 baud."""


class Reply(NamedTuple):
    """A single byte or a packet from the camera; `kind` is None if it was damaged."""

    kind: int | None
    sequence: int = 0
    data: bytes = b""


DAMAGED = Reply(None)


def checksum(data: bytes) -> int:
    r"""Return the sum of all bytes, 16 bits.

    >>> checksum(b"\x01\x10")
    17
    """
    return sum(data) & 0xFFFF


def command_packet(payload: bytes, *, first: bool = False) -> bytes:
    r"""Return the packet of a command; the `first` of a session has another subtype.

    >>> command_packet(b"\x02\x02\x00").hex(" ")
    '1b 43 03 00 02 02 00 04 00'
    """
    subtype = FIRST_COMMAND if first else NEXT_COMMAND
    head = struct.pack("<BBH", COMMAND, subtype, len(payload))
    return head + payload + struct.pack("<H", checksum(payload))


def setting(register: Register, value: int) -> bytes:
    """Return the payload of a command that writes an integer register."""
    return struct.pack("<BBI", SET_INTEGER, register, value)


def receive(link: SerialLink, silence_s: float) -> Reply | None:
    """Return the next packet or single byte; None if nothing comes for `silence_s`.

    After a damaged packet the line is drained, so that the next byte starts a packet again.

    Raises:
        CameraDisconnectedError: the line was disconnected
    """
    first = link.read(1, silence_s)
    if not first:
        return None
    kind = first[0]
    if kind in _SINGLE_BYTES:
        return Reply(kind)
    reply = _packet(link, kind) if kind in (DATA, LAST_DATA) else DAMAGED
    if reply is DAMAGED:
        drain(link)
    return reply


def drain(link: SerialLink) -> None:
    """Discard what the camera still sends, up to `DRAIN_BYTES`."""
    left = DRAIN_BYTES
    while left > 0 and (data := link.read(MAX_DATA, _QUIET_S)):
        left -= len(data)


def _packet(link: SerialLink, kind: int) -> Reply:
    head = link.read(3, _WITHIN_PACKET_S)
    if len(head) < 3:
        return DAMAGED
    sequence, length = struct.unpack("<BH", head)
    if length > MAX_DATA:
        return DAMAGED
    body = link.read(length + 2, _WITHIN_PACKET_S)
    data, tail = body[:length], body[length:]
    if len(tail) < 2 or int.from_bytes(tail, "little") not in (checksum(data), _ANY_SUM):
        return DAMAGED
    return Reply(kind, sequence, data)
