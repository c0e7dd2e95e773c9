"""The cost of summing: one `accumulate` per frame, compared with a copy of as many bytes.

    python tests/bench/bench_summing.py [--megapixels 24] [--frames 6] [--rounds 5]

Each frame is read, and the running sum is read and written; `np.copyto` on one thread moves as many
bytes (half read, half written) in the same round.  Then the pass that remains after the last frame
(the sum to irradiance), and OpenCV's two ways to combine the same frames.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial

import cv2
import numpy as np

from camctl.model.effective import EffectiveCamera
from camctl.model.inverse import Posterior
from camctl.model.noise import FrameNoise
from camctl.model.response.camera import linear_response
from camctl.model.response.desired import desired_response
from camctl.pictures.accumulator import Accumulator

WHITE = 250
_STRIP = 1 << 20


def seconds(work: Callable[[], object]) -> float:
    """Return how long one call takes."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def measure(name: str, shape: tuple[int, ...], count: int, rounds: int) -> None:
    """Print one row for frames of `shape`."""
    rng = np.random.default_rng(0)
    block = rng.integers(0, 256, (count, 1 << 20), dtype=np.uint8)
    size = int(np.prod(shape))
    frames = [np.resize(block[k], size).reshape(shape) for k in range(count)]
    moved = size + 2 * 2 * size
    source, target = np.ones(moved // 2, np.uint8), np.zeros(moved // 2, np.uint8)
    copies, sums = [], []
    for _ in range(rounds):
        total = Accumulator(shape, np.dtype(np.uint8), count, WHITE)
        total.total.fill(0)  # its memory is mapped before the first frame arrives
        for frame in frames:
            copies.append(seconds(lambda: np.copyto(target, source)))
            sums.append(seconds(partial(total.accumulate, frame)))
    copy, add = float(np.median(copies)), float(np.median(sums))
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

    print(
        f"{name:5} accumulate {add * 1e3:7.2f} ms   copyto of {moved / 1e6:.0f} MB moved "
        f"{copy * 1e3:7.2f} ms   ratio {add / copy:.2f}"
    )
    after = seconds(last_pass)
    whole = count * add + after
    print(f"      {count} frames and the last pass {whole * 1e3:7.1f} ms   ratio 1.00")
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
    parser.add_argument("--rounds", type=int, default=5)
    chosen = parser.parse_args()
    columns = round((chosen.megapixels * 1e6 * 1.5) ** 0.5) // 2 * 2
    rows = round(chosen.megapixels * 1e6 / columns) // 2 * 2
    for name, shape in (("mono", (rows, columns)), ("RGB", (rows, columns, 3))):
        measure(name, shape, chosen.frames, chosen.rounds)


if __name__ == "__main__":
    main()
