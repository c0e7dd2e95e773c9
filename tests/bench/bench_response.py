"""The estimated response beside OpenCV's: accuracy, stability, and on measured curves and frames.

    python tests/bench/bench_response.py [--draws 50] [--seed 1000] [--scenes 20] [--only PARTS]

$CAMCTL_DATA holds emor.txt (Grossberg and Nayar's empirical model of response), dorf/curves.npz
(index, irradiance and brightness of curves of their database) and memorial/ (Debevec and Malik's
exposure series and their map); without it smooth curves of our own are drawn.
Errors of "accuracy" are root mean squares of brightness (full scale = 1) over brightness from 2 %
on, at the best scale of irradiance; those of "memorial" medians of abs(ln(radiance / map)) at the
best scale of each channel.
"""

from __future__ import annotations

import argparse
import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parent.parent / "helpers"))

from opencv_levels import levels_of, opencv_curves
from scene_maps import blocks

from camctl.calibration.response.estimate import ResponseEstimate, estimate_response
from camctl.calibration.response.series import Series
from camctl.errors import DataError
from camctl.interface.controls import Layout
from camctl.messages.plain import sentence
from camctl.model.quantiles import Z_95
from camctl.model.response.camera import FloatArray, srgb_to_linear
from camctl.model.response.measured import ResponseModel, read_response_model
from camctl.profiles.response import ChannelResponse
from camctl.sim.scenes.drawings import DRAWINGS
from camctl.stills.radiance_map import read_map

STOPS = tuple(2.0 ** np.arange(-1, 6))
MEASURED_STOPS = tuple(2.0 ** np.arange(-3, 3))
COARSE = {"steps of 4": (0.5, 2.0, 8.0, 32.0), "steps of 8": (0.5, 4.0, 32.0)}
Curve = tuple[FloatArray, FloatArray]
METHODS = ("camctl", "debevec", "robertson")
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


def scene(rng: np.random.Generator) -> FloatArray:
    """Return random irradiance over about 3.5 decades; its 99.5 % quantile is 1."""
    wide, fine = (cv2.GaussianBlur(rng.normal(size=(240, 320)), (0, 0), sigma) for sigma in (24, 3))
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
    pictures = stability_scenes(scenes, data)
    print(
        f"spread of one curve over {len(pictures)} scenes ({', '.join(pictures)}): standard "
        "deviation of brightness; refused or NaN",
        flush=True,
    )
    curve = draw(np.random.default_rng(7), model)
    B = np.linspace(0.05, 0.95, 100)
    E = np.interp(B, curve[1], curve[0])
    for count in (3, 4, 5, 8, 12):
        exposures = tuple(np.geomspace(0.5, 32, count))
        found: dict[str, dict[str, FloatArray]] = {name: {} for name in METHODS}
        for seed, (scene_name, picture) in enumerate(pictures.items()):
            frames = shoot(picture, exposures, curve, 8, np.random.default_rng(seed))
            for name in METHODS:
                levels, brightness = points(name, frames, exposures)
                if np.all(np.isfinite(levels)):
                    levels = np.maximum.accumulate(levels)
                    scale = np.interp(0.5, curve[1], curve[0]) / np.interp(0.5, brightness, levels)
                    found[name][scene_name] = np.interp(E, levels * scale, brightness)
        # Only scenes that all methods accept are compared.
        common = set.intersection(*map(set, found.values()))
        spreads = {
            name: float(np.sqrt(np.mean(np.var([lines[each] for each in common], axis=0))))
            for name, lines in found.items()
        }
        each = ", ".join(
            f"{name} {value:.4f} ({len(pictures) - len(found[name])} refused)"
            for name, value in spreads.items()
        )
        ratio = spreads["camctl"] / min(spreads[name] for name in METHODS[1:])
        print(
            f"  {count:2d} frames, {len(common)} scenes: {each}; camctl / the better {ratio:.2f}",
            flush=True,
        )


