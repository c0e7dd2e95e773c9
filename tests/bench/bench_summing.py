"""The cost of summing: one `accumulate` per frame, with numpy alone and compiled (extra `fast`).

    python tests/bench/bench_summing.py [--megapixels 24] [--frames 6] [--rounds 15]

Each frame is read, and the running sum is read and written.  Rivals, in the same rounds and on one
thread: `np.copyto` (memmove) that moves as many bytes (half read, half written), and OpenCV's
accumulate, which sums in float32 and does not clip.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any
from unittest import mock

import cv2
import numpy as np

from camctl.pictures import accumulator
from camctl.pictures.accumulator import Accumulator
from camctl.pictures.compiled_sum import load
from camctl.system.compiled_functions import LoadedLater


def seconds(work: Callable[[], object]) -> float:
    """Return the processor time of one call."""
    start = time.process_time()
    work()
    return time.process_time() - start


def sums(bits: int, white: int, shape: tuple[int, int], count: int, rounds: int) -> None:
    """Print one row for frames of `bits`: processor time of a sum, and over that of its rivals."""
    dtype: np.dtype[np.unsignedinteger[Any]]
    dtype = np.dtype(np.uint8) if bits == 8 else np.dtype(np.uint16)
    block = np.random.default_rng(0).integers(0, 1 << bits, 1 << 20, dtype=dtype)
    frame = np.resize(block, shape)
    total = Accumulator(shape, dtype, count, white)
    total.total.fill(0)
    moved = frame.nbytes + 2 * total.total.nbytes
    source, target = np.ones(moved // 2, np.uint8), np.zeros(moved // 2, np.uint8)
    theirs = np.zeros(shape, np.float32)
    choices = {
        name: LoadedLater(load, 1, is_used) for name, is_used in (("numpy", False), ("fast", True))
    }

    def add(name: str) -> None:
        with mock.patch.object(accumulator, "CHOICE", choices[name]):
            total.accumulate(frame)

    works: dict[str, Callable[[], object]] = {
        "numpy": lambda: add("numpy"),
        "fast": lambda: add("fast"),
        "memmove": lambda: np.copyto(target, source),
        "cv2.accumulate": lambda: cv2.accumulate(frame, theirs),
    }
    times: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(rounds):
        for name, work in works.items():
            times[name].append(seconds(work))
    spent = {name: float(np.median(each)) for name, each in times.items()}
    for name in ("numpy", "fast"):
        print(
            f"{bits:2} bits, {name:5} {spent[name] * 1e3:6.2f} ms"
            f"   of memmove {spent[name] / spent['memmove']:.2f}"
            f"   of cv2.accumulate {spent[name] / spent['cv2.accumulate']:.2f}"
        )


def main() -> None:
    """Measure frames of 8, 12 and 16 bits."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--megapixels", type=float, default=24)
    parser.add_argument("--frames", type=int, default=6)
    parser.add_argument("--rounds", type=int, default=15)
    chosen = parser.parse_args()
    columns = round((chosen.megapixels * 1e6 * 1.5) ** 0.5) // 2 * 2
    rows = round(chosen.megapixels * 1e6 / columns) // 2 * 2
    cv2.setNumThreads(1)
    for bits, white in ((8, 250), (12, 4000), (16, 65000)):
        sums(bits, white, (rows, columns), chosen.frames, chosen.rounds)


if __name__ == "__main__":
    main()
