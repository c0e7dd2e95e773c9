"""The cost of summing: one `accumulate` per frame, with numpy alone and compiled (extra `fast`).

    python tests/bench/bench_summing.py [--megapixels 24] [--frames 6] [--rounds 15]

Each frame is read, and the running sum is read and written.  Rivals, in the same rounds and on one
thread: `np.copyto` (memmove) that moves as many bytes (half read, half written), and OpenCV's
accumulate, which sums in float32 and does not clip.  Then the pass that remains after the last
frame (the sum to irradiance), and OpenCV's two ways to combine the same frames.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial
from typing import Any
from unittest import mock

import cv2
import numpy as np

from camctl.model.effective import EffectiveCamera
from camctl.model.inverse import Posterior
from camctl.model.noise import FrameNoise
from camctl.model.response.camera import linear_response
from camctl.model.response.desired import desired_response
from camctl.pictures import accumulator
from camctl.pictures.accumulator import Accumulator
from camctl.pictures.compiled_sum import load
from camctl.system.compiled_functions import LoadedLater

WHITE = 250
_STRIP = 1 << 20


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


def combining(name: str, shape: tuple[int, ...], count: int) -> None:
    """Print what all frames of `shape` cost, with the last pass, and OpenCV's ways."""
    rng = np.random.default_rng(0)
    block = rng.integers(0, 256, (count, 1 << 20), dtype=np.uint8)
    frames = [np.resize(each, shape) for each in block]
    total = Accumulator(shape, np.dtype(np.uint8), count, WHITE)
    total.total.fill(0)  # its memory is mapped before the first frame arrives
    add = float(np.median([seconds(partial(total.accumulate, frame)) for frame in frames]))
    real = linear_response(8, levels=WHITE)
    exposures = [1.0, 3.98, 16.0, 64.2, 305.4, 1130.0][:count]
    effective = EffectiveCamera.of(real, exposures)
    noise = [FrameNoise(40.0, 0.1)] * count
    posterior = Posterior(effective, desired_response("log", 16000), noise)
    irradiance = posterior.inverse.E.astype(np.float32)
    flat = total.total.reshape(-1)

    def last_pass() -> None:
        for start in range(0, flat.size, _STRIP):
            irradiance[flat[start : start + _STRIP]]

    after = seconds(last_pass)
    whole = count * add + after
    print(f"{name:5} {count} frames and the last pass {whole * 1e3:7.1f} ms   ratio 1.00")
    times = np.array(exposures, np.float32)
    rivals = {
        "MergeDebevec": lambda: cv2.createMergeDebevec().process(frames, times),
        "MergeMertens": lambda: cv2.createMergeMertens().process(frames),
    }
    for rival, work in rivals.items():
        try:
            spent = seconds(work)
        except cv2.error as error:
            print(f"      cv2 {rival}: refuses these frames ({error.err})")
            continue
        print(f"      cv2 {rival:14} {spent * 1e3:12.1f} ms   ratio {spent / whole:.0f}")


def main() -> None:
    """Measure mono and colour."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--megapixels", type=float, default=24)
    parser.add_argument("--frames", type=int, default=6)
    parser.add_argument("--rounds", type=int, default=15)
    chosen = parser.parse_args()
    columns = round((chosen.megapixels * 1e6 * 1.5) ** 0.5) // 2 * 2
    rows = round(chosen.megapixels * 1e6 / columns) // 2 * 2
    cv2.setNumThreads(1)
    for bits, white in ((8, WHITE), (12, 4000), (16, 65000)):
        sums(bits, white, (rows, columns), chosen.frames, chosen.rounds)
    for name, shape in (("mono", (rows, columns)), ("RGB", (rows, columns, 3))):
        combining(name, shape, chosen.frames)


if __name__ == "__main__":
    main()
