"""A virtual CoolPix on a line that tests damage, and our session on it, in virtual time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from camctl.drivers.common.serial_link import SerialLink
from camctl.drivers.coolpix.sierra.session import Sierra
from camctl.sim.devices.clock import VirtualDeviceClock
from camctl.sim.devices.sierra.device import make
from camctl.sim.devices.sierra.protocol_memory import MemoryLine
from camctl.sim.devices.still_body import ImageFile

NUL, ACK, DC1, END = b"\0", b"\x06", b"\x11", b"\xff"
PICTURE = bytes(range(256)) * 20


class Camera(MemoryLine):
    """A camera with pictures of these bytes on its card, and the line to it.

    Tests replace `receive`, which is called with what the host sends, and `transmit`, which returns
    what becomes of an answer.

    Attributes:
        sent: how many bytes went to the host
    """

    clock: VirtualDeviceClock

    def __init__(self, *pictures: bytes, **config: Any) -> None:
        super().__init__(lambda data: self.receive(data), VirtualDeviceClock())
        own = {"scene": "ramp", "sensor": "ideal-8", "size": "8x8", "line": "memory", **config}
        self.device = make(own, self.clock)
        self.device.line = self
        self.device.camera.pictures += [
            ImageFile("jpeg", "DSCN0001.JPG", data, 8, 8, 24) for data in pictures
        ]
        self.device.attach()
        self.sent = 0
        self.receive: Callable[[bytes], None] = self.device.received
        self.transmit: Callable[[bytes], bytes] = lambda answer: answer

    def send(self, data: bytes, speed: int = 0) -> None:
        damaged = self.transmit(data)
        self.sent += len(damaged)
        super().send(damaged)

    def link(self) -> SerialLink:
        return SerialLink(self.path, 19200)


def session(camera: Camera, **arguments: Any) -> Sierra:
    sierra = Sierra(camera.link(), camera.clock, **arguments)
    sierra.open()
    return sierra
