"""Predicted effective levels against those measured on simulated cameras before a known scene.

Each cell is a sensor preset, a desired response, a dynamic range and a set of exposures.  The scene
is a ramp that is even in u; its pictures are made by `camctl.capture`.  Predicted is
`achieved.effective_levels` of the report; measured is (12 mse)^(-1/2) of image.tiff against the
ramp.  Run by hand: ``python tests/bench/bench_accuracy.py [--cells]``; about a minute.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "helpers"))

from accuracy import sensor_without_lens, shoot_ramp

SENSORS = (
    *("standard", "webcam", "consumer", "phone", "mobile"),
    *("machine-vision", "ccd", "complete"),
)
RANGES = (256.0, 1000.0, 16000.0)
#: The paper's sets for each response, and exposures in steps of one stop.
RATIOS: dict[str, tuple[tuple[float, ...], ...]] = {
    "linear": ((1, 1.003), (1, 1.003, 2.985), (1, 2, 4, 8)),
    "gamma": ((1, 3.094), (1, 1.003, 5.146), (1, 2, 4, 8)),
    "log": ((1, 20.24), (1, 9.91, 88.38), (1, 2, 4, 8)),
}
#: Relative error up to which a prediction is right, and the share of the cells that must be.
LIMIT, SHARE = 0.02, 0.95


def main() -> int:
    """Print the errors by sensor; return 1 unless enough cells are within the limit."""
    arguments = argparse.ArgumentParser()
    arguments.add_argument("--cells", action="store_true", help="print each cell")
    print_cells = arguments.parse_args().cells
    errors: dict[str, list[float]] = defaultdict(list)
    for name in SENSORS:
        sensor = sensor_without_lens(name)
        for response, sets in RATIOS.items():
            for dynamic_range in RANGES:
                for ratios in sets:
                    report, measured = shoot_ramp(sensor, response, dynamic_range, ratios)
                    achieved = report.achieved
                    errors[name].append(measured / achieved.effective_levels - 1)
                    if print_cells:
                        print(
                            f"{name:14} {response:6} 1:{dynamic_range:<6g} {ratios!s:20} "
                            f"noise-free {achieved.effective_levels_noise_free:8.1f} "
                            f"predicted {achieved.effective_levels:7.2f} "
                            f"measured {measured:7.2f} {errors[name][-1]:+.2%}"
                        )
    print("sensor          cells  median error  largest  within 2 %")
    for name, values in errors.items():
        sizes = np.abs(values)
        print(
            f"{name:14} {sizes.size:6} {np.median(sizes):13.2%} {sizes.max():8.2%} "
            f"{np.mean(sizes <= LIMIT):11.1%}"
        )
    every = np.abs(np.concatenate(list(errors.values())))
    share = float(np.mean(every <= LIMIT))
    print(
        f"all            {every.size:6} {np.median(every):13.2%} {every.max():8.2%} {share:11.1%}"
    )
    return int(share < SHARE)


if __name__ == "__main__":
    sys.exit(main())
