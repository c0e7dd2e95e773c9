"""USB descriptors of a still camera: USB still image capture device class 1.0, section 4."""

from __future__ import annotations

import struct

from sim.devices.ptp_config import Identity
from sim.devices.usb import IN

BULK_IN, BULK_OUT, EVENTS = 1, 2, 3  # numbers of the endpoints
PACKET = 512

_CLASS = (6, 1, 1)  # still image, capture, PTP
_BULK, _INTERRUPT = 2, 3


def device_descriptor(who: Identity) -> bytes:
    """Return 18 bytes; strings 1 to 3 are make, model and serial number."""
    head = struct.pack("<BBHBBBB", 18, 1, 0x200, 0, 0, 0, 64)
    return head + struct.pack("<HHHBBBB", who.vendor_id, who.product_id, 0x100, 1, 2, 3, 1)


def configuration_descriptor() -> bytes:
    """Return the configuration: one interface with three endpoints."""
    parts = struct.pack("<9B", 9, 4, 0, 0, 3, *_CLASS, 0)
    parts += struct.pack("<BBBBHB", 7, 5, BULK_IN | IN, _BULK, PACKET, 0)
    parts += struct.pack("<BBBBHB", 7, 5, BULK_OUT, _BULK, PACKET, 0)
    parts += struct.pack("<BBBBHB", 7, 5, EVENTS | IN, _INTERRUPT, 64, 6)
    return struct.pack("<BBHBBBBB", 9, 2, 9 + len(parts), 1, 1, 0, 0xC0, 1) + parts
