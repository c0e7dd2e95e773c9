"""The estimated response beside OpenCV's: accuracy, stability, time and memory.

    python tests/bench/bench_response.py [--draws 50] [--seed 1000] [--scenes 20] [--only PARTS]

$CAMCTL_DATA holds emor.txt (Grossberg and Nayar's empirical model of response) and memorial/
(a scene of the part "stability"); without it smooth curves of our own are drawn.
Errors are root mean squares of brightness (full scale = 1) over brightness from 2 % on, at the best
scale of irradiance.
"""

from __future__ import annotations

import argparse
import os
import resource
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parent.parent / "helpers"))

from opencv_levels import levels_of, opencv_curves

from camctl.calibration.response.estimate import ResponseEstimate, estimate_response
from camctl.calibration.response.series import Series
from camctl.errors import DataError
from camctl.interface.controls import Layout
from camctl.model.quantiles import Z_95
from camctl.model.response.camera import FloatArray
from camctl.model.response.measured import ResponseModel, read_response_model
from camctl.profiles.response import ChannelResponse

STOPS = tuple(2.0 ** np.arange(-1, 6))
COARSE = {"steps of 4": (0.5, 2.0, 8.0, 32.0), "steps of 8": (0.5, 4.0, 32.0)}
Curve = tuple[FloatArray, FloatArray]
#: Of so many rows and columns one is used (by all but Debevec's method), and the number of pixels
#: that Debevec's method takes.
Sampling = tuple[int, int]
ONE_COUNT: tuple[Sampling, ...] = ((1, 70),)
THREE_COUNTS: tuple[Sampling, ...] = ((1, 50), (2, 70), (3, 140))
SIGMAS = np.array([1.0, 0.55, 0.35, 0.25, 0.2])  # of the first components, about as in its data


def draw(rng: np.random.Generator, model: ResponseModel | None) -> Curve:
    """Return a random ascending curve, irradiance and brightness from 0 to 1."""
    if model is None:
        E = np.linspace(0, 1, 1024)
        gamma, bend = rng.uniform(0.3, 1.0), rng.uniform(-0.4, 0.4)
        B = E**gamma
        return E, B + bend * B * (1 - B)
    while True:
        B = model.mean + (rng.normal(size=5) * SIGMAS) @ model.components[:5]
        if np.all(np.diff(B) > 0):
            return model.irradiance, B


def scene(rng: np.random.Generator, rows: int = 240, columns: int = 320) -> FloatArray:
    """Return random irradiance over about 3.5 decades; its 99.5 % quantile is 1."""
    wide, fine = (
        cv2.GaussianBlur(rng.normal(size=(rows, columns)), (0, 0), sigma)
        for sigma in (rows / 10, rows / 80)
    )
    E = np.exp(2.0 * wide / wide.std() + 0.3 * fine / fine.std())
    return np.asarray(E / np.quantile(E, 0.995))


def shoot(
    E: FloatArray, exposures: tuple[float, ...], curve: Curve, bits: int, rng: np.random.Generator
) -> list[NDArray[Any]]:
    """Return frames: photon noise of 10,000 electrons at saturation, read noise 5 electrons."""
    frames = []
    for exposure in exposures:
        charge = 1e4 * E * exposure
        charge = charge + np.sqrt(charge + 25) * rng.normal(size=E.shape)
        B = np.interp(np.clip(charge / 1e4, 0, 1), *curve)
        frame = np.clip(np.floor(B * 2**bits), 0, 2**bits - 1)
        frames.append(np.asarray(frame, np.uint8 if bits == 8 else np.uint16))
    return frames


def ours(frames: list[NDArray[Any]], exposures: tuple[float, ...], bits: int) -> ResponseEstimate:
    layout = Layout.MONO if frames[0].ndim == 2 else Layout.RGB
    series = Series(layout, bits, levels_are_stated=True)
    for k, (frame, exposure) in enumerate(zip(frames, exposures, strict=True)):
        series.add(frame, exposure, f"frame {k}")
    return estimate_response(series)


