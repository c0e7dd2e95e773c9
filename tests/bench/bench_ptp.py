"""How fast pictures come from a PTP camera: overlap, and an 8 MB object against a bare read loop.

    python tests/virtual_hardware/run.py --bench

Runs in a virtual machine, through usbfs and libusb.  The bare loop is pyusb alone on the same
device in the same run: one GetObject, then reads of 1 MB until the object is complete.  Only the
ratio of the two speeds means anything: the machine is emulated, and its clock counts instructions.
"""

from __future__ import annotations

import itertools
import statistics
import struct
import sys
import time
from contextlib import closing

import usb.core
import usb.util
import virtual_devices as rig

from camctl.drivers.ptp.session import Session
from camctl.drivers.ptp.usb_transport import HEADER, UsbTransport
from camctl.interface.clock import RealClock

OBJECT_BYTES = 8 * 1024 * 1024
ROUNDS = 3
LEAST_RATIO = 0.5  # of our speed to the bare loop's
BIG = rig.Device(
    "big", "ptp", {**rig.EIGHT_BITS, "files": ["jpeg"], "object_bytes": OBJECT_BYTES}, rig.LINEAR
)
_GET_OBJECT, _OPEN_SESSION, _CLOSE_SESSION = 0x1009, 0x1002, 0x1003
_IN, _OUT, _CHUNK = 0x81, 0x02, 1 << 20


def main() -> int:
    """Print overlap and throughput; return 1 if either is not good enough."""
    with rig.running_hub([BIG]):
        with rig.open_device(BIG) as camera:
            settings = [rig.setting(camera, 0.5)] * 4
            with closing(camera.shoot(settings)) as frames:
                details = [frame.details for frame in frames]
        overlaps = sum(
            later["released_s"] < earlier["fetched_s"]
            for earlier, later in itertools.pairwise(details)
        )
        print(f"{overlaps} of {len(details) - 1} exposures began before the last download ended")
        handle = int(details[-1]["handle"], 16)
        bare_s, ours_s = [], []
        for _ in range(ROUNDS):
            bare_s.append(_bare(handle))
            ours_s.append(_ours(handle))
    bare, ours = (OBJECT_BYTES / 1e6 / statistics.median(each) for each in (bare_s, ours_s))
    print(
        f"bare pyusb loop {bare:6.1f} MB/s, drivers.ptp {ours:6.1f} MB/s, ratio {ours / bare:.2f}"
    )
    return int(overlaps < len(details) - 1 or ours / bare < LEAST_RATIO)


def _ours(handle: int) -> float:
    clock = RealClock()
    transport = UsbTransport(rig.usb_device(BIG), "the camera", clock)
    session = Session(transport, "the camera", clock)
    session.open()
    began = time.perf_counter()
    data = session.object(handle, OBJECT_BYTES)
    seconds = time.perf_counter() - began
    assert len(data) == OBJECT_BYTES
    session.close()
    transport.close()
    return seconds


def _bare(handle: int) -> float:
    device = rig.usb_device(BIG)
    usb.util.claim_interface(device, 0)
    _transaction(device, _OPEN_SESSION, 0, 1)
    began = time.perf_counter()
    _command(device, _GET_OBJECT, 1, handle)
    left = OBJECT_BYTES + HEADER.size
    while left > 0:
        left -= len(device.read(_IN, _CHUNK, 5000))
    seconds = time.perf_counter() - began
    _response(device)
    _transaction(device, _CLOSE_SESSION, 2)
    usb.util.dispose_resources(device)
    return seconds


def _command(device: usb.core.Device, code: int, number: int, *parameters: int) -> None:
    body = struct.pack(f"<{len(parameters)}I", *parameters)
    device.write(_OUT, HEADER.pack(HEADER.size + len(body), 1, code, number) + body)


def _response(device: usb.core.Device) -> None:
    while not len(device.read(_IN, 512, 5000)):
        pass


def _transaction(device: usb.core.Device, code: int, number: int, *parameters: int) -> None:
    _command(device, code, number, *parameters)
    _response(device)


if __name__ == "__main__":
    sys.exit(main())
