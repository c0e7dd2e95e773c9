"""A host for PTP as small as can be: for tests of the virtual camera, and nothing else."""

import queue
import struct
import time
from contextlib import contextmanager

from sim.devices.ptp import camera as ptp
from sim.devices.usb.endpoints import Read

OK, BUSY = 0x2001, 0x2019
TIMEOUT_S = 5.0


class Initiator:
    """Writes containers to a device and reads what comes, packet rules included."""

    def __init__(self, device):
        self.device = device
        self.transaction = 0
        self.events = queue.Queue()
        device.connect()
        self._listen()

    def _listen(self):
        def came(error, data):
            if data:
                length, kind, code, _ = struct.unpack_from("<IHHI", data)
                assert kind == 4
                assert length == len(data)
                self.events.put((code, *struct.unpack(f"<{(length - 12) // 4}I", data[12:])))
            if not error:
                self._listen()

        self.device.read(Read(3, 64, came))

    def read(self, length=1 << 24, timeout_s=TIMEOUT_S):
        """Return (errno, bytes) of one read; None where nothing came in time."""
        came = queue.Queue()
        read = Read(1, length, lambda error, data: came.put((error, data)))
        self.device.read(read)
        try:
            return came.get(timeout=timeout_s)
        except queue.Empty:
            self.device.cancel(read)
            return None

    def write(self, kind, code, body=b""):
        header = struct.pack("<IHHI", 12 + len(body), kind, code, self.transaction)
        return self.device.write(2, header + body)

    def ask(self, code, *parameters, data=None):
        """Return (response code, its parameters, data) of an operation."""
        assert self.write(1, code, struct.pack(f"<{len(parameters)}I", *parameters)) == 0
        if data is not None:
            assert self.write(2, code, data) == 0
        came = self.container()
        body = None
        if came[0] == 2:
            assert came[1] == code
            body = came[2]
            came = self.container()
        kind, answer, rest, transaction = came
        assert kind == 3
        assert transaction == self.transaction
        self.transaction += 1
        return answer, struct.unpack(f"<{len(rest) // 4}I", rest), body

    def container(self):
        """Return (kind, code, body, transaction) of the next container."""
        error, data = self.read() or (None, None)
        assert error == 0, "nothing came"
        length, kind, code, transaction = struct.unpack_from("<IHHI", data)
        while len(data) < length:
            error, more = self.read()
            assert error == 0
            data += more
        assert len(data) == length
        return kind, code, data[12:], transaction

    def good(self, code, *parameters, data=None):
        """Return the data of an operation that must succeed; else its response's parameters."""
        answer, extra, body = self.ask(code, *parameters, data=data)
        assert answer == OK, f"operation {code:04X}: {answer:04X}"
        return extra if body is None else body

    def patiently(self, code, *parameters, data=None):
        """Do an operation again while the device is busy."""
        deadline = time.monotonic() + TIMEOUT_S
        while time.monotonic() < deadline:
            answer, extra, body = self.ask(code, *parameters, data=data)
            if answer != BUSY:
                assert answer == OK
                return extra if body is None else body
            time.sleep(0.005)
        raise AssertionError("busy for ever")

    def event(self, timeout_s=TIMEOUT_S):
        return self.events.get(timeout=timeout_s)

    def added(self):
        """Return the handle of the next object that is announced."""
        while True:
            code, handle, *_ = self.event()
            if code == 0x4002:
                return handle

    def shoot(self):
        """Take a picture as the standard has it and return the file."""
        self.good(0x100E, 0, 0)
        return self.good(0x1009, self.added())


@contextmanager
def camera(**config):
    """Yield a camera that sees a ramp, and its host with an open session."""
    config = {"scene": "ramp", "sensor": "ideal-8", "size": "48x32", **config}
    device = ptp.make(config)
    host = Initiator(device)
    host.good(0x1002, 1)
    try:
        yield device, host
    finally:
        device.body.end_bulb()
        device.body.wait()


def numbers(data, kind="I"):
    """Return a list of PTP: a count, then as many numbers."""
    (count,) = struct.unpack_from("<I", data)
    assert len(data) == 4 + count * struct.calcsize(kind)
    return list(struct.unpack(f"<{count}{kind}", data[4:]))