def error_of(levels: FloatArray, brightness: FloatArray, curve: Curve) -> float:
    if not np.all(np.isfinite(levels)):
        return float("nan")
    levels = np.maximum.accumulate(levels)
    B = np.linspace(0.02, 0.998, 400)
    E = np.interp(B, curve[1], curve[0])
    middle = np.interp(0.75, curve[1], curve[0]) / np.interp(0.75, brightness, levels)
    errors = []
    for scale in middle * np.exp(np.linspace(-0.15, 0.15, 301)):
        found = np.interp(E, levels * scale, brightness)
        inside = levels[-1] * scale > E
        errors.append(float(np.sqrt(np.mean((found - B)[inside] ** 2))))
    return min(errors)


def quartiles(values: list[float]) -> str:
    numbers = np.array(values)
    good = numbers[np.isfinite(numbers)]
    text = "  ".join(f"{value:.4f}" for value in np.quantile(good, [0.25, 0.5, 0.75, 1]))
    return f"{text}   NaN {numbers.size - good.size}"


def accuracy(model: ResponseModel | None, draws: int, first: int) -> None:
    print(
        f"{draws} random responses, {len(STOPS)} frames; error: quartiles and maximum", flush=True
    )
    table: dict[str, list[float]] = {}
    inside: dict[str, list[float]] = {}
    for seed in range(first, first + draws):
        try:
            errors, shares = one_draw(model, seed)
        except DataError as error:
            print(f"  seed {seed}: refused: {error.what}", flush=True)
            continue
        for name, value in errors.items():
            table.setdefault(name, []).append(value)
        for name, share in shares.items():
            inside.setdefault(name, []).append(share)
        rival = float(np.fmin(errors["OpenCV debevec"], errors["OpenCV robertson"]))
        each = "  ".join(f"{name} {error:.5f}" for name, error in errors.items())
        ratio = errors["camctl 8 bits"] / rival
        print(f"  seed {seed}: {each}  8 bits / better {ratio:.2f}", flush=True)
    for name, values in table.items():
        print(f"  {name:18s} {quartiles(values)}", flush=True)
    rivals = np.fmin(table["OpenCV debevec"], table["OpenCV robertson"])
    for bits in (8, 10, 12):
        own = np.array(table[f"camctl {bits} bits"])
        ratios = own / rivals
        pooled = np.sqrt(np.mean(own**2) / np.mean(rivals**2))
        print(
            f"  {bits} bits / the better of OpenCV's: median {np.median(ratios):.2f}, 90 % "
            f"{np.quantile(ratios, 0.9):.2f}, maximum {ratios.max():.2f}, of the root mean squares "
            f"over all draws {pooled:.2f}; above 0.5 in {np.sum(ratios > 0.5)} of {ratios.size}, "
            f"above 1 in {np.sum(ratios > 1)}",
            flush=True,
        )
    for name, values in inside.items():
        print(
            f"  levels inside their 95 % interval, {name}: {np.mean(values):.1%} "
            f"({len(values)} series; in the worst tenth of them {np.quantile(values, 0.1):.0%})",
            flush=True,
        )


def one_draw(model: ResponseModel | None, seed: int) -> tuple[dict[str, float], dict[str, float]]:
    """Return errors by method and bits, and shares of levels in their interval by series.

    Raises:
        DataError: the scene does not show the response
    """
    rng = np.random.default_rng(seed)
    curve, E = draw(rng, model), scene(rng)
    errors: dict[str, float] = {}
    shares = []
    places = np.arange(1, 256) / 256
    for bits in (8, 10, 12):
        frames = shoot(E, STOPS, curve, bits, rng)
        channel = ours(frames, STOPS, bits).record.main_channel
        irradiance, brightness = np.array(channel.irradiance), np.array(channel.brightness)
        errors[f"camctl {bits} bits"] = error_of(irradiance[1:], brightness[1:], curve)
        shares.append(share_inside(channel, curve))
        if bits == 8:
            for method in ("debevec", "robertson"):
                levels = levels_of(opencv_curves(frames, STOPS, method)[:, 0])
                errors[f"OpenCV {method}"] = error_of(levels, places, curve)
    inside = {"steps of 2": float(np.mean(shares))}
    for name, exposures in COARSE.items():
        with suppress(DataError):
            estimate = ours(shoot(E, exposures, curve, 8, rng), exposures, 8)
            inside[name] = share_inside(estimate.record.main_channel, curve)
    return errors, inside


