"""Speed of photon noise, read noise, full well and ADC: camctl, compiled, numpy alone, and Pyxel.

Run by hand: ``python tests/bench/bench_sensor.py [--pyxel PYTHON] [--json]``, where PYTHON is an
interpreter that has pyxel-sim.  With ``--read-noise 1.5`` photons are counted; ``--peak`` is the
mean charge of the brightest sample.  "compiled" is `sim` with the extra `fast`; its rival is `sim`
with numpy alone, which gives the same frame, with as many threads.  The methods take turns,
and medians of the CPU seconds of all threads are printed: Pyxel uses one thread, so that elapsed
times would compare unequal work.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import time
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from camctl.sim.compiled import load
from camctl.sim.noise import TILE, Stream, TileNoise, normal_quantiles, tile_bits
from camctl.sim.render import Renderer
from camctl.sim.scenes.scene import load_scene
from camctl.sim.scenes.view import View
from camctl.sim.sensors.sensor import Sensor, load_sensor

TIME_S = 0.01
NAIVE = "naive Poisson + normal, float64"
PYXEL = "Pyxel"
FLOOR = "arithmetic alone, 2 threads"
SIM = {n: f"sim, {n} thread{'s'[: n - 1]}" for n in (1, 2)}
COMPILED = {n: f"compiled, {n} thread{'s'[: n - 1]}" for n in (1, 2)}
RIVAL = {COMPILED[n]: SIM[n] for n in (1, 2)}


def naive(light: NDArray[np.float32], sensor: Sensor) -> NDArray[np.uint8]:
    """Return a frame of a plain float64 simulation: Poisson, normal, minimum, floor."""
    random = np.random.default_rng()
    electrons = random.poisson(light * (sensor.quantum_efficiency * TIME_S)).astype(np.float64)
    electrons = np.minimum(electrons, sensor.full_well_e)
    electrons += random.normal(0.0, sensor.read_noise_e, electrons.shape)
    dn = np.floor(electrons / sensor.electrons_per_dn + sensor.black + sensor.phase)
    return np.asarray(np.clip(dn, 0, 2**sensor.bits - 1).astype(np.uint8))


_PREPARED = normal_quantiles()[tile_bits(0, 0, Stream.PHOTON, 0, TILE)]


def _copy_noise(self: TileNoise, count: int, *_: object) -> NDArray[np.float32]:
    """Replace `TileNoise.normal` by a copy of prepared noise: no random numbers are generated."""
    np.copyto(self._z[:count], _PREPARED[:count])
    return self._z[:count]


@contextmanager
def pyxel(python: str | None, shape: tuple[int, int]) -> Iterator[Callable[[], float] | None]:
    """Yield a function that renders one frame with Pyxel and returns its CPU seconds."""
    if python is None:
        yield None
        return
    script = Path(__file__).with_name("bench_sensor_pyxel.py")
    arguments = [python, str(script), *map(str, shape)]
    with subprocess.Popen(arguments, stdin=-1, stdout=-1, text=True, bufsize=1) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        ask, answer = process.stdin, process.stdout

        def frame() -> float:
            ask.write("\n")
            return float(answer.readline())

        yield frame
        ask.close()


def measure(
    shape: tuple[int, int],
    rounds: int,
    python: str | None,
    read_noise_e: float | None,
    peak_e: float | None,
) -> list[dict[str, Any]]:
    """Return a row for each method at one size."""
    sensor = load_sensor("standard")
    if read_noise_e is not None:
        sensor = sensor.model_copy(update={"read_noise_e": read_noise_e})
    light = View.of(load_scene("ramp", shape), sensor).light
    if peak_e is not None:
        light = light * np.float32(
            peak_e / (float(light.max()) * sensor.quantum_efficiency * TIME_S)
        )
    view = View(light)
    renderers = {n: Renderer(view, sensor, threads=n, compiled=False) for n in (1, 2)}
    compiled = {n: Renderer(view, sensor, threads=n, compiled=True) for n in (1, 2)}
    has_numba = load() is not None

    def timed(work: Callable[[], object]) -> float:
        start = time.process_time()
        work()
        return time.process_time() - start

    def floor(threads: int) -> float:
        with mock.patch.object(TileNoise, "normal", _copy_noise):
            return timed(lambda: renderers[threads].frame(TIME_S, 1.0, 0))

    with pyxel(python, shape) as other:
        methods: dict[str, Callable[[], float]] = {
            NAIVE: lambda: timed(lambda: naive(light, sensor)),
            SIM[1]: lambda: timed(lambda: renderers[1].frame(TIME_S, 1.0, 0)),
            SIM[2]: lambda: timed(lambda: renderers[2].frame(TIME_S, 1.0, 0)),
            "arithmetic alone, 1 thread": lambda: floor(1),
            FLOOR: lambda: floor(2),
        }
        if has_numba:
            methods[COMPILED[1]] = lambda: timed(lambda: compiled[1].frame(TIME_S, 1.0, 0))
            methods[COMPILED[2]] = lambda: timed(lambda: compiled[2].frame(TIME_S, 1.0, 0))
        if other is not None:
            methods = {PYXEL: other} | methods
        seconds: dict[str, list[float]] = {name: [] for name in methods}
        for turn in range(rounds + 1):
            for name, method in methods.items():
                taken = method()
                if turn:  # the first turn fills caches
                    seconds[name].append(taken)
    tracemalloc.start()
    renderers[2].frame(TIME_S, 1.0, 0)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    medians = {name: statistics.median(values) for name, values in seconds.items()}
    return [
        {
            "size": list(shape),
            "method": name,
            "mpixel_per_s": light.size / median / 1e6,
            "ms": median * 1e3,
            "times_naive": medians[NAIVE] / median,
            "times_pyxel": medians[PYXEL] / median if PYXEL in medians else None,
            "rival": RIVAL.get(name),
            "times_rival": medians[RIVAL[name]] / median if name in RIVAL else None,
            "of_floor": medians[FLOOR] / median,
            "bytes_a_pixel_beside_the_light": peak / light.size if name == SIM[2] else None,
        }
        for name, median in medians.items()
    ]


def main() -> None:
    """Print Mpixel per CPU second of each method, and their ratios."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--sizes", default="2048x2048,6000x4000")
    parser.add_argument("--pyxel", metavar="PYTHON")
    parser.add_argument("--read-noise", type=float, metavar="ELECTRONS")
    parser.add_argument("--peak", type=float, metavar="ELECTRONS")
    arguments = parser.parse_args()
    rows = []
    for size in arguments.sizes.split(","):
        width, height = (int(part) for part in size.split("x"))
        rows += measure(
            (height, width),
            arguments.rounds,
            arguments.pyxel,
            arguments.read_noise,
            arguments.peak,
        )
    if arguments.json:
        print(json.dumps({"rows": rows}))
        return
    print("shot + read + well + ADC, mono, 8 bit")
    for row in rows:
        height, width = row["size"]
        print(
            f"{width:>5} x {height:<5} {row['method']:32} {row['mpixel_per_s']:7.1f} Mpixel/CPU s"
            f" {row['ms']:8.2f} ms {row['times_naive']:6.1f} x naive"
            + (f" {row['times_pyxel']:6.1f} x Pyxel" if row["times_pyxel"] else "")
            + (f" {row['times_rival']:6.2f} x {row['rival']}" if row["rival"] else "")
            + f" {row['of_floor']:6.1%} of the arithmetic"
        )
        if row["bytes_a_pixel_beside_the_light"]:
            print(f"{'':15}peak {row['bytes_a_pixel_beside_the_light']:.2f} bytes a pixel")


if __name__ == "__main__":
    main()
