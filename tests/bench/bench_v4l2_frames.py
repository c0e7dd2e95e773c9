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

from v4l2_model import PATH, Model, ticks_of

from camctl.camera import CameraInfo
from camctl.controls import ExposureSetting
from camctl.profile import DelayRecord, Profile, save_profile
from drivers.v4l2.camera import V4l2Camera, V4l2Options

LISTS, FAULTY_LISTS, COUNT = 8, 3, 16
FAULTS = {"flag": "error flag", "damage": "short frame", "lose": "lost frame"}


def main() -> int:
    """Print a line for each delay; return 1 unless frames / (n + d) is 1 everywhere."""
    wrong = 0
    with tempfile.TemporaryDirectory() as folder:
        os.environ["CAMCTL_PROFILES"] = folder
        for delay in range(6):
            _save_delay(delay)
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
    options = V4l2Options(response="linear", fps=10)
    with V4l2Camera(PATH, options, kernel=model, clock=model.clock).open() as camera:
        frames = camera.shoot([ExposureSetting(each / 10_000) for each in ticks])
        if fault is not None:
            model.advance()
            getattr(model, fault).add(model.slot + 1 + delay + COUNT // 3)
        assert [ticks_of(frame.pixels) for frame in frames] == ticks
    return model.used[-1] - model.written_in[0]


def _save_delay(frames: int) -> None:
    record = DelayRecord(
        frames=frames, smallest=frames, largest=frames, trials=12, measured_at="2026-01-01T00:00:00"
    )
    info = CameraInfo(f"v4l2:{PATH}", "uvcvideo", "A webcam", "", "v4l2")
    save_profile(
        Profile(
            driver=info.driver,
            make=info.make,
            model=info.model,
            serial=info.serial,
            delays={"yuyv-8x6-10": record},
        )
    )


if __name__ == "__main__":
    sys.exit(main())
