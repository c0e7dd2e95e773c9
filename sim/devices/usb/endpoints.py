"""USB descriptors as fields: the device's, and a configuration's tree of interfaces and endpoints.

Layouts and field names are those of USB 2.0, section 9.6.
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


@dataclass
class Part:
    """A descriptor with what lies below it.

    Attributes:
        fields: by their names in the specification
        extra: class descriptors that follow it, as they came
        parts: alternate settings of a configuration, endpoints of an alternate setting
    """

    fields: dict[str, int]
    extra: bytes = b""
    parts: list[Part] = field(default_factory=list)

    def alternate(self, interface: int, alternate: int) -> Part:
        """Return an alternate setting by the indices of interface and setting (IndexError)."""
        numbers = sorted({part.fields["bInterfaceNumber"] for part in self.parts})
        of_it = [p for p in self.parts if p.fields["bInterfaceNumber"] == numbers[interface]]
        return of_it[alternate]

    def as_namespace(self) -> SimpleNamespace:
        """Return what pyusb reads: the fields, and extra_descriptors as a list of bytes."""
        extra = list(self.extra)
        return SimpleNamespace(**self.fields, extra_descriptors=extra, bRefresh=0, bSynchAddress=0)


def parse_device(data: bytes) -> dict[str, int]:
    """Return the fields of a device descriptor."""
    return _fields(data, _DEVICE)


@lru_cache(maxsize=64)
def parse_configuration(data: bytes) -> Part:
    """Return a configuration descriptor with its interfaces and endpoints."""
    first, *others = descriptors(data)
    whole = last = Part(_fields(first, _CONFIGURATION))
    for each in others:
        if each[1] == 4:
            last = Part(_fields(each, _INTERFACE))
            whole.parts.append(last)
        elif each[1] == 5:
            last = Part(_fields(each, _ENDPOINT))
            whole.parts[-1].parts.append(last)
        else:
            last.extra += each
    return whole


def _fields(data: bytes, layout: tuple[str, str]) -> dict[str, int]:
    pattern, names = layout
    return dict(zip(names.split(), struct.unpack_from(pattern, data), strict=True))


@dataclass(frozen=True)
class Endpoint:
    """An endpoint of the configuration descriptor.

    Attributes:
        address: with the direction in bit 7
        attributes: bits 0 and 1 are 2 for bulk, 3 for interrupt
        packet: most bytes of a packet
    """

    address: int
    attributes: int
    packet: int


@dataclass(eq=False)
class Read:
    """A read of the host that waits for its data.

    Attributes:
        endpoint: number without direction
        length: most bytes it takes
        done: called once with an errno (0 for success) and the bytes; with the device locked
    """

    endpoint: int
    length: int
    done: Callable[[int, bytes], None]
    _parts: list[memoryview] = field(default_factory=list)
    _got: int = 0

    def take(self, part: memoryview) -> None:
        """Add bytes."""
        self._parts.append(part)
        self._got += len(part)

    @property
    def room(self) -> int:
        """Bytes it still takes."""
        return self.length - self._got

    def finish(self, error: int = 0) -> None:
        """Hand over what came."""
        self.done(error, b"".join(self._parts))


@dataclass
class Transfer:
    """Bytes on their way to the host; `tail` is the empty packet that ends them."""

    rest: memoryview
    tail: bool


class Pipe:
    """An IN endpoint: what the host reads and what the device has sent."""

    def __init__(self, packet: int) -> None:
        self.packet = packet
        self.reads: deque[Read] = deque()
        self.transfers: deque[Transfer] = deque()
        self.is_halted = False

    def pump(self) -> None:
        """Give each read what has been sent, in order."""
        while self.reads and (self.is_halted or self.transfers):
            if self.is_halted:
                self.reads.popleft().finish(errno.EPIPE)
            else:
                self._fill(self.reads[0])

    def _fill(self, read: Read) -> None:
        """Move bytes of the first transfer into the read, which may end it."""
        transfer = self.transfers[0]
        if len(transfer.rest) > read.room and read.room % self.packet:
            # A packet larger than what is left of the host's buffer is lost (babble).
            cut = min(len(transfer.rest), -(-read.room // self.packet) * self.packet)
            transfer.rest = transfer.rest[cut:]
            if not transfer.rest:
                self.transfers.popleft()
            self.reads.popleft().finish(errno.EOVERFLOW)
            return
        size = min(read.room, len(transfer.rest))
        is_short = size == len(transfer.rest) and size % self.packet != 0
        read.take(transfer.rest[:size])
        transfer.rest = transfer.rest[size:]
        if is_short:
            transfer.tail = False
        elif transfer.tail and not transfer.rest and read.room:
            transfer.tail, is_short = False, True
        if not transfer.rest and not transfer.tail:
            self.transfers.popleft()
        if is_short or not read.room:
            self.reads.popleft().finish()


def descriptors(data: bytes) -> Iterator[bytes]:
    """Yield the descriptors that lie one after another; a length that cannot be ends them."""
    while len(data) >= 2 and 2 <= data[0] <= len(data):
        yield data[: data[0]]
        data = data[data[0] :]


def endpoints(configuration: bytes) -> Iterator[Endpoint]:
    """Yield the endpoints of a configuration descriptor."""
    for each in descriptors(configuration):
        if each[1] == 5:
            _, _, address, attributes, packet, _ = struct.unpack_from("<BBBBHB", each)
            yield Endpoint(address, attributes & 3, packet & 0x7FF)
