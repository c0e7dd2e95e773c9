"""Six JPEG photographs of 24 MP, merged with the response estimated, beside OpenCV.

    /usr/bin/time -v python tests/bench/bench_merge.py [camctl|opencv]

The photographs show the scene `room` enlarged to 6000 x 4000 pixels, with texture, photon noise and
read noise, through a curve that is not standard, 4 times apart.  They are written before, by a
process of their own, so that the peak memory is that of the merge.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from camctl import CaptureRequest, PhotographOptions
from camctl.model.response.camera import standard_response
from camctl.photographs.merge import plan_merge
from camctl.sim.scenes.drawings import room

ROWS, COLUMNS, STRIP = 4000, 6000, 500
TIMES = tuple(4.0**k for k in range(6))
WELL, READ_NOISE = 8000, 5


def write_photographs(folder: Path) -> None:
    """Write the photographs as p0.jpg to p5.jpg."""
    small = room(ROWS // 4, COLUMNS // 4).astype(np.float32)
    scene = cv2.resize(small, (COLUMNS, ROWS), interpolation=cv2.INTER_LINEAR)
    brightness = 2 / float(np.percentile(small, 90)) / TIMES[3]
    levels = standard_response("srgb", 8).levels
    u = np.arange(256) / 255
    curve = np.rint(255 * (0.4 * u + 0.6 * u**2 * (3 - 2 * u))).astype(np.uint8)
    texture = np.random.default_rng(0).normal(0, 0.1, (ROWS, COLUMNS, 1)).astype(np.float32)
    for k, time_s in enumerate(TIMES):
        picture = np.empty((ROWS, COLUMNS, 3), np.uint8)
        rng = np.random.default_rng((1, k))
        for row in range(0, ROWS, STRIP):
            strip = slice(row, row + STRIP)
            light = scene[strip] * np.exp(texture[strip]) * np.float32(brightness * time_s)
            deviation = np.sqrt(light / WELL + (READ_NOISE / WELL) ** 2)
            light += deviation * rng.standard_normal(light.shape, np.float32)
            picture[strip] = curve[np.searchsorted(levels, light, side="right")]
        cv2.imwrite(str(folder / f"p{k}.jpg"), picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 95])


def measured(label: str, call: Callable[[], Any]) -> Any:
    """Return what a call returns, and print its times."""
    wall, processor = time.perf_counter(), time.process_time()
    result = call()
    wall, processor = time.perf_counter() - wall, time.process_time() - processor
    print(f"{label:36} {wall:7.2f} s, processor {processor:7.2f} s", flush=True)
    return result


def merge(files: list[Path], folder: Path) -> None:
    """Print the times of camctl's merge."""
    request = CaptureRequest(dynamic_range="auto", clip_percent=0.0)
    plan = lambda: plan_merge(files, request, PhotographOptions(times=TIMES))  # noqa: E731
    found = measured("camctl: read, check, estimate, plan", plan)
    write = lambda: found.capture(folder / "result", overwrite=False)  # noqa: E731
    measured("camctl: sum, check, render, write", write)


def merge_by_opencv(files: list[Path], folder: Path) -> None:
    """Print the times of OpenCV's calibration and merge."""
    times = np.array(TIMES, np.float32)
    read = lambda: [cv2.imread(str(file)) for file in files]  # noqa: E731
    images = measured("OpenCV: read", read)
    calibrate, merging = cv2.createCalibrateDebevec(), cv2.createMergeDebevec()
    response = measured("OpenCV: calibrate", lambda: calibrate.process(images, times))
    light = measured("OpenCV: merge", lambda: merging.process(images, times, response))
    measured("OpenCV: write", lambda: cv2.imwrite(str(folder / "light.hdr"), light))


def main() -> None:
    """Merge with the programs that are named, or with both."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        writer = get_context("spawn").Process(target=write_photographs, args=(folder,))
        writer.start()
        writer.join()
        files = [folder / f"p{k}.jpg" for k in range(len(TIMES))]
        print(f"{sum(file.stat().st_size for file in files) / 1e6:.0f} MB in {len(files)} files")
        if "opencv" not in sys.argv[1:]:
            merge(files, folder)
        if "camctl" not in sys.argv[1:]:
            merge_by_opencv(files, folder)


if __name__ == "__main__":
    main()