def stability_scenes(count: int, data: Path | None) -> dict[str, FloatArray]:
    """Return built-in scenes, the memorial scene, and drawn scenes, (rows, columns)."""
    pictures = {name: np.asarray(drawn(240, 320)) for name, drawn in DRAWINGS.items()}
    if data is not None:
        pictures["memorial"] = np.asarray(read_map(data / "memorial" / "memorial.hdr")[0])
    grey = {
        name: np.asarray(each if each.ndim == 2 else each.mean(axis=2), np.float64)
        for name, each in pictures.items()
    }
    found = {name: each / np.quantile(each, 0.995) for name, each in grey.items()}
    for seed in range(max(0, count - len(found))):
        found[f"drawn {seed}"] = scene(np.random.default_rng(seed))
    return found


def points(
    method: str, frames: list[NDArray[Any]], exposures: tuple[float, ...]
) -> tuple[FloatArray, FloatArray]:
    """Return levels, NaN where they were not found, and their brightness."""
    if method != "camctl":
        return levels_of(opencv_curves(frames, exposures, method)[:, 0]), np.arange(1, 256) / 256
    try:
        channel = ours(frames, exposures, 8).record.main_channel
    except DataError:
        return np.full(255, np.nan), np.arange(1, 256) / 256
    return np.array(channel.irradiance[1:]), np.array(channel.brightness[1:])


def measured_curves(folder: Path) -> None:
    """Print errors and intervals of the curves of a database, before a room and before edges."""
    data = np.load(folder / "curves.npz")
    curves = list(zip(data["index"].tolist(), data["irradiance"], data["brightness"], strict=True))
    flatness = [
        np.log(srgb_to_linear(np.array(0.05))) / np.log(np.interp(0.05, brightness, irradiance))
        for _, irradiance, brightness in curves
    ]
    print("times as flat as sRGB at 5 %, quantiles 0, 5, 10, 50, 90, 95, 100 %:")
    print(np.quantile(flatness, (0, 0.05, 0.1, 0.5, 0.9, 0.95, 1)).round(2))
    room = np.asarray(DRAWINGS["room"](240, 320)).mean(axis=2)
    errors, inside = [], []
    for name, E in (("room", room), ("blocks", blocks(np.random.default_rng(7)))):
        E = E / np.quantile(E, 0.98)
        for index, *curve in curves:
            frames = shoot(E, MEASURED_STOPS, (curve[0], curve[1]), 8, np.random.default_rng(index))
            try:
                channel = ours(frames, MEASURED_STOPS, 8).record.main_channel
            except DataError as error:
                print(f"{name}, curve {index}: {error}")
                continue
            at = np.linspace(max(0.05, channel.measured[0]), min(0.95, channel.measured[1]), 60)
            true = np.interp(at, curve[1], curve[0])
            errors.append(float(np.std(np.log(np.interp(at, *places(channel)) / true))))
            inside.append(share_inside(channel, (curve[0], curve[1])))
    print(
        f"{len(errors)} answered, {2 * len(curves) - len(errors)} refused; error of "
        f"ln(irradiance): median {np.median(errors):.4f}, 90 % {np.quantile(errors, 0.9):.4f}; in "
        f"the 95 % intervals: {np.mean(inside):.1%} of the levels"
    )


def places(channel: ChannelResponse) -> tuple[FloatArray, FloatArray]:
    return np.array(channel.brightness), np.array(channel.irradiance)


