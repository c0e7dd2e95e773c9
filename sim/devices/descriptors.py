"""USB descriptors as fields: the device's, and a configuration's tree of interfaces and endpoints.

Layouts and field names are those of USB 2.0, section 9.6.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from functools import lru_cache
from types import SimpleNamespace

from sim.devices.pipes import descriptors

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
