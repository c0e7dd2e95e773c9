"""A port of the Linux kernel's virtual USB host controller, `vhci_hcd`.

One end of a socket pair is given to the kernel through the driver's `attach` file; the kernel then
speaks USB/IP on it (Documentation/usb/usbip_protocol.rst).  Needs root and the module vhci-hcd.
Isochronous transfers are not supported.
"""

from __future__ import annotations

import errno
import socket
import struct
import threading
from dataclasses import dataclass, field
from pathlib import Path

from camctl.errors import CameraNotFoundError
from camctl.sim.devices.usb.device import IN, ControlFailure, Speed, UsbDevice
from camctl.sim.devices.usb.endpoints import Read

_CONTROLLER = Path("/sys/devices/platform/vhci_hcd.0")
_attaching = threading.Lock()  # held from finding a free port until it is used
_BUS = 1  # part of the device id, which the kernel sends with each request
_DETACH_S = 5.0  # for the kernel to end a connection
_FREE = 4  # VDEV_ST_NULL in the `status` file

_CMD_SUBMIT, _CMD_UNLINK, _RET_SUBMIT, _RET_UNLINK = 1, 2, 3, 4  # commands
_HEADER = struct.Struct(">5I")  # command, sequence number, device, direction, endpoint
_PACKET_SIZE = 16  # of an isochronous packet's description


@dataclass(eq=False)
class UsbIpConnection:
    """A connection between a device and the kernel: the device's side of USB/IP.

    Attributes:
        device: the device
        port: number of the controller's port
        channel: this end of the socket pair
        reads: waiting reads by sequence number
        unanswered: sequence numbers of control requests without a reply
        last_submitted: sequence number of the last transfer; they increase
        early_unlinks: unlink requests that came before their transfer: their own sequence number by
            the number of the transfer
    """

    device: UsbDevice
    port: int
    channel: socket.socket
    reads: dict[int, Read] = field(default_factory=dict)
    unanswered: set[int] = field(default_factory=set)
    last_submitted: int = 0
    early_unlinks: dict[int, int] = field(default_factory=dict)
    lock: threading.Lock = field(default_factory=threading.Lock)

    def send_result(self, number: int, status: int, length: int, data: bytes = b"") -> None:
        """Send USBIP_RET_SUBMIT; `status` is an errno, `length` the number of bytes moved."""
        head = _HEADER.pack(_RET_SUBMIT, number, 0, 0, 0) + struct.pack(
            ">iiiii8x", -status, length, 0, 0, 0
        )
        self._send(head + data)

    def send_unlinked(self, number: int, status: int) -> None:
        """Send USBIP_RET_UNLINK; `status` is an errno, 0 if the result had been sent before."""
        self._send(_HEADER.pack(_RET_UNLINK, number, 0, 0, 0) + struct.pack(">i24x", -status))

    def _send(self, data: bytes) -> None:
        try:
            with self.lock:
                self.channel.sendall(data)
        except OSError:
            pass  # the device has been unplugged meanwhile

    def serve(self) -> None:
        """Serve requests of the kernel until either side ends the connection."""
        try:
            while True:
                self._serve_one()
        except (EOFError, OSError):
            pass
        finally:
            self.device.disconnect()
            self.channel.close()

    def _serve_one(self) -> None:
        head = self._receive(48)
        command, number, _, is_in, endpoint = _HEADER.unpack_from(head)
        if command == _CMD_UNLINK:
            self._unlink(number, *struct.unpack_from(">I", head, 20))
            return
        _, length, _, packets, _ = struct.unpack_from(">Iiiii", head, 20)
        data = self._receive(length) if not is_in and length > 0 else b""
        if packets > 0:
            self._receive(_PACKET_SIZE * packets)
        self.last_submitted = number
        if number in self.early_unlinks:
            self.send_result(number, errno.ECONNRESET, 0)
            self.send_unlinked(self.early_unlinks.pop(number), 0)
        elif endpoint == 0:
            self._control(number, struct.unpack_from("<BBHHH", head, 40), data)
        elif is_in:
            self._read(number, endpoint, length)
        else:
            status = self.device.write(endpoint, data)
            self.send_result(number, status, 0 if status else len(data))

    def _control(self, number: int, setup: tuple[int, int, int, int, int], data: bytes) -> None:
        reply = self.device.request(*setup, data)
        if reply is ControlFailure.NO_REPLY:
            self.unanswered.add(number)
        elif isinstance(reply, ControlFailure):
            self.send_result(number, errno.EPIPE, 0)
        elif setup[0] & IN:
            self.send_result(number, 0, len(reply), reply)
        else:
            self.send_result(number, 0, len(data))

    def _read(self, number: int, endpoint: int, length: int) -> None:
        def done(error: int, data: bytes) -> None:
            self.reads.pop(number, None)
            self.send_result(number, error, len(data), data)

        read = self.reads[number] = Read(endpoint, length, done)
        self.device.read(read)

    def _unlink(self, number: int, cancelled: int) -> None:
        """Cancel a transfer; the bytes it has are sent first, as by a real controller."""
        if cancelled > self.last_submitted:
            # The kernel's sender takes new transfers and unlink requests from two queues, so the
            # request may be the first.  A reply to it now would end the transfer for the kernel,
            # which then drops a device that sends the transfer's result.
            self.early_unlinks[cancelled] = number
            return
        if cancelled in self.unanswered:
            self.unanswered.discard(cancelled)
            self.send_unlinked(number, errno.ECONNRESET)
            return
        # With the lock, since the kernel drops a device that sends a result after the unlinking.
        with self.device.lock:
            if cancelled in self.reads:
                self.device.cancel(self.reads[cancelled])
            self.send_unlinked(number, 0)

    def _receive(self, size: int) -> bytes:
        data = bytearray()
        while len(data) < size:
            part = self.channel.recv(size - len(data))
            if not part:
                raise EOFError
            data += part
        return bytes(data)


