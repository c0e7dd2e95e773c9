"""The kernel's own virtual host controller, `vhci_hcd`, reached through a socket pair.

The kernel takes one end of a stream socket through the driver's `attach` file and then speaks
USB/IP on it (Documentation/usb/usbip_protocol.rst): no TCP, no `usbip` tool.  Needs root and the
module; isochronous transfers are not there.
"""

from __future__ import annotations

import errno
import socket
import struct
import threading
from dataclasses import dataclass, field
from pathlib import Path

from camctl.errors import CameraNotFoundError
from sim.devices.usb.device import Refusal, Speed, UsbDevice
from sim.devices.usb.endpoints import Read

_CONTROLLER = Path("/sys/devices/platform/vhci_hcd.0")
_attaching = threading.Lock()  # from finding a free port to having it
_BUS = 1  # of the device id that the kernel sends back with each request
_FREE = 4  # VDEV_ST_NULL, in the `status` file

_SUBMIT, _UNLINK, _SUBMITTED, _UNLINKED = 1, 2, 3, 4
_HEADER = struct.Struct(">5I")  # command, sequence number, device, direction, endpoint
_HEADER_SIZE = 48
_PACKET_SIZE = 16  # of an isochronous packet's description


@dataclass(eq=False)
class _Line:
    """One connection to the kernel.

    Attributes:
        device: what is plugged in
        number: of the controller's port
        ours: our end of the socket pair
        reads: reads that wait, by sequence number
        requests: sequence numbers of control requests that are never answered
    """

    device: UsbDevice
    number: int
    ours: socket.socket
    reads: dict[int, Read] = field(default_factory=dict)
    requests: set[int] = field(default_factory=set)
    lock: threading.Lock = field(default_factory=threading.Lock)

    def answer(self, number: int, status: int, length: int, data: bytes = b"") -> None:
        """Send USBIP_RET_SUBMIT; `status` is an errno, `length` the bytes that were moved."""
        head = _HEADER.pack(_SUBMITTED, number, 0, 0, 0) + struct.pack(
            ">iiiii8x", -status, length, 0, 0, 0
        )
        self._send(head + data)

    def unlinked(self, number: int, status: int) -> None:
        """Send USBIP_RET_UNLINK; status 0: it had been answered before."""
        self._send(_HEADER.pack(_UNLINKED, number, 0, 0, 0) + struct.pack(">i24x", -status))

    def _send(self, data: bytes) -> None:
        try:
            with self.lock:
                self.ours.sendall(data)
        except OSError:
            pass  # unplugged meanwhile

    def serve(self) -> None:
        """Answer the kernel until either side ends it."""
        try:
            while True:
                self._serve_one()
        except (EOFError, OSError):
            pass
        finally:
            self.device.disconnect()
            self.ours.close()

    def _serve_one(self) -> None:
        head = self._receive(_HEADER_SIZE)
        command, number, _, is_in, endpoint = _HEADER.unpack_from(head)
        if command == _UNLINK:
            self._unlink(number, *struct.unpack_from(">I", head, 20))
            return
        _, length, _, packets, _ = struct.unpack_from(">Iiiii", head, 20)
        data = self._receive(length) if not is_in and length > 0 else b""
        if packets > 0:
            self._receive(_PACKET_SIZE * packets)
        if endpoint == 0:
            self._control(number, struct.unpack_from("<BBHHH", head, 40), data)
        elif is_in:
            self._read(number, endpoint, length)
        else:
            status = self.device.write(endpoint, data)
            self.answer(number, status, 0 if status else len(data))

    def _control(self, number: int, setup: tuple[int, int, int, int, int], data: bytes) -> None:
        answer = self.device.request(*setup, data)
        if answer is Refusal.SILENCE:
            self.requests.add(number)
        elif isinstance(answer, Refusal):
            self.answer(number, errno.EPIPE, 0)
        elif setup[0] & 0x80:
            self.answer(number, 0, len(answer), answer)
        else:
            self.answer(number, 0, len(data))

    def _read(self, number: int, endpoint: int, length: int) -> None:
        def done(error: int, data: bytes) -> None:
            self.reads.pop(number, None)
            self.answer(number, error, len(data), data)

        read = self.reads[number] = Read(endpoint, length, done)
        self.device.read(read)

    def _unlink(self, number: int, victim: int) -> None:
        """End a transfer; what it got so far goes up with it, as a real controller does."""
        if victim in self.requests:
            self.requests.discard(victim)
            self.unlinked(number, errno.ECONNRESET)
            return
        # Locked, for the kernel drops the device if a transfer's answer comes after its unlinking.
        with self.device.lock:
            if victim in self.reads:
                self.device.cancel(self.reads[victim])
            self.unlinked(number, 0)

    def _receive(self, size: int) -> bytes:
        data = bytearray()
        while len(data) < size:
            part = self.ours.recv(size - len(data))
            if not part:
                raise EOFError
            data += part
        return bytes(data)


class VhciPort:
    """A port of the kernel's virtual controller; whichever is free when a device is attached."""

    def __init__(self) -> None:
        self._line: _Line | None = None
        self._thread: threading.Thread | None = None

    def attach(self, device: UsbDevice) -> None:
        """Plug the device in; the kernel begins to ask for its descriptors.

        Raises:
            CameraNotFoundError: the module is not loaded, no port is free, or we are not root
        """
        if self._line is not None:
            self.detach()
        with _attaching:
            self._line, self._thread = _plug_in(device, _free_port(device.speed))

    def detach(self) -> None:
        """Pull the plug; returns when our side has let go."""
        line, thread, self._line = self._line, self._thread, None
        if line is None or thread is None:
            return
        # Already gone where the kernel ended it.
        try:
            (_CONTROLLER / "detach").write_text(str(line.number))
            line.ours.shutdown(socket.SHUT_RDWR)
        except OSError:
            pass
        if thread is not threading.current_thread():
            thread.join(timeout=5.0)


def _plug_in(device: UsbDevice, number: int) -> tuple[_Line, threading.Thread]:
    ours, kernels = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
    line = _Line(device, number, ours)
    device.connect()
    thread = threading.Thread(target=line.serve, name=f"vhci-{number}", daemon=True)
    thread.start()
    identity = _BUS << 16 | (number + 1)
    try:
        (_CONTROLLER / "attach").write_text(
            f"{number} {kernels.fileno()} {identity} {int(device.speed)}"
        )
    except OSError as error:
        ours.shutdown(socket.SHUT_RDWR)
        raise CameraNotFoundError(
            f"the kernel does not take a virtual device ({error.strerror})", hint="be root"
        ) from error
    finally:
        kernels.close()
    return line, thread


def _free_port(speed: Speed) -> int:
    hub = "ss" if speed is Speed.SUPER else "hs"
    try:
        status = (_CONTROLLER / "status").read_text(encoding="ascii")
    except OSError as error:
        raise CameraNotFoundError(
            "the kernel's virtual USB controller is not there", hint="modprobe vhci-hcd as root"
        ) from error
    for line in status.splitlines()[1:]:
        kind, number, state = line.split()[:3]
        if kind == hub and int(state) == _FREE:
            return int(number)
    raise CameraNotFoundError("no free port on the virtual USB controller", hint="detach a device")