def share_inside(channel: ChannelResponse, curve: Curve) -> float:
    """Return the share of the levels from 3 to 98 % of full scale that are in their interval."""
    assert channel.deviation is not None
    irradiance, brightness = np.array(channel.irradiance), np.array(channel.brightness)
    used = (brightness > 0.03) & (brightness < 0.98)
    logs = np.log(irradiance[used] / np.interp(brightness[used], curve[1], curve[0]))
    logs -= np.interp(0.5, brightness[used], logs)
    return float(np.mean(np.abs(logs) <= Z_95 * np.array(channel.deviation)[used]))


def unknown_exposures(model: ResponseModel | None, draws: int) -> None:
    errors = []
    for seed in range(draws):
        rng = np.random.default_rng(3000 + seed)
        curve = draw(rng, model)
        series = Series(Layout.MONO, 8, levels_are_stated=True, exposures_are_stated=False)
        for k, frame in enumerate(shoot(scene(rng), STOPS, curve, 8, rng)):
            series.add(frame, 1.0, f"frame {k}")
        found = np.log(estimate_response(series).exposures)
        errors.append(float(np.polyfit(np.log(STOPS), found, 1)[0] - 1))
    print(
        f"exposures that nobody states, {draws} random responses: relative error of the exponent: "
        f"mean {np.mean(errors):.3f}, standard deviation {np.std(errors):.3f}, largest "
        f"{np.max(np.abs(errors)):.3f}, root mean square {np.sqrt(np.mean(np.square(errors))):.3f}",
        flush=True,
    )


def stability(model: ResponseModel | None, scenes: int, data: Path | None) -> None:
    pictures = stability_scenes(scenes, data, (240, 320))
    print(
        f"spread of one curve over {len(pictures)} scenes ({', '.join(pictures)}): standard "
        "deviation of brightness; refused or NaN",
        flush=True,
    )
    curve = draw(np.random.default_rng(7), model)
    for count in (3, 4, 5, 8, 12):
        exposures = tuple(np.geomspace(0.5, 32, count))
        spread(curve, pictures, exposures, ONE_COUNT, ("debevec", "robertson"))
    pictures = stability_scenes(scenes, data, (480, 640))
    print("over scenes of 640 x 480 pixels and three numbers of samples of each", flush=True)
    for count in (3, 5, 12):
        exposures = tuple(np.geomspace(0.5, 32, count))
        spread(curve, pictures, exposures, THREE_COUNTS, ("debevec",))


def spread(
    curve: Curve,
    pictures: dict[str, FloatArray],
    exposures: tuple[float, ...],
    samplings: tuple[Sampling, ...],
    rivals: tuple[str, ...],
) -> None:
    """Print the standard deviation of one curve over scenes and samplings, by method."""
    B = np.linspace(0.05, 0.95, 100)
    E = np.interp(B, curve[1], curve[0])
    found: dict[str, dict[str, list[FloatArray]]] = {}
    for seed, (scene_name, picture) in enumerate(pictures.items()):
        frames = shoot(picture, exposures, curve, 8, np.random.default_rng(seed))
        for name in ("camctl", *rivals):
            lines = []
            for sampling in samplings:
                levels, brightness = points(name, frames, exposures, sampling)
                if np.all(np.isfinite(levels)):
                    levels = np.maximum.accumulate(levels)
                    scale = np.interp(0.5, curve[1], curve[0]) / np.interp(0.5, brightness, levels)
                    lines.append(np.interp(E, levels * scale, brightness))
            if len(lines) == len(samplings):
                found.setdefault(name, {})[scene_name] = lines
    # Only scenes that the methods accept are compared: all of them, and the first two.
    for compared in dict.fromkeys((rivals, rivals[:1])):
        common = set.intersection(*(set(found[name]) for name in ("camctl", *compared)))
        spreads = {
            name: float(
                np.sqrt(np.mean(np.var([c for n in common for c in found[name][n]], axis=0)))
            )
            for name in ("camctl", *compared)
        }
        each = ", ".join(
            f"{name} {value:.4f} ({len(pictures) - len(found[name])} refused)"
            for name, value in spreads.items()
        )
        print(
            f"  {len(exposures):2d} frames, {len(common)} scenes: {each}; camctl / the better "
            f"{spreads['camctl'] / min(spreads[name] for name in compared):.2f}",
            flush=True,
        )
    worst = max(
        (float(np.sqrt(np.mean((line - B) ** 2))), name)
        for name, lines in found["camctl"].items()
        for line in lines
    )
    print(f"     largest rms error of camctl: {worst[0]:.4f} in {worst[1]}", flush=True)


