"""Speed of photon noise, read noise, full well and ADC: camctl compiled, with numpy alone, Pyxel.

Run by hand: ``python tests/bench/bench_sensor.py [--pyxel PYTHON]``, where PYTHON is an interpreter
that has pyxel-sim.  With ``--read-noise 1.5`` photons are counted; ``--peak`` is the mean charge of
the brightest sample.  "compiled" is with the extra `fast`; the frames are the same.  The methods
take turns, and medians of the CPU seconds of all threads are printed: Pyxel uses one thread.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from camctl.sim.compiled import load
from camctl.sim.render import Renderer
from camctl.sim.scenes.scene import load_scene
from camctl.sim.scenes.view import View
from camctl.sim.sensors.sensor import Sensor, load_sensor

TIME_S = 0.01
NAIVE = "naive Poisson + normal, float64"
PYXEL = "Pyxel"


def naive(light: NDArray[np.float32], sensor: Sensor) -> NDArray[np.uint8]:
    """Return a frame of a plain float64 simulation: Poisson, normal, minimum, floor."""
    random = np.random.default_rng()
    electrons = random.poisson(light * (sensor.quantum_efficiency * TIME_S)).astype(np.float64)
    electrons = np.minimum(electrons, sensor.full_well_e)
    electrons += random.normal(0.0, sensor.read_noise_e, electrons.shape)
    dn = np.floor(electrons / sensor.electrons_per_dn + sensor.black + sensor.phase)
    return np.asarray(np.clip(dn, 0, 2**sensor.bits - 1).astype(np.uint8))


@contextmanager
def pyxel(python: str | None, shape: tuple[int, int]) -> Iterator[Callable[[], float] | None]:
    """Yield a function that renders one frame with Pyxel and returns its CPU seconds."""
    if python is None:
        yield None
        return
    script = Path(__file__).with_name("bench_sensor_pyxel.py")
    arguments = [python, str(script), *map(str, shape)]
    with subprocess.Popen(arguments, stdin=-1, stdout=-1, text=True, bufsize=1) as process:
        ask, answer = process.stdin, process.stdout
        assert ask is not None
        assert answer is not None

        def frame() -> float:
            ask.write("\n")
            return float(answer.readline())

        yield frame


def timed(work: Callable[[], object]) -> Callable[[], float]:
    """Return a function that does the work and returns its CPU seconds."""

    def seconds() -> float:
        start = time.process_time()
        work()
        return time.process_time() - start

    return seconds


def measure(
    shape: tuple[int, int],
    rounds: int,
    read_noise_e: float | None,
    peak_e: float | None,
    other: Callable[[], float] | None,
) -> None:
    """Print a row for each method at one size."""
    sensor = load_sensor("standard")
    if read_noise_e is not None:
        sensor = sensor.model_copy(update={"read_noise_e": read_noise_e})
    light = View.of(load_scene("ramp", shape), sensor).light
    if peak_e is not None:
        light = light * np.float32(
            peak_e / (float(light.max()) * sensor.quantum_efficiency * TIME_S)
        )

    def frame(threads: int, compiled: bool) -> Callable[[], float]:
        renderer = Renderer(View(light), sensor, threads=threads, compiled=compiled)
        return timed(lambda: renderer.frame(TIME_S, 1.0, 0))

    methods = {NAIVE: timed(lambda: naive(light, sensor))}
    if other is not None:
        methods[PYXEL] = other
    for compiled, name in ((False, "numpy"), (True, "compiled")):
        if not compiled or load() is not None:
            methods |= {f"{name}, threads: {n}": frame(n, compiled) for n in (1, 2)}
    seconds: dict[str, list[float]] = {name: [] for name in methods}
    for turn in range(rounds + 1):
        for name, method in methods.items():
            taken = method()
            if turn:  # the first turn fills caches
                seconds[name].append(taken)
    medians = {name: statistics.median(values) for name, values in seconds.items()}
    for name, median in medians.items():
        rival = medians.get(name.replace("compiled", "numpy"), median)
        print(
            f"{shape[1]:>5} x {shape[0]:<5} {name:32} {light.size / median / 1e6:7.1f} "
            f"Mpixel/CPU s {median * 1e3:8.2f} ms {medians[NAIVE] / median:6.1f} x naive"
            f" {rival / median:6.2f} x numpy"
            + (f" {medians[PYXEL] / median:6.1f} x Pyxel" if PYXEL in medians else "")
        )


def main() -> None:
    """Print Mpixel per CPU second of each method, and their ratios."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--sizes", default="2048x2048,6000x4000")
    parser.add_argument("--pyxel", metavar="PYTHON")
    parser.add_argument("--read-noise", type=float, metavar="ELECTRONS")
    parser.add_argument("--peak", type=float, metavar="ELECTRONS")
    given = parser.parse_args()
    print("shot + read + well + ADC, mono, 8 bit")
    for size in given.sizes.split(","):
        width, height = (int(part) for part in size.split("x"))
        with pyxel(given.pyxel, (height, width)) as other:
            measure((height, width), given.rounds, given.read_noise, given.peak, other)


if __name__ == "__main__":
    main()
