"""The streaming protocol of GigE Vision (GVSP): frames as packets, lost ones, and sent again.

Numbers are from "GigE Vision", version 2.0, chapters 23 to 25.
"""

from __future__ import annotations

import random
import socket
import struct
import threading
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from camctl.interface.camera import Pixels
from camctl.sim.devices.gige.features import IMAGE_CHUNK, StreamFormat

_LEADER, _TRAILER, _PAYLOAD = 1, 2, 3  # formats of packets
_IMAGE, _IMAGE_WITH_CHUNKS = 0x0001, 0x4001  # types of payload
_OVERHEAD = 20 + 8 + 8  # bytes of IP, UDP and GVSP in the size of a packet
_KEPT = 16  # last frames whose packets can be sent again


@dataclass(frozen=True)
class FramePacket:
    """A frame as it is sent.

    Attributes:
        block: its number, 1 to 65535
        ticks: its time stamp
        code: its pixel format
        shape: (rows, columns)
        image: its bytes
        chunks: bytes by identifier; empty: it has none
    """

    block: int
    ticks: int
    code: int
    shape: tuple[int, int]
    image: bytes
    chunks: Mapping[int, bytes]


def pack(pixels: Pixels, form: StreamFormat, bits: int) -> bytes:
    """Return the bytes of a frame whose samples have `bits` bits."""
    if form.bits == 8:
        upper = (pixels >> max(0, bits - 8)).astype(np.uint8)
        return (upper[..., ::-1] if form.code == 0x02180015 else upper).tobytes()
    samples = pixels.astype(np.uint32).reshape(-1)
    if not form.packing:
        return samples.astype("<u2").tobytes()
    if form.packing == "Packed":
        first, second = samples[0::2], samples[1::2]
        low = form.bits - 8
        between = (first & (1 << low) - 1) | (second & (1 << low) - 1) << 4
        return np.stack((first >> low, between, second >> low), axis=1).astype(np.uint8).tobytes()
    single = (samples[:, None] >> np.arange(form.bits, dtype=np.uint32) & 1).astype(np.uint8)
    return np.packbits(single.reshape(-1), bitorder="little").tobytes()


class StreamChannel:
    """Sends frames to the host, loses packets, and sends them again when asked.

    Args:
        ip: address of the device
        loss: probability with which a packet is not sent
        can_resend: lost packets are sent again when asked
        seed: of the losses

    Attributes:
        target: address of the host; None: nothing is sent
        packet_bytes: of a packet with its IP and UDP headers
        lost, resent: packets
    """

    def __init__(self, ip: str, *, loss: float, can_resend: bool, seed: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((ip, 0))
        self._random = random.Random(seed)
        self._kept: OrderedDict[int, list[bytes]] = OrderedDict()
        self._lock = threading.Lock()
        self.loss = loss
        self.lose_next = 0
        self.can_resend = can_resend
        self.target: tuple[str, int] | None = None
        self.packet_bytes = 1440
        self.lost = self.resent = 0

    def close(self) -> None:
        """Send nothing any more."""
        self._socket.close()

    def send_test(self, size: int) -> None:
        """Send a packet of this size, by which a host finds how large packets may be."""
        self._send(bytes(max(0, size - 28)))

    def send(self, frame: FramePacket) -> None:
        """Send a frame."""
        packets = self._packets(frame)
        with self._lock:
            self._kept[frame.block] = packets
            while len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
        for number, packet in enumerate(packets):
            is_chosen = self.lose_next > 0 and number == 1
            if is_chosen or (self.loss and self._random.random() < self.loss):
                self.lose_next -= is_chosen
                self.lost += 1
                continue
            self._send(packet)

    def resend(self, block: int, first: int, last: int) -> None:
        """Send packets of a frame again."""
        with self._lock:
            packets = self._kept.get(block, [])[first : last + 1]
        if self.can_resend:
            for packet in packets:
                self.resent += 1
                self._send(packet)

    def _send(self, packet: bytes) -> None:
        if self.target is not None:
            try:
                self._socket.sendto(packet, self.target)
            except OSError:  # the host has closed its port
                return

    def _packets(self, frame: FramePacket) -> list[bytes]:
        kind = _IMAGE_WITH_CHUNKS if frame.chunks else _IMAGE
        rows, columns = frame.shape
        leader = struct.pack(
            ">HHQIIIIIHH", 0, kind, frame.ticks, frame.code, columns, rows, 0, 0, 0, 0
        )
        data, trailer = frame.image, struct.pack(">HHI", 0, kind, rows)
        if frame.chunks:
            for number, value in ((IMAGE_CHUNK, b""), *frame.chunks.items()):
                length = len(frame.image) if number == IMAGE_CHUNK else len(value)
                data += value + struct.pack(">II", number, length)
            trailer = struct.pack(">HHIII", 0, kind, len(data), rows, 0)
        step = self.packet_bytes - _OVERHEAD
        parts = [data[place : place + step] for place in range(0, len(data), step)]
        bodies = [(_LEADER, leader), *((_PAYLOAD, part) for part in parts), (_TRAILER, trailer)]
        return [
            struct.pack(">HHI", 0, frame.block, form << 24 | number) + body
            for number, (form, body) in enumerate(bodies)
        ]


def payload_bytes(shape: tuple[int, int], form: StreamFormat, chunks: int) -> int:
    """Return the bytes of a frame with so many chunks of 8 bytes."""
    rows, columns = shape
    bits = {"": 8 if form.bits == 8 else 16, "p": form.bits, "Packed": 12}[form.packing]
    colours = 3 if form.code >> 24 == 0x02 else 1
    image = -(-rows * columns * bits * colours // 8)
    return image + (8 + 16 * chunks if chunks else 0)
