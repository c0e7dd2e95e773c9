"""A virtual camera in the network with our driver on it: in virtual time, or over TCP."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from ptp_bench import virtual_sensor

from camctl.drivers.ptp.network_backend import NetworkCamera, NetworkOptions
from camctl.drivers.ptp.network_link import Address, Link
from camctl.drivers.ptp.network_transport import Caller, NetworkTransport
from camctl.sim.devices.clock import VirtualDeviceClock
from camctl.sim.devices.ptp.link import Listener, NetworkConfig
from camctl.sim.devices.ptp.network import NetworkCamera as VirtualCamera

CALLER = Caller(bytes(range(16)))


class HostConnection:
    """A connection to a camera in this process, in the time of the camera's clock.

    Args:
        camera: the camera

    Raises:
        ConnectionRefusedError: it is switched off
    """

    def __init__(self, camera: Listener) -> None:
        if not camera.is_attached:
            raise ConnectionRefusedError
        self._clock = camera.clock
        self._received = bytearray()
        self._end: bool | None = None  # whether it was reset
        self._changed = threading.Event()
        self._connection = camera.accept(self)

    def deliver(self, data: bytes) -> None:
        self._received += data
        self._changed.set()

    def end(self, *, is_reset: bool) -> None:
        self._end = is_reset
        self._changed.set()

    def send(self, data: bytes, timeout_s: float) -> None:
        """Send bytes to the camera (ConnectionResetError: it has closed the connection)."""
        if self._end is not None:
            raise ConnectionResetError
        self._connection.received(data)

    def receive(self, size: int, timeout_s: float) -> bytes:
        """Return up to `size` bytes; b"" at the end (TimeoutError: none came)."""
        self._changed.clear()
        if not self._received and self._end is None:
            self._clock.wait_for(self._changed, self._clock.now() + timeout_s)
        if self._received:
            part = bytes(self._received[:size])
            del self._received[:size]
            return part
        if self._end is None:
            raise TimeoutError
        if self._end:
            raise ConnectionResetError
        return b""

    def close(self) -> None:
        if self._end is None:
            self._end = False
            self._connection.lost()


def virtual_camera(sensor: str = "ideal-8", scene: str = "ramp", **config: Any) -> VirtualCamera:
    """Return a camera in the network, in virtual time."""
    return VirtualCamera(
        NetworkConfig(**config), virtual_sensor(scene, sensor), VirtualDeviceClock()
    )


def our_camera(device: VirtualCamera, **options: Any) -> NetworkCamera:
    """Return our camera on it, not opened (linear response unless given)."""

    def connect(address: Address) -> Link:
        return HostConnection(device)

    parsed = NetworkOptions.parse({"response": "linear", **options})
    return NetworkCamera("10.0.0.1", parsed, clock=device.clock, connect=connect)


def transport_on(device: VirtualCamera) -> NetworkTransport:
    """Return our transport, connected to a camera."""
    return NetworkTransport(
        Address("10.0.0.1"), lambda address: HostConnection(device), CALLER, device.clock
    )


@contextmanager
def camera_on_network(
    options: dict[str, Any] | None = None, **config: Any
) -> Iterator[tuple[NetworkCamera, VirtualCamera]]:
    """Yield (our camera, the virtual one) in virtual time."""
    device = virtual_camera(**config)
    with our_camera(device, **(options or {})).open() as camera:
        yield camera, device


@contextmanager
def camera_on_tcp(scene: str = "ramp", **config: Any) -> Iterator[tuple[VirtualCamera, int]]:
    """Yield a camera that listens on 127.0.0.1, in real time, and its port."""
    device = VirtualCamera(NetworkConfig(**config), virtual_sensor(scene))
    port = device.listen()
    device.attach()
    try:
        yield device, port.number
    finally:
        device.detach()
