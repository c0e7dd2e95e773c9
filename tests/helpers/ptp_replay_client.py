"""Our PTP transport and protocol on a recorded camera; run by test_ptp_recording.py.

Arguments: the recording (umockdev's .ioctl file).  Repeats what gphoto2 asked of the camera when
the recording was made, through our own session and parsers, and prints what came as one line of
JSON.  Runs under umockdev-run, which shows the recorded camera on the bus.
"""

import hashlib
import json
import struct
import sys
from pathlib import Path

import usb.core

from drivers.common.still_file import read_still
from drivers.ptp.backend import PtpBackend
from drivers.ptp.codes import Op
from drivers.ptp.datasets import DeviceInfo, ObjectInfo, Reader
from drivers.ptp.session import Session
from drivers.ptp.transport import UsbTransport

OUT, IN = "2", "129"


class RecordedCuts(UsbTransport):
    """Reads in the pieces in which gphoto2 read, since the replay matches their lengths."""

    def _piece(self, missing):
        return min(65536, missing // 512 * 512) or missing


def commands(recording):
    """Return (operation, transaction, parameters, how it was read first) of all commands."""
    found = []
    with Path(recording).open() as file:
        for line in file:
            words = line.split()
            if len(words) < 10 or not words[0].startswith("USBDEVFS_REAP"):
                continue
            if words[3] == OUT:
                data = bytes.fromhex(words[9])
                _, _, code, number = struct.unpack_from("<IHHI", data)
                parameters = struct.unpack_from(f"<{len(data) // 4 - 3}I", data, 12)
                found.append([code, number, parameters, None])
            elif words[3] == IN and found and found[-1][3] is None:
                found[-1][3] = int(words[6])
    return found


def main(recording):
    (found,) = PtpBackend().discover()
    result = {"id": found.id, "make": found.make, "serial": found.serial, "operations": []}
    device = usb.core.find(idVendor=0x04A9)
    session = None
    for code, _, parameters, first in commands(recording):
        if first != 512:
            break  # from here on with a later gphoto2, which read 1024 bytes first
        if code == Op.OPEN_SESSION:
            if session is None:
                transport = RecordedCuts(device, "the recorded camera")
                session = Session(transport, "the recorded camera", silence_s=2, busy_s=2)
            session.open()
            data = b""
        elif code == Op.CLOSE_SESSION:
            session.close()
            data = b""
        else:
            data = session.call(code, *parameters, doing=f"{code:04X}", repeatable=False).data
        said = f"{len(data)} bytes"
        if code == Op.GET_DEVICE_INFO:
            info = DeviceInfo.parse(data)
            said = f"{info.make}, {info.model}, {len(info.operations)} operations"
        elif code == Op.GET_OBJECT_INFO:
            object_info = ObjectInfo.parse(data)
            said = f"{object_info.name} {object_info.columns}x{object_info.rows} {object_info.size}"
        elif code in (Op.GET_OBJECT_HANDLES, Op.GET_STORAGE_IDS):
            said = [f"{handle:X}" for handle in Reader(data, "list").array(4)]
        elif code == Op.GET_OBJECT:
            still = read_still(data, "IMG.JPG")
            said = [list(still.pixels.shape), hashlib.sha256(data).hexdigest()]
        result["operations"].append([f"{code:04X}", said])
        print(f"{code:04X} {said}", file=sys.stderr)
    result["recovered"] = session.times_recovered
    transport.close()
    print(json.dumps(result))


if __name__ == "__main__":
    main(sys.argv[1])
