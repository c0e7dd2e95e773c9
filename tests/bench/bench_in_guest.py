"""What drivers cost beside other programs, through the kernel: V4L2 frames, files of PTP cameras.

    python tests/virtual_hardware/run.py --bench

Runs in a virtual machine, whose processor is emulated and whose clock counts instructions: only
ratios mean anything.  Processor time of a frame of 2 megapixels: the driver's own capture beside
OpenCV's, on the kernel's test driver vivid, which makes its frames in a thread of the kernel; both
deliver luma as an array of their own.  An object of 8 MB: the driver beside pyusb alone on the same
device, one GetObject, then reads of 1 MB.
"""

from __future__ import annotations

import itertools
import statistics
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import cv2
import usb.util
import virtual_devices as rig
from guest_processes import wait_for

from camctl.drivers.ptp.session import Session
from camctl.drivers.ptp.usb_transport import HEADER, UsbTransport
from camctl.drivers.v4l2.capture import Capture, StreamMode
from camctl.drivers.v4l2.formats import FORMATS
from camctl.drivers.v4l2.node import Node
from camctl.interface.clock import RealClock

SHAPE = (1080, 1920)
FRAMES, WARM_UP = 12, 4
OBJECT_BYTES = 8 * 1024 * 1024
BIG = rig.Device(
    "big", "ptp", {**rig.EIGHT_BITS, "files": ["jpeg"], "object_bytes": OBJECT_BYTES}, rig.LINEAR
)
MOST_OF_OPENCV, MOST_OF_PYUSB = 1.1, 2.0  # of their times
_GET_OBJECT, _OPEN_SESSION, _CLOSE_SESSION = 0x1009, 0x1002, 0x1003
_IN, _OUT, _CHUNK = 0x81, 0x02, 1 << 20


def main() -> int:
    """Print both ratios, and how many exposures overlap a transfer; return 1 beyond a limit."""
    subprocess.run(
        ["modprobe", "vivid", "n_devs=1", "node_types=0x1", "num_inputs=1", "input_types=0x0"],
        check=True,
    )
    wait_for("vivid", lambda: bool(list(Path("/sys/class/video4linux").glob("video*"))))
    path = f"/dev/{min(each.name for each in Path('/sys/class/video4linux').glob('video*'))}"
    of_opencv = _ratio("a frame", lambda: _own_frame_s(path), lambda: _opencv_frame_s(path), 5)
    with rig.running_hub([BIG]):
        with (
            rig.open_device(BIG) as camera,
            closing(camera.shoot([rig.setting(camera, 0.5)] * 4)) as frames,
        ):
            details = [frame.details for frame in frames]
        overlaps = sum(
            later["released_s"] < earlier["fetched_s"]
            for earlier, later in itertools.pairwise(details)
        )
        print(f"{overlaps} of {len(details) - 1} exposures began before the last download ended")
        handle = int(details[-1]["handle"], 16)
        of_pyusb = _ratio("8 MB", lambda: _own_object_s(handle), lambda: _pyusb_s(handle), 3)
    late = overlaps < len(details) - 1
    return int(of_opencv > MOST_OF_OPENCV or of_pyusb > MOST_OF_PYUSB or late)


def _ratio(what: str, own: Callable[[], float], other: Callable[[], float], rounds: int) -> float:
    """Print and return the ratio of the medians of both, which take turns."""
    spent = [(own(), other()) for _ in range(rounds)]
    own_s, other_s = (statistics.median(each) for each in zip(*spent, strict=True))
    print(f"{what}: {1000 * own_s:.2f} ms for {1000 * other_s:.2f} ms, {own_s / other_s:.2f}")
    return float(own_s / other_s)


def _own_frame_s(path: str) -> float:
    form = next(each for each in FORMATS if each.code == "YUYV")
    with Node(path) as node:
        interval_s = max(node.intervals(form.fourcc, SHAPE))
        with closing(Capture(node, StreamMode(form, SHAPE, interval_s))) as capture:

            def frame() -> object:
                capture.grab()
                return capture.retrieve()

            return _processor_s(frame)


def _opencv_frame_s(path: str) -> float:
    video = cv2.VideoCapture(path, cv2.CAP_V4L2)
    video.set(cv2.CAP_PROP_CONVERT_RGB, 0)
    video.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"YUYV"))
    video.set(cv2.CAP_PROP_FRAME_WIDTH, SHAPE[1])
    video.set(cv2.CAP_PROP_FRAME_HEIGHT, SHAPE[0])
    try:
        # The first of two bytes is luma.
        return _processor_s(lambda: video.read()[1].reshape(*SHAPE, 2)[:, :, 0].copy())
    finally:
        video.release()


def _processor_s(frame: Callable[[], object]) -> float:
    """Return the processor time that a frame takes, s; waiting for it takes none."""
    for _ in range(WARM_UP):
        assert frame() is not None
    began = time.process_time()
    for _ in range(FRAMES):
        assert frame() is not None
    return (time.process_time() - began) / FRAMES


def _own_object_s(handle: int) -> float:
    clock = RealClock()
    with closing(UsbTransport(rig.usb_device(BIG), "the camera", clock)) as transport:
        session = Session(transport, "the camera", clock)
        session.open()
        began = time.perf_counter()
        assert len(session.object(handle, OBJECT_BYTES)) == OBJECT_BYTES
        seconds = time.perf_counter() - began
        session.close()
    return seconds


def _pyusb_s(handle: int) -> float:
    device = rig.usb_device(BIG)

    def command(code: int, number: int, *parameters: int) -> None:
        body = struct.pack(f"<{len(parameters)}I", *parameters)
        device.write(_OUT, HEADER.pack(HEADER.size + len(body), 1, code, number) + body)

    def response() -> None:
        while not len(device.read(_IN, 512, 5000)):
            pass

    usb.util.claim_interface(device, 0)
    command(_OPEN_SESSION, 0, 1)
    response()
    began = time.perf_counter()
    command(_GET_OBJECT, 1, handle)
    left = OBJECT_BYTES + HEADER.size
    while left > 0:
        left -= len(device.read(_IN, _CHUNK, 5000))
    seconds = time.perf_counter() - began
    response()
    command(_CLOSE_SESSION, 2)
    response()
    usb.util.dispose_resources(device)
    return seconds


if __name__ == "__main__":
    sys.exit(main())
