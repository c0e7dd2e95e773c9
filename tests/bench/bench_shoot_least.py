"""Processor time of what no capture of `camctl shoot` can do without, each by itself.

    python tests/bench/bench_shoot_least.py FOLDER [--rounds 3]

On the files of a capture in mono, 8 bits: calls of libraries, and passes of numpy or OpenCV over
the samples.  Nothing is planned, checked, tone-mapped or drawn.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import resource
import subprocess
import sys
import tempfile
import time
import zlib
from collections.abc import Callable, Iterator
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenEXR
import tifffile

from camctl.pictures.hdr_avif import avif_library

#: Rows that are compressed at a time, as `shoot` does.
_ROWS = 64

Work = Callable[[], Any]


def start() -> float:
    """Return the processor time of a process that imports the libraries, s."""
    libraries = "numpy, cv2, pydantic, click, OpenEXR, tifffile"
    libraries += "" if avif_library() is None else ", imagecodecs"
    settled = {"OPENBLAS_NUM_THREADS": "1", "PYDANTIC_DISABLE_PLUGINS": "__all__"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-c", f"import {libraries}"]
    subprocess.run(command, check=True, env=os.environ | settled)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def read(path: Path, buffer: bytearray) -> None:
    """Read a file into memory that is there."""
    with path.open("rb", buffering=0) as file:
        file.readinto(buffer)


def write_radiance(path: Path, header: dict[str, Any], channels: dict[str, Any]) -> None:
    """Write a file as radiance.exr, of channels in memory."""
    rows, columns = next(iter(channels.values())).shape
    kept = {name: header[name] for name in ("compression", "channels")}
    file = OpenEXR.OutputFile(str(path), OpenEXR.Header(columns, rows) | kept)
    for row in range(0, rows, _ROWS):
        part = {name: each[row : row + _ROWS] for name, each in channels.items()}
        file.writePixels(part, len(next(iter(part.values()))))
    file.close()


def parts(folder: Path, new: Path) -> Iterator[tuple[str, list[Work]]]:
    """Yield what is to be done, on the files of a capture; `new` is written."""
    paths = sorted((folder / "frames").glob("*.npy"))
    frames = [np.load(each) for each in paths]
    yield "frames: SHA-256", [partial(hashlib.sha256, each.data) for each in frames]
    yield "frames: written", [partial(new.write_bytes, each.data) for each in frames]
    buffer = bytearray(paths[0].stat().st_size)
    yield "frames: read once more", [partial(read, each, buffer) for each in paths]
    total = np.zeros(frames[0].shape, np.uint16)
    yield "frames: summed", [partial(np.add, total, each, out=total) for each in frames]
    # Two samples of one frame stand for one sample each of two frames.
    words = [each.view(np.uint16) for each in frames]
    both = [each for pair in pairwise(words) for each in pair]
    residuals = np.arange(1 << 16).astype(np.int16)
    yield "movement: a look-up a pair", [partial(cv2.LUT, each, residuals) for each in both]
    weights = np.ones(1 << 16, np.float32)
    yield "light: a look-up each two frames", [partial(cv2.LUT, each, weights) for each in words]
    tiffs = [tifffile.imread(folder / name) for name in ("sum.tiff", "image.tiff")]
    yield "sum.tiff, image.tiff", [partial(tifffile.imwrite, new, each) for each in tiffs]
    jpeg = np.asarray(cv2.imread(str(folder / "picture.jpg"), cv2.IMREAD_GRAYSCALE))
    light, size = total.astype(np.float32), jpeg.shape[1::-1]
    reduced = partial(cv2.resize, light, size, interpolation=cv2.INTER_AREA)
    yield "previews: light and deviation reduced", [reduced] * 2
    yield "previews: JPEG twice", [partial(cv2.imencode, ".jpg", jpeg)] * 2
    filtered = [
        np.diff(np.asarray(cv2.imread(str(folder / name), cv2.IMREAD_UNCHANGED)), axis=0).tobytes()
        for name in ("preview.png", "contact.png")
    ]
    yield "previews: PNG", [partial(zlib.compress, each, 1) for each in filtered]
    if (codecs := avif_library()) is not None and (folder / "picture.avif").exists():
        codes = codecs.avif_decode((folder / "picture.avif").read_bytes())
        options = {"level": 99, "speed": 10, "bitspersample": 10, "pixelformat": "400"}
        yield "picture.avif", [partial(codecs.avif_encode, codes, **options)]
    file = OpenEXR.InputFile(str(folder / "radiance.exr"))
    header = file.header()
    channels = {
        name: np.frombuffer(file.channel(name), np.float16).reshape(total.shape)
        for name in header["channels"]
    }
    yield "radiance.exr", [partial(write_radiance, new, header, channels)]


def main() -> None:
    """Print the least time of each part, and their sum."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--rounds", type=int, default=3)
    chosen = parser.parse_args()
    found = {"start of Python, imports": min(start() for _ in range(chosen.rounds))}
    with tempfile.TemporaryDirectory() as scratch:
        for name, work in parts(chosen.folder, Path(scratch) / "new"):
            times = []
            for _ in range(chosen.rounds):
                began = time.process_time()
                for each in work:
                    each()
                times.append(time.process_time() - began)
            found[name] = min(times)
    for name, seconds in found.items():
        print(f"{name:40} {seconds:6.3f} s")
    print(f"{'together':40} {sum(found.values()):6.3f} s")


if __name__ == "__main__":
    main()
