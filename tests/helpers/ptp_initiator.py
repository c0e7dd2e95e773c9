"""A small PTP host (initiator) for tests of the virtual camera; it shares the device's clock."""

from __future__ import annotations

import struct
import threading
from collections import deque
from collections.abc import Sequence
from typing import Any

from camctl.sim.devices.clock import DeviceClock, VirtualDeviceClock
from camctl.sim.devices.ptp import camera as ptp
from camctl.sim.devices.usb.device import UsbDevice
from camctl.sim.devices.usb.endpoints import Read

OK, BUSY = 0x2001, 0x2019
TIMEOUT_S = 5.0
_POLL_S = 0.005

Container = tuple[int, int, bytes, int]  # type, code, body, transaction


class Initiator:
    """Writes containers to a device and reads its containers and events.

    Waits on the device's clock: with a virtual one they take no real time.
    """

    def __init__(self, device: UsbDevice) -> None:
        self.device = device
        self.transaction = 0
        self.events: deque[tuple[int, ...]] = deque()
        self._event_arrived = threading.Event()
        device.connect()
        self._read_event()

    def _read_event(self) -> None:
        def done(error: int, data: bytes) -> None:
            if data:
                length, kind, code, _ = struct.unpack_from("<IHHI", data)
                assert kind == 4
                assert length == len(data)
                self.events.append((code, *struct.unpack(f"<{(length - 12) // 4}I", data[12:])))
                self._event_arrived.set()
            if not error:
                self._read_event()

        self.device.read(Read(3, 64, done))

    def read(self, length: int = 1 << 24, timeout_s: float = TIMEOUT_S) -> tuple[int, bytes] | None:
        """Return (errno, bytes) of one read; None if nothing was sent within the time-out."""
        results: list[tuple[int, bytes]] = []
        ended = threading.Event()

        def done(error: int, data: bytes) -> None:
            results.append((error, data))
            ended.set()

        clock = self.device.clock
        read = Read(1, length, done)
        self.device.read(read)
        if clock.wait_for(ended, clock.now() + timeout_s):
            return results[0]
        self.device.cancel(read)
        return None

    def must_read(self, length: int = 1 << 24) -> tuple[int, bytes]:
        """Return (errno, bytes) of one read, which must end within the time-out."""
        result = self.read(length)
        assert result is not None, "the device sent nothing"
        return result

    def write(self, kind: int, code: int, body: bytes = b"") -> int:
        """Write a container of this type; return the errno."""
        header = struct.pack("<IHHI", 12 + len(body), kind, code, self.transaction)
        return self.device.write(2, header + body)

    def execute(
        self, code: int, *parameters: int, data: bytes | None = None
    ) -> tuple[int, tuple[int, ...], bytes | None]:
        """Return (response code, its parameters, data) of an operation."""
        assert self.write(1, code, struct.pack(f"<{len(parameters)}I", *parameters)) == 0
        if data is not None:
            assert self.write(2, code, data) == 0
        container = self.container()
        body = None
        if container[0] == 2:
            assert container[1] == code
            body = container[2]
            container = self.container()
        kind, response, rest, transaction = container
        assert kind == 3
        assert transaction == self.transaction
        self.transaction += 1
        return response, struct.unpack(f"<{len(rest) // 4}I", rest), body

    def response(self, code: int, *parameters: int, data: bytes | None = None) -> int:
        """Return the response code of an operation."""
        return self.execute(code, *parameters, data=data)[0]

    def container(self) -> Container:
        """Return the next container."""
        error, data = self.must_read()
        assert error == 0
        length, kind, code, transaction = struct.unpack_from("<IHHI", data)
        while len(data) < length:
            error, more = self.must_read()
            assert error == 0
            data += more
        assert len(data) == length
        return kind, code, data[12:], transaction

    def results(
        self, code: int, *parameters: int, data: bytes | None = None
    ) -> tuple[tuple[int, ...], bytes | None]:
        """Return (response parameters, data) of an operation that must succeed."""
        response, extra, body = self.execute(code, *parameters, data=data)
        assert response == OK, f"operation {code:04X}: response {response:04X}"
        return extra, body

    def do(self, code: int, *parameters: int, data: bytes | None = None) -> None:
        """Execute an operation that must succeed."""
        self.results(code, *parameters, data=data)

    def get(self, code: int, *parameters: int) -> bytes:
        """Return the data of an operation that must succeed and send data."""
        _, body = self.results(code, *parameters)
        assert body is not None, f"operation {code:04X}: no data"
        return body

    def do_when_ready(self, code: int, *parameters: int) -> None:
        """Repeat an operation while the device is busy; it must then succeed."""
        clock = self.device.clock
        deadline_s = clock.now() + TIMEOUT_S
        while (response := self.response(code, *parameters)) == BUSY:
            assert clock.now() < deadline_s, "the device stays busy"
            self.sleep(_POLL_S)
        assert response == OK

    def sleep(self, time_s: float) -> None:
        """Let the time pass on the device's clock."""
        clock = self.device.clock
        clock.sleep_until(clock.now() + time_s)

    def event(self) -> tuple[int, ...]:
        """Return (code, parameters ...) of the next event."""
        clock = self.device.clock
        deadline_s = clock.now() + TIMEOUT_S
        while not self.events:
            self._event_arrived.clear()
            if not self.events:
                assert clock.wait_for(self._event_arrived, deadline_s), "no event was sent"
        return self.events.popleft()

    def added_object(self) -> int:
        """Return the handle of the next object that is announced."""
        while True:
            code, handle, *_ = self.event()
            if code == 0x4002:
                return handle

    def shoot(self) -> bytes:
        """Take a picture by the standard operations and return the file."""
        self.do(0x100E, 0, 0)
        return self.get(0x1009, self.added_object())


def make_camera(clock: DeviceClock | None = None, **config: Any) -> ptp.PtpCamera:
    """Return a camera that sees a ramp; in virtual time unless a clock is given."""
    config = {"scene": "ramp", "sensor": "ideal-8", "size": "48x32", **config}
    return ptp.make(config, clock if clock is not None else VirtualDeviceClock())


def connected(**config: Any) -> tuple[ptp.PtpCamera, Initiator]:
    """Return a camera as `make_camera` does, and its host with an open session."""
    device = make_camera(**config)
    host = Initiator(device)
    host.do(0x1002, 1)
    return device, host


def numbers(data: bytes, kind: str = "I") -> Sequence[int]:
    """Return the elements of an array: a count, then as many numbers."""
    (count,) = struct.unpack_from("<I", data)
    assert len(data) == 4 + count * struct.calcsize(kind)
    return struct.unpack(f"<{count}{kind}", data[4:])
