"""Overhead of each shot through `gphoto2:` beside the gphoto2 command line, on one virtual camera.

    python tests/bench/bench_gphoto2.py

The rival is Debian's program gphoto2, in one process for the whole bracket, with the virtual camera
of the package gphoto2 (its D750, whose exposures take no time): a shutter time is set, a picture is
taken and fetched for each frame.  camctl also decodes each picture and compares its exposure.  The
cost of a shot is that of a long bracket less that of a short one, over the difference in shots, so
that starting the programs does not count.
"""

from __future__ import annotations

import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np

from camctl.drivers.gphoto2.camera import Gphoto2Camera
from camctl.interface.controls import ExposureSetting

SHORT, LONG, ROUNDS = 1, 9, 3  # the virtual camera has room for 26
LABELS = ("0.0100s", "0.1000s", "0.0050s", "1.0000s")
TIMES_S = (0.01, 0.1, 0.005, 1.0)
MOST_RATIO, LEAST_RATE = 1.0, 1.0  # of our cost to the rival's; shots a second


def main() -> int:
    """Print the cost of a shot in both ways; return 1 if ours is higher than the limits."""
    program, package = shutil.which("gphoto2"), find_spec("gphoto2")
    if program is None or package is None or package.origin is None:
        print("skipped: it needs the program gphoto2 (apt-get install gphoto2) and the package")
        return 0
    library = Path(package.origin).parent / "libgphoto2"
    with ExitStack() as stack:
        work = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        folder = work / "card" / "DCIM" / "100NIKON"
        folder.mkdir(parents=True)
        noise = np.random.default_rng(1).integers(0, 255, (480, 640, 3)).astype(np.uint8)
        cv2.imwrite(str(folder / "picture.jpg"), noise)
        os.environ["VCAMERADIR"] = str(work / "card")
        os.environ["CAMCTL_PROFILES"] = str(work / "profiles")
        rival = {
            **os.environ,
            "IOLIBS": str(library / "vusb"),
            "CAMLIBS": str(library / "camlibs"),
            "LD_LIBRARY_PATH": str(library),
        }
        ours_s, theirs_s = [], []
        for _ in range(ROUNDS):
            ours_s.append((_ours(LONG) - _ours(SHORT)) / (LONG - SHORT))
            theirs_s.append(
                (_theirs(program, LONG, work, rival) - _theirs(program, SHORT, work, rival))
                / (LONG - SHORT)
            )
    ours, theirs = statistics.median(ours_s), statistics.median(theirs_s)
    print(
        f"a shot through gphoto2: {1000 * ours:.1f} ms, by the gphoto2 command line "
        f"{1000 * theirs:.1f} ms, ratio {ours / theirs:.2f}; {1 / ours:.1f} shots a second"
    )
    return int(ours > MOST_RATIO * theirs or 1 / ours < LEAST_RATE)


def _ours(shots: int) -> float:
    with Gphoto2Camera("usb:001,001") as camera:
        settings = [ExposureSetting(TIMES_S[i % 4]) for i in range(shots)]
        assert camera.controls.shape == (480, 640)
        began = time.perf_counter()
        assert len(list(camera.shoot(settings))) == shots
        return time.perf_counter() - began


def _theirs(program: str, shots: int, folder: Path, environment: dict[str, str]) -> float:
    words = [program, "--quiet", "--force-overwrite", "--filename", str(folder / "%n.jpg")]
    for index in range(shots):
        words += ["--set-config", f"shutterspeed={LABELS[index % 4]}"]
        words += ["--capture-image-and-download"]
    began = time.perf_counter()
    subprocess.run(words, env=environment, check=True, capture_output=True)
    return time.perf_counter() - began


if __name__ == "__main__":
    sys.exit(main())
