"""The cost of a whole capture: memory, time for its files, frames lost in real time.

    python tests/bench/bench_capture.py [--megapixels 24]

Memory is the peak of the process while `capture` runs, less what it had with all modules imported
and the camera open.  The camera makes its frames from one row of light, so that the memory is that
of the controller and not of a simulator.  Each measurement runs in a process of its own.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.captures.sequencer import capture
from camctl.exposure.goal import CaptureRequest
from camctl.interface.camera import CameraBase, CameraInfo, Frame
from camctl.interface.clock import RealClock, VirtualClock
from camctl.interface.controls import (
    ExposureControls,
    ExposureSetting,
    Layout,
    ResponseOrigin,
    Steps,
)
from camctl.system.memory import share_free_memory

RATIOS = (1.0, 3.98, 16.0, 64.2, 305.4, 1130.0)
#: Different rows of a frame; electrons of a brightness level, and read noise, levels.
_NOISY_ROWS, _ELECTRONS, _READ_NOISE = 64, 40.0, 0.5


class RowsCamera(CameraBase):
    """Frames of any size from one row of light with noise, 8 bits.

    Each row is one of `_NOISY_ROWS`, moved by some columns against the one before, as of a picture
    no column of which has one brightness only.
    """

    def __init__(self, shape: tuple[int, int], layout: Layout) -> None:
        super().__init__("the bench's camera", VirtualClock())
        self._info = CameraInfo("rows", "bench", "rows", "0", "bench")
        self._controls = ExposureControls(
            Steps(1e-5, 10.0, 1e-6),
            shape,
            layout,
            8,
            white=250,
            delay_frames=0,
            response_origin=ResponseOrigin.STATED,
        )
        colours = (3,) if layout is Layout.RGB else ()
        light = np.tile(np.geomspace(1e3, 1.0, shape[1]), 2)
        self._row = np.broadcast_to(light.reshape(-1, *[1] * len(colours)), (light.size, *colours))

    def _open(self) -> None:
        pass

    def _close(self) -> None:
        pass

    def _frames(self, settings: tuple[ExposureSetting, ...]) -> Iterator[Frame]:
        rng = np.random.default_rng(0)
        for index, setting in enumerate(settings):
            electrons = self._row * (setting.time_s * 250 * _ELECTRONS)
            rows = rng.poisson(np.broadcast_to(electrons, (_NOISY_ROWS, *electrons.shape)))
            noisy = np.rint(rows / _ELECTRONS + rng.normal(0, _READ_NOISE, rows.shape))
            codes = np.clip(noisy, 0, 255).astype(np.uint8)
            height, columns = self.controls.shape
            moved = np.linspace(0, columns, height, endpoint=False, dtype=int)
            chosen = rng.integers(0, _NOISY_ROWS, height)
            pixels = np.empty((height, columns, *codes.shape[2:]), np.uint8)
            for row, noise, first in zip(pixels, chosen, moved, strict=True):
                row[:] = codes[noise, first : first + columns]
            self.clock.sleep_until(self.clock.now() + setting.time_s)
            yield Frame(pixels, setting, setting, self.clock.now(), index, 0, 250)


def frame_shape(megapixels: float) -> tuple[int, int]:
    """Return rows and columns of a 3:2 frame, both even."""
    columns = round((megapixels * 1e6 * 1.5) ** 0.5) // 2 * 2
    return round(megapixels * 1e6 / columns) // 2 * 2, columns


def memory(layout: Layout, megapixels: float) -> None:
    """Print the peak memory of one capture."""
    import cv2  # noqa: F401  imported here, so that it counts as memory from before the capture
    import Imath  # noqa: F401
    import OpenEXR  # noqa: F401
    import tifffile  # noqa: F401

    rows, columns = frame_shape(megapixels)
    request = CaptureRequest("log", 16000.0, ratios=RATIOS, base_s=1e-3)
    with RowsCamera((rows, columns), layout) as camera, tempfile.TemporaryDirectory() as folder:
        samples = rows * columns * (3 if layout is Layout.RGB else 1)
        before = resident_mb()
        capture(camera, request, Path(folder) / "out")
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    allowed = (2 * samples + 3 * samples) / 1e6 + 100
    print(
        f"memory {layout.value:5} {megapixels:g} MP, n = {len(RATIOS)}: {peak - before:6.0f} MB "
        f"above {before:.0f} MB; accumulator + 3 frames + 100 MB = {allowed:.0f} MB; "
        f"ratio {(peak - before) / allowed:.2f}"
    )


def pictures(layout: Layout, megapixels: float) -> None:
    """Print the time from the last frame to the last file against OpenCV's merge of the frames.

    The merge gets frames in as many channels as the pictures have: a mosaic's are colour.  It runs
    in a process of its own, as its users run it, and once more in one with the memory settings of a
    capture, from which it gains, too.  Each is the fastest of three runs that alternate.
    """
    rows, columns = frame_shape(megapixels)
    request = CaptureRequest("log", 16000.0, ratios=RATIOS, base_s=1e-3)
    spent: list[float] = []
    merged: list[float] = []
    merged_so: list[float] = []
    for _ in range(3):
        with RowsCamera((rows, columns), layout) as camera, tempfile.TemporaryDirectory() as folder:
            report = capture(camera, request, Path(folder) / "out")
            spent.append(report.timing["writing_s"])
            for seconds, settings in ((merged, "default"), (merged_so, "capture")):
                command = [sys.executable, __file__, "--merge", f"{folder}/out/frames", settings]
                command += ["3" if layout.is_mosaic else "1"]
                done = subprocess.run(command, check=True, capture_output=True, text=True)
                seconds.append(float(done.stdout))
    ours, theirs, theirs_so = min(spent), min(merged), min(merged_so)
    what = f"files  {layout.value:5} {megapixels:g} MP, n = {len(RATIOS)}"
    print(
        f"{what}: {ours:5.2f} s after the last frame; cv2 MergeDebevec {theirs:5.2f} s, "
        f"ratio {ours / theirs:.2f} (with the memory settings of a capture {theirs_so:.2f} s, "
        f"{ours / theirs_so:.2f})"
    )


def merge(folder: Path, settings: str, times: int) -> None:
    """Print the time in which OpenCV merges the frames in a folder, s.

    Each is repeated so many times as channels.
    """
    import cv2

    if settings == "capture":
        share_free_memory()
    frames: list[NDArray[Any]] = [np.load(path) for path in sorted(folder.glob("*.npy"))]
    if times > 1:
        frames = [np.repeat(frame[..., np.newaxis], times, axis=2) for frame in frames]
    spent = []
    for _ in range(2):  # the first one initialises
        begin = time.perf_counter()
        cv2.createMergeDebevec().process(frames, np.array(RATIOS, np.float32))
        spent.append(time.perf_counter() - begin)
    print(min(spent))


def resident_mb() -> float:
    """Return the resident memory of the process, MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