def stability_scenes(
    count: int, data: Path | None, shape: tuple[int, int]
) -> dict[str, FloatArray]:
    """Return built-in scenes, the memorial scene, and drawn scenes, (rows, columns)."""
    from camctl.sim.scenes.drawings import DRAWINGS
    from camctl.stills.radiance_map import read_map

    rows, columns = shape
    pictures = {name: np.asarray(draw_(rows, columns)) for name, draw_ in DRAWINGS.items()}
    if data is not None:
        pictures["memorial"] = np.asarray(read_map(data / "memorial" / "memorial.hdr")[0])
    grey = {
        name: np.asarray(each if each.ndim == 2 else each.mean(axis=2), np.float64)
        for name, each in pictures.items()
    }
    found = {name: each / np.quantile(each, 0.995) for name, each in grey.items()}
    for seed in range(max(0, count - len(found))):
        found[f"drawn {seed}"] = scene(np.random.default_rng(seed), rows, columns)
    return found


def points(
    method: str, frames: list[NDArray[Any]], exposures: tuple[float, ...], sampling: Sampling
) -> tuple[FloatArray, FloatArray]:
    """Return levels, NaN where they were not found, and their brightness."""
    places = np.arange(1, 256) / 256
    step, samples = sampling
    if method == "debevec":
        calibration = cv2.createCalibrateDebevec(samples=samples)
        curve = calibration.process(frames, np.array(exposures, np.float32))
        return levels_of(np.asarray(curve, np.float64).reshape(256, -1)[:, 0]), places
    frames = [np.ascontiguousarray(frame[::step, ::step]) for frame in frames]
    if method == "robertson":
        return levels_of(opencv_curves(frames, exposures, method)[:, 0]), places
    try:
        channel = ours(frames, exposures, 8).record.main_channel
    except DataError:
        return np.full(255, np.nan), places
    return np.array(channel.irradiance[1:]), np.array(channel.brightness[1:])


def large() -> None:
    rng = np.random.default_rng(0)
    curve = draw(rng, None)
    E = scene(rng, 500, 750)
    exposures = tuple(np.geomspace(0.5, 64, 16))
    small = [np.stack([frame] * 3, axis=2) for frame in shoot(E, exposures, curve, 8, rng)]

    def picture(frame: NDArray[Any]) -> NDArray[Any]:
        return np.tile(frame, (8, 8, 1))

    start, memory = time.perf_counter(), peak()
    series = Series(Layout.RGB, 8, levels_are_stated=True)
    spent = 0.0
    for k, frame in enumerate(small):
        whole = picture(frame)
        start = time.process_time()
        series.add(whole, exposures[k], f"frame {k}")
        spent += time.process_time() - start
    start = time.process_time()
    estimate_response(series)
    spent += time.process_time() - start
    print(
        f"24 MP RGB, 16 frames: camctl {spent:.1f} s of CPU, {peak() - memory:.0f} MB more at most "
        "(one frame of 72 MB in it)",
        flush=True,
    )
    frames = [picture(frame) for frame in small]
    memory_with_frames = peak()
    start = time.process_time()
    opencv_curves(frames, exposures, "debevec")
    print(
        f"  OpenCV debevec {time.process_time() - start:.1f} s of CPU, "
        f"{peak() - memory:.0f} MB more ({memory_with_frames - memory:.0f} MB of frames)",
        flush=True,
    )
    quarter = [frame[:1000, :1500] for frame in frames]
    start = time.process_time()
    opencv_curves(quarter, exposures, "robertson")
    spent = time.process_time() - start
    print(f"  OpenCV robertson on a sixteenth of each frame {spent:.1f} s of CPU", flush=True)


def peak() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1000, help="of the first draw")
    parser.add_argument("--scenes", type=int, default=20)
    parser.add_argument("--only", default="accuracy,unknown,stability,large")
    options = parser.parse_args()
    only = options.only.split(",")
    data = Path(os.environ["CAMCTL_DATA"]) if "CAMCTL_DATA" in os.environ else None
    model = None if data is None else read_response_model(data / "emor.txt")
    if "large" in only:  # first, since the peak of memory never falls
        large()
    if "accuracy" in only:
        accuracy(model, options.draws, options.seed)
    if "unknown" in only:
        unknown_exposures(model, options.draws)
    if "stability" in only:
        stability(model, options.scenes, data)


if __name__ == "__main__":
    main()