class VhciPort:
    """A port of the kernel's virtual controller: the one that is free when a device is attached."""

    def __init__(self) -> None:
        self._connection: UsbIpConnection | None = None
        self._thread: threading.Thread | None = None

    def attach(self, device: UsbDevice) -> None:
        """Plug the device in; the kernel then reads its descriptors.

        Raises:
            CameraNotFoundError: the module is not loaded, no port is free, or this is not root
        """
        self.detach()
        with _attaching:
            self._connection, self._thread = _plug_in(device, _free_port(device.speed))

    def detach(self) -> None:
        connection, thread, self._connection = self._connection, self._thread, None
        if connection is None or thread is None:
            return
        try:
            (_CONTROLLER / "detach").write_text(str(connection.port))
            connection.channel.shutdown(socket.SHUT_RDWR)
        except OSError:
            pass  # the kernel has ended the connection already
        if thread is not threading.current_thread():
            thread.join(timeout=_DETACH_S)


def _plug_in(device: UsbDevice, port: int) -> tuple[UsbIpConnection, threading.Thread]:
    ours, of_kernel = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
    connection = UsbIpConnection(device, port, ours)
    device.connect()
    thread = threading.Thread(target=connection.serve, name=f"vhci-{port}", daemon=True)
    thread.start()
    device_id = _BUS << 16 | (port + 1)
    try:
        (_CONTROLLER / "attach").write_text(
            f"{port} {of_kernel.fileno()} {device_id} {int(device.speed)}"
        )
    except OSError as error:
        ours.shutdown(socket.SHUT_RDWR)
        raise CameraNotFoundError(
            f"the kernel refused a virtual USB device ({error.strerror})", hint="run as root"
        ) from error
    finally:
        of_kernel.close()
    return connection, thread


def _free_port(speed: Speed) -> int:
    hub = "ss" if speed is Speed.SUPER else "hs"
    try:
        status = (_CONTROLLER / "status").read_text(encoding="ascii")
    except OSError as error:
        raise CameraNotFoundError(
            "this kernel has no virtual USB controller", hint="run modprobe vhci-hcd as root"
        ) from error
    for line in status.splitlines()[1:]:
        kind, number, state = line.split()[:3]
        if kind == hub and int(state) == _FREE:
            return int(number)
    raise CameraNotFoundError(
        "the virtual USB controller has no free port", hint="detach another device"
    )
