"""The sockets of a virtual camera in the network: it listens on 127.0.0.1."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from camctl.errors import UsageError
from sim.devices.clock import DeviceClock
from sim.devices.ptp.link import Connection, NetworkConfig
from sim.devices.ptp.network import NetworkCamera

HOST = "127.0.0.1"
_READ_BYTES = 1 << 16
_RESET = struct.pack("ii", 1, 0)  # SO_LINGER: closing a socket resets its connection


class TcpPort:
    """Where a camera listens while it is switched on.

    Args:
        camera: its attaching opens the port, and its detaching closes it

    Attributes:
        number: the port; the first attaching chooses it where the camera's options do not
    """

    def __init__(self, camera: NetworkCamera) -> None:
        self._camera = camera
        self.number = camera.config.port
        self._listener: socket.socket | None = None
        camera.is_attached = False
        camera.on_attach, camera.on_detach = self.open, self.close
        camera.port_number = lambda: self.number

    def open(self) -> None:
        """Listen.

        Raises:
            UsageError: the port is in use
        """
        listener = socket.socket()
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((HOST, self.number))
        except OSError as error:
            listener.close()
            raise UsageError(
                f"port {self.number} of {HOST} cannot be opened: {error.strerror}",
                hint="choose another port, or 0 for any",
            ) from None
        listener.listen()
        self.number = listener.getsockname()[1]
        self._listener = listener
        threading.Thread(target=self._accept, args=(listener,), daemon=True).start()

    def close(self) -> None:
        """Refuse new connections."""
        listener, self._listener = self._listener, None
        if listener is not None:
            with suppress(OSError):
                listener.shutdown(socket.SHUT_RDWR)  # wakes the thread that accepts
            listener.close()

    def _accept(self, listener: socket.socket) -> None:
        while True:
            try:
                link, _ = listener.accept()
            except OSError:
                return
            link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connection = self._camera.accept(_Socket(link))
            threading.Thread(target=_read, args=(link, connection), daemon=True).start()


class _Socket:
    def __init__(self, link: socket.socket) -> None:
        self._link = link

    def deliver(self, data: bytes) -> None:
        with suppress(OSError):  # the thread that reads notices it, too
            self._link.sendall(data)

    def end(self, *, is_reset: bool) -> None:
        with suppress(OSError):
            if is_reset:
                self._link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
            # The thread that reads is woken by this, and closes the socket.
            self._link.shutdown(socket.SHUT_RD if is_reset else socket.SHUT_RDWR)


def _read(link: socket.socket, connection: Connection) -> None:
    """Pass on what a host sends until it closes the connection."""
    with link, suppress(OSError):
        while data := link.recv(_READ_BYTES):
            connection.received(data)
    connection.lost()


def make(config: Mapping[str, Any], clock: DeviceClock | None = None) -> NetworkCamera:
    """Return the camera of a configuration (`NetworkConfig`); `attach` lets it listen.

    Raises:
        UsageError, DataError: an option is unknown or invalid
    """
    options = NetworkConfig.parse(config)
    camera = NetworkCamera(options, options.load_picture_sensor(), clock)
    TcpPort(camera)
    return camera
