"""What the sum of noisy frames of a curved camera loses against weights by inverse variance.

    python tests/bench/bench_sum_information.py CURVES.npz [--electrons 10000] [--read-e 5]

CURVES.npz has irradiance and brightness, (curves, samples), from 0 to 1, such as measured responses
of the DoRF database.  Ten frames of 8 bits, exposures evenly over 1:1,000 from E = 1 on; photon
noise, read noise and quantisation reach the brightness through the slope of the curve, and errors
are small enough to be propagated.  The standard deviation of ln E from the sum is
sqrt(sum of variances) / sum of slopes, from the best weights 1 / sqrt(sum of slopes^2 / variance).
Each is a root mean square over the middle decade of the three.
"""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray

FRAMES, LEVELS, SPAN = 10, 255.0, 1000.0
"""Frames, levels of full scale, and the longest exposure over the shortest."""

LEAST_SLOPE = 1e-9
"""Levels in ln E that stand for none, so that nothing is divided by 0."""


def losses(
    irradiance: NDArray[np.float64],
    brightness: NDArray[np.float64],
    electrons: float,
    read_e: float,
) -> tuple[float, float]:
    """Return the rms errors of ln E in the middle decade, from the sum and from the best weights.

    Args:
        irradiance, brightness: (samples,), a curve, ascending from 0 to 1
        electrons: at full scale
        read_e: read noise
    """
    E = np.geomspace(10**-2, 10**-1, 200)[:, np.newaxis]
    light = E * np.geomspace(1.0, SPAN, FRAMES)
    ends = light * (1 + np.array([[[-1e-3]], [[1e-3]]]))
    low, high = (np.interp(end, irradiance, brightness) for end in ends)
    slopes = LEVELS * (high - low) / 2e-3  # levels in ln E; 0 where it is saturated
    exposed = np.minimum(light, 1.0) * electrons
    variance = (slopes * np.sqrt(exposed + read_e**2) / exposed) ** 2 + 1 / 12
    of_sum = variance.sum(1) / np.maximum(slopes.sum(1), LEAST_SLOPE) ** 2
    best = 1 / np.maximum((slopes**2 / variance).sum(1), LEAST_SLOPE)
    return float(np.sqrt(of_sum.mean())), float(np.sqrt(best.mean()))


def main() -> None:
    """Print the loss over all curves, and of the one at the median and the largest."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("curves")
    parser.add_argument("--electrons", type=float, default=10_000.0)
    parser.add_argument("--read-e", type=float, default=5.0)
    given = parser.parse_args()
    data = np.load(given.curves)
    pairs = zip(data["irradiance"], data["brightness"], strict=True)
    found = [losses(x, y, given.electrons, given.read_e) for x, y in pairs]
    worse = np.array([of_sum / best - 1 for of_sum, best in found])
    linear = losses(np.array([0.0, 1.0]), np.array([0.0, 1.0]), given.electrons, given.read_e)
    print(f"a linear camera: {linear[0]:.4f} and {linear[1]:.4f}, {linear[0] / linear[1] - 1:.1%}")
    for name, place in (("median", np.argsort(worse)[len(worse) // 2]), ("most", worse.argmax())):
        index = int(data["index"][place]) if "index" in data else int(place)
        of_sum, best = found[place]
        print(f"{name}: curve {index}, {of_sum:.4f} and {best:.4f}, {worse[place]:.1%} worse")
    print(
        f"5 to 95 % of the curves: {np.quantile(worse, 0.05):.1%} to {np.quantile(worse, 0.95):.1%}"
    )


if __name__ == "__main__":
    main()
