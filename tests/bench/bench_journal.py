"""What it costs that a capture's folder survives a power failure.

    python tests/bench/bench_journal.py [--folder FOLDER]

A capture of 8 frames of 1920 x 1080 in 16 bits is compared with plain `np.save` of the same frames,
and with the same writes without synchronisation and checksums.  FOLDER is on the disk to measure;
the working directory by default.  The medians of interleaved runs are printed as ratios.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from unittest import mock

import numpy as np

from camctl.captures.sequencer import capture
from camctl.exposure.goal import CaptureRequest
from camctl.interface.camera import Frame
from camctl.interface.controls import ExposureSetting
from camctl.records.folder_store import FolderStore
from camctl.records.frame import StoredFrame
from camctl.records.report import UnfinishedCapture
from camctl.sim.camera import SimulatedCamera
from camctl.sim.scenes.scene import load_scene
from camctl.sim.sensors.sensor import load_sensor

COUNT, SHAPE, RUNS = 8, (1080, 1920), 9


def frames() -> list[Frame]:
    """Return frames of noise, which no file system can compress."""
    random, setting = np.random.default_rng(0), ExposureSetting(0.01)
    return [
        Frame(
            random.integers(0, 1 << 16, SHAPE, np.uint16),
            setting,
            setting,
            0.0,
            k,
            0,
            (1 << 16) - 1,
        )
        for k in range(COUNT)
    ]


def begun() -> UnfinishedCapture:
    """Return the report of a small capture that lacks all of its frames."""
    request = CaptureRequest(ratios=tuple(1 + k / 10 for k in range(COUNT)), base_s=0.01)
    with SimulatedCamera(load_scene("uniform", (16, 24)), load_sensor("standard")) as camera:
        report = capture(camera, request)
    fields = {
        name: getattr(report, name)
        for name in UnfinishedCapture.model_fields
        if name in vars(report)
    }
    return UnfinishedCapture.model_validate(
        {**fields, "status": "incomplete", "frames": [None] * COUNT}
    )


def with_journal(folder: Path, shot: list[Frame], report: UnfinishedCapture) -> None:
    """Keep the frames as a capture does: staged, synchronised, in the report, renamed."""
    report = report.model_copy(update={"frames": [None] * COUNT})
    with FolderStore.create(folder) as store:
        store.save_report(report)
        for position, frame in enumerate(shot):
            report.frames[position] = StoredFrame(
                **vars(store.keep(frame, position)),
                requested=frame.requested,
                applied=frame.applied,
                requested_s=0.01,
                applied_s=0.01,
                black=0,
                white=frame.white,
                saturated_fraction=0.0,
                timestamp_s=0.0,
            )
            store.save_report(report)


def plain(folder: Path, shot: list[Frame]) -> None:
    """Write the frames with numpy, without any care."""
    folder.mkdir()
    for position, frame in enumerate(shot):
        np.save(folder / f"frame-{position + 1:02d}.npy", frame.pixels)


def synchronised(folder: Path, shot: list[Frame]) -> None:
    """Write the frames with numpy, and bring each to the disk: the least that is durable."""
    folder.mkdir()
    for position, frame in enumerate(shot):
        with (folder / f"frame-{position + 1:02d}.npy").open("wb") as file:
            np.save(file, frame.pixels)
            file.flush()
            os.fsync(file.fileno())


def main() -> None:
    """Print the ratios."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--folder", type=Path, default=Path())
    chosen = parser.parse_args()
    shot, report = frames(), begun()
    ways: dict[str, Callable[[Path], None]] = {
        "plain np.save": lambda folder: plain(folder, shot),
        "np.save and fsync": lambda folder: synchronised(folder, shot),
        "capture folder": lambda folder: with_journal(folder, shot, report),
        "capture folder without fsync": lambda folder: without_fsync(folder, shot, report),
    }
    seconds: dict[str, list[float]] = {name: [] for name in [*ways, "checksums"]}
    for _ in range(RUNS):
        for name, write in ways.items():
            with tempfile.TemporaryDirectory(dir=chosen.folder) as base:
                os.sync()
                began = time.perf_counter()
                write(Path(base) / "out")
                seconds[name].append(time.perf_counter() - began)
        began = time.perf_counter()
        for frame in shot:
            hashlib.sha256(frame.pixels.data.cast("B"))
        seconds["checksums"].append(time.perf_counter() - began)
    medians = {name: statistics.median(times) for name, times in seconds.items()}
    for name, median in medians.items():
        share, durable = median / medians["plain np.save"], median / medians["np.save and fsync"]
        print(f"{name:30} {median:.3f} s  {share:5.2f} x plain  {durable:5.2f} x np.save and fsync")


def without_fsync(folder: Path, shot: list[Frame], report: UnfinishedCapture) -> None:
    """Keep the frames as a capture does, with every fsync left out."""
    with mock.patch("os.fsync"):
        with_journal(folder, shot, report)


if __name__ == "__main__":
    main()
