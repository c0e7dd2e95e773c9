"""Parsed USB descriptors, and the queues of IN endpoints.

Layouts and field names of descriptors are from USB 2.0, section 9.6.
"""

from __future__ import annotations

import errno
import struct
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from types import SimpleNamespace

_DEVICE = (
    "<BBHBBBBHHHBBBB",
    "bLength bDescriptorType bcdUSB bDeviceClass bDeviceSubClass bDeviceProtocol bMaxPacketSize0"
    " idVendor idProduct bcdDevice iManufacturer iProduct iSerialNumber bNumConfigurations",
)
_CONFIGURATION = (
    "<BBHBBBBB",
    "bLength bDescriptorType wTotalLength bNumInterfaces bConfigurationValue iConfiguration"
    " bmAttributes bMaxPower",
)
_INTERFACE = (
    "<BBBBBBBBB",
    "bLength bDescriptorType bInterfaceNumber bAlternateSetting bNumEndpoints bInterfaceClass"
    " bInterfaceSubClass bInterfaceProtocol iInterface",
)
_ENDPOINT = (
    "<BBBBHB",
    "bLength bDescriptorType bEndpointAddress bmAttributes wMaxPacketSize bInterval",
)
_INTERFACE_TYPE, _ENDPOINT_TYPE = 4, 5  # bDescriptorType


@dataclass
class Descriptor:
    """A descriptor and those below it.

    Attributes:
        fields: by their names in the specification
        extra: class descriptors that follow it, unparsed
        children: alternate settings of a configuration, endpoints of an alternate setting
    """

    fields: dict[str, int]
    extra: bytes = b""
    children: list[Descriptor] = field(default_factory=list)

    def alternate(self, interface: int, alternate: int) -> Descriptor:
        """Return an alternate setting by the indices of interface and setting (IndexError)."""
        numbers = sorted({child.fields["bInterfaceNumber"] for child in self.children})
        number = numbers[interface]
        settings = [c for c in self.children if c.fields["bInterfaceNumber"] == number]
        return settings[alternate]

    def endpoints(self) -> list[dict[str, int]]:
        """Return the fields of all endpoints of a configuration."""
        return [endpoint.fields for child in self.children for endpoint in child.children]

    def as_namespace(self) -> SimpleNamespace:
        """Return the attributes that pyusb reads from a descriptor."""
        extra = list(self.extra)
        return SimpleNamespace(**self.fields, extra_descriptors=extra, bRefresh=0, bSynchAddress=0)


def parse_device(data: bytes) -> dict[str, int]:
    """Return the fields of a device descriptor."""
    return _fields(data, _DEVICE)


@lru_cache(maxsize=64)
def parse_configuration(data: bytes) -> Descriptor:
    """Return a configuration descriptor with its interfaces and endpoints."""
    first, *others = split_descriptors(data)
    configuration = last = Descriptor(_fields(first, _CONFIGURATION))
    for each in others:
        if each[1] == _INTERFACE_TYPE:
            last = Descriptor(_fields(each, _INTERFACE))
            configuration.children.append(last)
        elif each[1] == _ENDPOINT_TYPE:
            last = Descriptor(_fields(each, _ENDPOINT))
            configuration.children[-1].children.append(last)
        else:
            last.extra += each
    return configuration


def _fields(data: bytes, layout: tuple[str, str]) -> dict[str, int]:
    pattern, names = layout
    return dict(zip(names.split(), struct.unpack_from(pattern, data), strict=True))


@dataclass(eq=False)
class Read:
    """A read of the host from an IN endpoint.

    Attributes:
        endpoint: number without direction
        length: size of the host's buffer, bytes
        done: called once with an errno (0 for success) and the bytes; with the device locked
    """

    endpoint: int
    length: int
    done: Callable[[int, bytes], None]
    _parts: list[memoryview] = field(default_factory=list)
    _received: int = 0

    def append(self, part: memoryview) -> None:
        """Add bytes to the buffer."""
        self._parts.append(part)
        self._received += len(part)

    @property
    def room(self) -> int:
        """Free bytes in the buffer."""
        return self.length - self._received

    def finish(self, error: int = 0) -> None:
        """End the read: call `done` with the bytes received."""
        self.done(error, b"".join(self._parts))


@dataclass
class Transfer:
    """Bytes that the device has sent; `rest` are those that the host has not read."""

    rest: memoryview
    has_empty_packet: bool  # at its end


class Pipe:
    """The queues of an IN endpoint: reads of the host, and transfers of the device."""

    def __init__(self, packet: int) -> None:
        self.packet = packet
        self.reads: deque[Read] = deque()
        self.transfers: deque[Transfer] = deque()
        self.is_halted = False

    def pump(self) -> None:
        """Match reads with what has been sent, in order."""
        while self.reads and (self.is_halted or self.transfers):
            if self.is_halted:
                self.reads.popleft().finish(errno.EPIPE)
            else:
                self._fill(self.reads[0])

    def _fill(self, read: Read) -> None:
        """Move bytes of the first transfer into the first read, which may end either of them."""
        transfer = self.transfers[0]
        if len(transfer.rest) > read.room and read.room % self.packet:
            # A packet that is larger than the rest of the host's buffer is lost (babble).
            cut = min(len(transfer.rest), -(-read.room // self.packet) * self.packet)
            transfer.rest = transfer.rest[cut:]
            if not transfer.rest:
                self.transfers.popleft()
            self.reads.popleft().finish(errno.EOVERFLOW)
            return
        size = min(read.room, len(transfer.rest))
        is_short = size == len(transfer.rest) and size % self.packet != 0
        read.append(transfer.rest[:size])
        transfer.rest = transfer.rest[size:]
        if is_short:
            transfer.has_empty_packet = False
        elif transfer.has_empty_packet and not transfer.rest and read.room:
            transfer.has_empty_packet, is_short = False, True
        if not transfer.rest and not transfer.has_empty_packet:
            self.transfers.popleft()
        if is_short or not read.room:
            self.reads.popleft().finish()


def split_descriptors(data: bytes) -> Iterator[bytes]:
    """Yield concatenated descriptors one by one, up to the first with an invalid length."""
    while len(data) >= 2 and 2 <= data[0] <= len(data):
        yield data[: data[0]]
        data = data[data[0] :]
