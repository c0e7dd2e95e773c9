"""Shot noise + read noise + full well + ADC: this simulator against numpy's own generators.

Run it by hand: ``python tests/bench/bench_sensor.py [--json]``.  All rows come from one run, taken
in turns, so that the ratios hold on a machine that does other work beside; medians are printed.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from camctl.camera import Layout
from sim.render import Renderer
from sim.scene import load_scene
from sim.sensor import Sensor, load_sensor
from sim.view import light_on

TIME_S = 0.01


def naive(light: NDArray[np.float32], sensor: Sensor) -> NDArray[np.uint8]:
    """Return what a straightforward float64 simulation does: Poisson, normal, minimum, floor."""
    random = np.random.default_rng()
    electrons = random.poisson(light * (sensor.quantum_efficiency * TIME_S)).astype(np.float64)
    electrons = np.minimum(electrons, sensor.full_well_e)
    electrons += random.normal(0.0, sensor.read_noise_e, electrons.shape)
    dn = np.floor(electrons / sensor.electrons_per_dn + sensor.black + sensor.phase)
    return np.asarray(np.clip(dn, 0, 2**sensor.bits - 1).astype(np.uint8))


def main() -> None:
    """Print Mpixel/s of each method and its ratio to the naive one."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--size", default="2048x2048")
    arguments = parser.parse_args()
    width, height = (int(part) for part in arguments.size.split("x"))
    sensor = load_sensor("standard")
    light = light_on(load_scene("tile-floor", (height, width)), Layout.MONO)
    renderers = {n: Renderer(light, sensor, threads=n) for n in (1, 2)}
    ideal = Renderer(light, load_sensor("ideal-8"), threads=1)  # well and ADC without any noise
    methods: dict[str, Callable[[], object]] = {
        "naive Poisson + normal, float64": lambda: naive(light, sensor),
        "sim, 1 thread": lambda: renderers[1].frame(TIME_S, 1.0, 0),
        "sim, 2 threads": lambda: renderers[2].frame(TIME_S, 1.0, 0),
        "arithmetic alone, 1 thread": lambda: ideal.frame(TIME_S, 1.0, 0),
    }
    seconds: dict[str, list[float]] = {name: [] for name in methods}
    for turn in range(arguments.rounds + 1):
        for name, method in methods.items():
            start = time.perf_counter()
            method()
            if turn:  # the first turn warms up
                seconds[name].append(time.perf_counter() - start)
    medians = {name: statistics.median(values) for name, values in seconds.items()}
    slowest = medians["naive Poisson + normal, float64"]
    rows = [
        {
            "method": name,
            "mpixel_per_s": light.size / median / 1e6,
            "ms": median * 1e3,
            "times_naive": slowest / median,
        }
        for name, median in medians.items()
    ]
    if arguments.json:
        print(json.dumps({"size": [height, width], "rows": rows}))
        return
    print(f"shot + read + well + ADC, {width} x {height} mono, 8 bit")
    for row in rows:
        print(
            f"{row['method']:34} {row['mpixel_per_s']:8.1f} Mpixel/s {row['ms']:8.2f} ms"
            f" {row['times_naive']:7.1f} x naive"
        )


if __name__ == "__main__":
    main()
