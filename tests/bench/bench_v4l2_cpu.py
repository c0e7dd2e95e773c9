"""Processor time of a frame of 2 megapixels: the driver's own capture beside OpenCV's.

    python tests/virtual_hardware/run.py --bench

Runs in a virtual machine, on the kernel's test driver vivid, which makes its frames in a thread of
the kernel: the processor time of this process is that of taking frames alone.  Both deliver luma as
an array of their own; OpenCV's comes as YUYV (CAP_PROP_CONVERT_RGB = 0), of which the first of two
bytes is taken.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import cv2
from guest_processes import wait_for

from camctl.drivers.v4l2.capture import Capture, StreamMode
from camctl.drivers.v4l2.formats import FORMATS
from camctl.drivers.v4l2.node import Node

SHAPE = (1080, 1920)
FRAMES, ROUNDS, WARM_UP = 12, 5, 4
MOST_RATIO = 1.1


def main() -> int:
    """Print the processor time of a frame in both ways; return 1 if ours is more than 1.1 times."""
    subprocess.run(
        ["modprobe", "vivid", "n_devs=1", "node_types=0x1", "num_inputs=1", "input_types=0x0"],
        check=True,
    )
    wait_for("vivid", lambda: bool(list(Path("/sys/class/video4linux").glob("video*"))))
    path = f"/dev/{min(each.name for each in Path('/sys/class/video4linux').glob('video*'))}"
    ours, theirs = [], []
    for _ in range(ROUNDS):
        ours.append(_own(path))
        theirs.append(_opencv(path))
    own_s, opencv_s = statistics.median(ours), statistics.median(theirs)
    print(
        f"processor time of a frame: own capture {1000 * own_s:.2f} ms, OpenCV's "
        f"{1000 * opencv_s:.2f} ms, ratio {own_s / opencv_s:.2f}"
    )
    return int(own_s > MOST_RATIO * opencv_s)


def _own(path: str) -> float:
    form = next(each for each in FORMATS if each.code == "YUYV")
    with Node(path) as node:
        interval_s = max(node.intervals(form.fourcc, SHAPE))
        with closing(Capture(node, StreamMode(form, SHAPE, interval_s))) as capture:

            def frame() -> object:
                capture.grab()
                return capture.retrieve()

            return _processor_time(frame)


def _opencv(path: str) -> float:
    video = cv2.VideoCapture(path, cv2.CAP_V4L2)
    video.set(cv2.CAP_PROP_CONVERT_RGB, 0)
    video.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"YUYV"))
    video.set(cv2.CAP_PROP_FRAME_WIDTH, SHAPE[1])
    video.set(cv2.CAP_PROP_FRAME_HEIGHT, SHAPE[0])

    def frame() -> object:
        done, data = video.read()
        assert done
        return data.reshape(*SHAPE, 2)[:, :, 0].copy()

    try:
        return _processor_time(frame)
    finally:
        video.release()


def _processor_time(frame: Callable[[], object]) -> float:
    """Return the processor time that a frame takes, s; waiting for it takes none."""
    for _ in range(WARM_UP):
        assert frame() is not None
    began = time.process_time()
    for _ in range(FRAMES):
        assert frame() is not None
    return (time.process_time() - began) / FRAMES


if __name__ == "__main__":
    sys.exit(main())
