"""Frames that a list of exposures costs on V4L2: n + d where the control delay is d.

    python tests/virtual_hardware/run.py --bench

Runs in the laboratory's guest: a virtual camera with a delay of 0 to 5 frames streams through the
kernel's uvcvideo.  Frames used are those whose exposure began after the first setting was written,
up to the last one that was handed over, by the device's own slots and by the driver's timestamps.
"""

from __future__ import annotations

import sys

import virtual_devices as rig

DELAYS = range(6)


def main() -> int:
    """Print frames used over n + d; return 1 unless all are 1."""
    process, hub = rig.start_devices([rig.WEB])
    off = 0
    try:
        for delay in DELAYS:
            with rig.delayed(hub, rig.WEB, delay):
                used = rig.frames_used(hub, rig.WEB)
            ratio = used.frames / (used.settings + delay)
            off += ratio != 1
            print(
                f"d = {delay}: {used.frames} frames for {used.settings} exposures, "
                f"frames / (n + d) = {ratio:.2f}"
            )
    finally:
        process.terminate()
        process.wait(10)
    return int(off > 0)


if __name__ == "__main__":
    sys.exit(main())