def real_time() -> None:
    """Print frames lost at 30 frames a second, 2 megapixels, with everything written to disk."""
    from camctl.sim.camera import SimulatedCamera
    from camctl.sim.scenes.scene import load_scene
    from camctl.sim.sensors.sensor import load_sensor

    scene = load_scene("tile-floor", (1080, 1920))
    ratios = tuple(1 + 0.01 * k for k in range(16))
    request = CaptureRequest("linear", 256.0, ratios=ratios, base_s=0.02)
    with (
        SimulatedCamera(scene, load_sensor("standard"), clock=RealClock()) as camera,
        tempfile.TemporaryDirectory(dir=Path.cwd()) as folder,
    ):
        before = camera.device.lost
        report = capture(camera, request, Path(folder) / "out")
        lost = camera.device.lost - before
        expected = (len(ratios) + camera.sensor.delay_frames) * camera.sensor.frame_interval_s
    print(
        f"real   {len(ratios)} frames of 2 MP at 30 a second: {lost} lost, "
        f"{report.timing['shooting_s']:.3f} s for n + d slots of {expected:.3f} s, "
        f"ratio {report.timing['shooting_s'] / expected:.2f}"
    )


def main() -> None:
    """Run each measurement in a fresh process."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--megapixels", type=float, default=24)
    parser.add_argument("--only", help=argparse.SUPPRESS)
    parser.add_argument("--merge", nargs=3, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.merge:
        folder, settings, times = chosen.merge
        merge(Path(folder), settings, int(times))
        return
    parts = {
        **{f"memory-{kind}": kind for kind in (Layout.MONO, Layout.RGGB, Layout.RGB)},
        **{f"pictures-{kind}": kind for kind in (Layout.MONO, Layout.RGGB, Layout.RGB)},
        "real": real_time,
    }
    if chosen.only:
        part = parts[chosen.only]
        if isinstance(part, Layout):
            measure = memory if chosen.only.startswith("memory") else pictures
            measure(part, chosen.megapixels)
        else:
            part()
        return
    for name in parts:
        command = [sys.executable, __file__, "--only", name, "--megapixels", str(chosen.megapixels)]
        subprocess.run(command, check=True)


if __name__ == "__main__":
    main()
