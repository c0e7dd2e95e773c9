"""Frames that a list of exposures takes on V4L2: n + d where the control delay is d.

    python tests/virtual_hardware/run.py --bench

Runs in a virtual machine: a virtual camera with a delay of 0 to 5 frames streams through the
kernel's uvcvideo.  Counted are the frames whose exposure began after the first setting was written,
up to the last one that was delivered, by the device's own slots and by the driver's timestamps.
"""

from __future__ import annotations

import sys

import virtual_devices as rig

DELAYS = range(6)


def main() -> int:
    """Print frames / (n + d); return 1 unless all are 1."""
    wrong = 0
    with rig.running_hub([rig.WEB]) as hub:
        for delay in DELAYS:
            with rig.control_delay(hub, rig.WEB, delay):
                cost = rig.frame_cost(hub, rig.WEB)
            expected = cost.settings + delay
            wrong += not cost.frames == cost.by_timestamps == expected
            print(
                f"d = {delay}: {cost.frames} frames for {cost.settings} exposures, by timestamps "
                f"{cost.by_timestamps}, frames / (n + d) = {cost.frames / expected:.2f}"
            )
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