def memorial(folder: Path) -> None:
    rows = [line.split() for line in (folder / "image_list.txt").read_text().splitlines()]
    listed = [(row[0], 1 / float(row[2])) for row in rows if row and row[0].endswith(".png")]
    frames = []
    for name, _ in listed:
        frame = cv2.imread(str(folder / name))
        assert frame is not None, name
        frames.append(frame[..., ::-1])
    exposures = tuple(time_s for _, time_s in listed)
    truth = np.asarray(read_map(folder / "memorial.hdr")[0], np.float64)
    valid = np.ones(truth.shape[:2], bool)
    for frame in frames:
        valid &= ~((frame[..., 2] == 255) & (frame[..., 0] == 0) & (frame[..., 1] == 0))
    good_rows = np.flatnonzero(valid.mean(axis=1) > 0.85)
    good_columns = np.flatnonzero(valid.mean(axis=0) > 0.85)
    part = np.ix_(
        np.arange(good_rows[0], good_rows[-1] + 1), np.arange(good_columns[0], good_columns[-1] + 1)
    )
    print(
        f"memorial: {len(frames)} frames, {valid[part].mean():.1%} of the part used is valid",
        flush=True,
    )
    parts = [np.ascontiguousarray(frame[part]) for frame in frames]
    series = Series(Layout.RGB, 8)
    for (name, time_s), frame in zip(listed, parts, strict=True):
        series.add(frame, time_s, name)
    estimate = estimate_response(series)
    print("  " + "; ".join(map(sentence, estimate.findings)), flush=True)
    ours_ = []
    for channel in estimate.record.channels:
        levels = channel_levels(channel)
        below = np.full(channel.black + 1, levels[0] / 2)
        ours_.append(np.concatenate([below, levels_of(levels), levels[-1:]]))
    well = np.any([np.all((frame > 20) & (frame < 235), axis=2) for frame in parts], axis=0)
    usable = valid[part] & well & np.all(truth[part] > 0, axis=2)
    curves = {"camctl": np.stack(ours_, axis=1)} | {
        name: opencv_curves(parts, exposures, name) for name in ("debevec", "robertson")
    }
    own = np.stack([each.sample_weights() for each in estimate.record.channels], axis=1)
    weights = np.pad(own, ((0, 256 - len(own)), (0, 0)))
    for name, curve in curves.items():
        found = []
        for colour in range(3):
            log_E = np.log(np.maximum(curve[:, colour], 1e-12))
            samples = np.array([frame[..., colour][usable] for frame in parts])
            weight = np.maximum(weights[samples, colour], 1e-12)
            light = (weight * (log_E[samples] - np.log(exposures)[:, None])).sum(axis=0)
            found.append(light / weight.sum(axis=0))
        print(f"  {name:10s} {compared(found, truth[part][usable])}", flush=True)
    merged = cv2.createMergeDebevec().process(
        parts, np.array(exposures, np.float32), curves["debevec"][:, None].astype(np.float32)
    )
    found = list(np.log(np.maximum(merged[usable], 1e-12)).T)
    print(f"  merged by OpenCV {compared(found, truth[part][usable])}", flush=True)


def compared(found: list[FloatArray], truth: FloatArray) -> str:
    """Return errors of ln(radiance), R, G, B."""
    errors = []
    for logs, true in zip(found, np.log(truth).T, strict=True):
        difference = logs - true
        errors.append(f"{np.median(np.abs(difference - np.median(difference))):.4f}")
    return f"median |ln error| {', '.join(errors)}"


def channel_levels(channel: ChannelResponse) -> FloatArray:
    """Return the levels of a channel without a black level's phase."""
    count = channel.white - channel.black
    phase = 0.5 if channel.black else 0.0
    places = (np.arange(1, count + 1) - phase) / (count + 1)
    return np.asarray(np.interp(places, channel.brightness, channel.irradiance))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1000, help="of the first draw")
    parser.add_argument("--scenes", type=int, default=20)
    parser.add_argument("--only", default="accuracy,unknown,stability,curves,memorial")
    options = parser.parse_args()
    only = options.only.split(",")
    data = Path(os.environ["CAMCTL_DATA"]) if "CAMCTL_DATA" in os.environ else None
    model = None if data is None else read_response_model(data / "emor.txt")
    if "accuracy" in only:
        accuracy(model, options.draws, options.seed)
    if "unknown" in only:
        unknown_exposures(model, options.draws)
    if "stability" in only:
        stability(model, options.scenes, data)
    if "curves" in only and data is not None:
        measured_curves(data / "dorf")
    if "memorial" in only and data is not None:
        memorial(data / "memorial")


if __name__ == "__main__":
    main()
