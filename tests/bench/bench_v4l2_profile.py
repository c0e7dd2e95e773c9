"""The picture of a webcam at full size after `camctl calibrate all`, beside what it promises.

    python tests/virtual_hardware/run.py -- python tests/bench/bench_v4l2_profile.py [WIDTHxHEIGHT]

Runs in a virtual machine: a virtual webcam, which says nothing of its curved response, streams
through the kernel's uvcvideo before a ramp of light.  `camctl calibrate all`, then `camctl shoot
--response linear -n 3`: each column of image.tiff against the promised brightness.  Takes minutes.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from dataclasses import replace

import virtual_devices as rig
from calibrated_webcam import calibrate_and_shoot
from guest_processes import CommandResult, spawner

from camctl.cli import main as camctl_main

LIMIT = 0.01
"""Largest difference from the promised brightness that is allowed, of full scale."""


def main() -> int:
    """Print what was measured; return 1 if the difference is above the limit."""
    parser = argparse.ArgumentParser()
    parser.add_argument("size", nargs="?", default="640x480", metavar="WIDTHxHEIGHT")
    size = parser.parse_args().size
    folder = tempfile.mkdtemp()
    os.environ.update(CAMCTL_PROFILES=f"{folder}/profiles", CAMCTL_CACHE=f"{folder}/cache")
    os.chdir(folder)
    spawner()  # in this folder, and before any thread runs
    webcam = replace(rig.CURVED, model={**rig.CURVED.model, "size": size})
    with rig.running_hub([webcam]):
        picture = calibrate_and_shoot(webcam, _run, "all")
    print(
        f"{size}: largest error of the response {picture.error:.4f} of full scale in "
        f"{picture.columns} columns, allowed {LIMIT:g}; {picture.effective_levels:.1f} effective "
        f"levels promised",
        flush=True,
    )
    return int(picture.error > LIMIT)


def _run(*words: object) -> CommandResult:
    """Run a command line of camctl in another process; print what it wrote."""
    began = time.monotonic()
    process = spawner().start(camctl_main, [str(word) for word in words])
    status = process.wait()
    seconds = time.monotonic() - began
    print(
        f"camctl {' '.join(map(str, words))}: status {status}, {seconds:.0f} s\n"
        f"{process.out}{process.err}",
        flush=True,
    )
    return CommandResult(status, process.out, process.err, seconds)


if __name__ == "__main__":
    sys.exit(main())
