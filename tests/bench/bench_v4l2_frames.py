"""Frames that a list of exposures takes on V4L2, over n + d, in virtual time; and what faults cost.

    python tests/bench/bench_v4l2_frames.py

A model of a webcam and its kernel driver streams 10 frames a second with a control delay of d
frames.  Counted are its slots from the first that began after the first setting was written to the
last one whose frame was used.  The faults: a frame with the driver's error flag, a short frame, one
that was lost on its way, each in the middle of the list.  `bench_v4l2.py` counts the same through
the kernel's uvcvideo, in a virtual machine.
"""

from __future__ import annotations

import os
import random
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "helpers"))

from v4l2_bench import exposures, open_streaming, save_delay, settings
from v4l2_model import Model

LISTS, FAULTY_LISTS, COUNT = 8, 3, 16
FAULTS = {"flag": "error flag", "damage": "short frame", "lose": "lost frame"}


def main() -> int:
    """Print a line for each delay; return 1 unless frames / (n + d) is 1 everywhere."""
    wrong = 0
    with tempfile.TemporaryDirectory() as folder:
        os.environ["CAMCTL_PROFILES"] = folder
        for delay in range(6):
            save_delay(delay)
            used = {_slots(delay, seed, None) for seed in range(LISTS)}
            wrong += used != {COUNT + delay}
            faulty = {
                words: max(_slots(delay, seed, fault) for seed in range(FAULTY_LISTS))
                for fault, words in FAULTS.items()
            }
            extra = [f"{words} +{each - COUNT - delay}" for words, each in faulty.items()]
            ratios = ", ".join(f"{each / (COUNT + delay):.2f}" for each in sorted(used))
            print(f"d = {delay}: frames / (n + d) = {ratios}; slots more: {', '.join(extra)}")
    return int(wrong > 0)


def _slots(delay: int, seed: int, fault: str | None) -> int:
    draw = random.Random(seed)
    ticks = [draw.choice((10, 11, 20, 40, 80, 160, 320)) for _ in range(COUNT)]
    model = Model(delay=delay, lateness_s=draw.choice((0.002, 0.03, 0.065, 0.13)))
    with open_streaming(model) as camera:
        frames = camera.shoot(settings(ticks))
        if fault is not None:
            model.advance()
            getattr(model, fault).add(model.slot + 1 + delay + COUNT // 3)
        assert exposures(frames) == ticks
    return model.used[-1] - model.written_in[0]


if __name__ == "__main__":
    sys.exit(main())
