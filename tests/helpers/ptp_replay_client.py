"""Our PTP transport and session on a recorded camera; run by test_ptp_recording.py.

Arguments: the recording (umockdev's .ioctl file).  Repeats the operations of gphoto2 that were
recorded, with our own session and parsers, and prints the results as one line of JSON.  Runs under
umockdev-run, which shows the recorded camera on the bus.
"""

from __future__ import annotations

import hashlib
import json
import struct
import sys
from dataclasses import dataclass
from pathlib import Path

import usb.core

from camctl.drivers.ptp.backend import PtpBackend
from camctl.drivers.ptp.codes import Op
from camctl.drivers.ptp.datasets import DeviceInfo, ObjectInfo, Reader
from camctl.drivers.ptp.session import Session
from camctl.drivers.ptp.usb_transport import UsbTransport
from camctl.interface.clock import RealClock
from camctl.stills.decoding import read_still

OUT, IN = "2", "129"
NAME = "the recorded camera"


class RecordedTransport(UsbTransport):
    """Reads in the sizes in which gphoto2 read, since the replay compares them."""

    def _piece(self, missing: int) -> int:
        return min(65536, missing // 512 * 512) or missing


@dataclass
class Command:
    """A recorded command, and the size of the first read after it."""

    code: int
    parameters: tuple[int, ...]
    first_read: int | None = None


def commands(recording: str) -> list[Command]:
    """Return all recorded commands."""
    found: list[Command] = []
    with Path(recording).open() as file:
        for line in file:
            words = line.split()
            if len(words) < 10 or not words[0].startswith("USBDEVFS_REAP"):
                continue
            if words[3] == OUT:
                data = bytes.fromhex(words[9])
                _, _, code, _ = struct.unpack_from("<IHHI", data)
                parameters = struct.unpack_from(f"<{len(data) // 4 - 3}I", data, 12)
                found.append(Command(code, parameters))
            elif words[3] == IN and found and found[-1].first_read is None:
                found[-1].first_read = int(words[6])
    return found


def described(code: int, data: bytes) -> object:
    """Return what our parsers make of the data of an operation, ready for JSON."""
    if code == Op.GET_DEVICE_INFO:
        info = DeviceInfo.parse(data)
        return f"{info.make}, {info.model}, {len(info.operations)} operations"
    if code == Op.GET_OBJECT_INFO:
        item = ObjectInfo.parse(data)
        return f"{item.name} {item.columns}x{item.rows} {item.size}"
    if code in (Op.GET_OBJECT_HANDLES, Op.GET_STORAGE_IDS):
        return [f"{handle:X}" for handle in Reader(data, "list").array(4)]
    if code == Op.GET_OBJECT:
        still = read_still(data, "IMG.JPG")
        return [list(still.pixels.shape), hashlib.sha256(data).hexdigest()]
    return f"{len(data)} bytes"


def main(recording: str) -> None:
    (found,) = PtpBackend().discover()
    clock = RealClock()
    transport = RecordedTransport(usb.core.find(idVendor=0x04A9), NAME, clock)
    session = Session(transport, NAME, clock)
    operations = []
    for command in commands(recording):
        if command.first_read != 512:
            break  # from here on recorded with a later gphoto2, which read 1024 bytes first
        data, code = b"", command.code
        if code == Op.OPEN_SESSION:
            session.open()
        elif code == Op.CLOSE_SESSION:
            session.close()
        else:
            task = f"perform operation {code:04X}"
            data = session.call(code, *command.parameters, task=task, repeatable=False).data
        operations.append([f"{code:04X}", described(code, data)])
        print(*operations[-1], file=sys.stderr)
    transport.close()
    result = {
        "id": found.id,
        "operations": operations,
        "recovered": session.times_recovered,
    }
    print(json.dumps(result))


if __name__ == "__main__":
    main(sys.argv[1])
