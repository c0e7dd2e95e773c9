"""Responses and light from photographs with known truth, beside OpenCV's calibrations.

    CAMCTL_DATA=DIR python tests/bench/bench_photographs.py [--sets 12] [--megapixels 6,24]

DIR holds dorf/curves.npz (measured curves of Grossberg and Nayar's database) and memorial/, whose
map is the scene.  Photographs are JPEG files of quality 90 with colour for 2 x 2 pixels, photon
noise of 20,000 electrons at full scale and read noise of 5, with one curve in all colours; their
exact times are given.  Errors of curves are the standard deviation of ln(estimated / true
irradiance) over brightness from 5 to 95 %, means of the colours; errors of light are root mean
squares of ln(estimate / truth) by decade below saturation of the shortest photograph, over all
pixels, per cent, at the best scale of each colour.

With `--megapixels`: sRGB photographs of so many pixels 2 stops apart, and the errors in stops of
the curve that is used and of the one that is estimated without comparing it with sRGB.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from camctl import CaptureRequest, PhotographOptions
from camctl.calibration.response.estimate import estimate_response
from camctl.calibration.response.series import Series
from camctl.interface.controls import Layout
from camctl.model.response.camera import FloatArray, srgb_to_linear
from camctl.photographs.merge import plan_merge
from camctl.photographs.photograph_set import open_photographs
from camctl.stills.radiance_map import read_map

FULL_E, READ_E, QUALITY = 2e4, 5.0, 90
#: Numbers of photographs and their steps, stops.
BRACKETS = ((3, 3.0), (4, 2.0), (5, 2.0), (7, 2.0), (9, 1.0), (13, 1.0), (16, 1.0))
DECADES = (-5, -4, -3, -2, -1)
AT = np.linspace(0.05, 0.95, 91)

Pixels = NDArray[np.uint8]


def scene(folder: Path, pixels: float | None = None) -> FloatArray:
    """Return the memorial map without its borders, enlarged to so many pixels; 99.5 % is 1."""
    light = np.asarray(read_map(folder / "memorial" / "memorial.hdr")[0], np.float32)[40:-40, 8:-8]
    if pixels is not None:
        scale = float(np.sqrt(pixels / light[..., 0].size))
        light = np.asarray(cv2.resize(light, None, fx=scale, fy=scale), np.float32)
    light = np.maximum(light, 1e-5 * float(light.max()))
    return np.asarray(light / np.quantile(light[::4, ::4], 0.995), np.float32)


def photograph(light: Any, curve: tuple[FloatArray, FloatArray], rng: np.random.Generator) -> Any:
    """Return a JPEG photograph of a light, 1 at full scale, decoded: (rows, columns, 3) B, G, R."""
    noisy = np.empty(light.shape, np.uint8)
    for row in range(0, len(light), 256):
        part = np.asarray(light[row : row + 256], np.float32)
        deviation = np.sqrt(part / FULL_E + (READ_E / FULL_E) ** 2)
        part = part + deviation * rng.standard_normal(part.shape, np.float32)
        codes = 255 * np.interp(np.clip(part, 0, 1), *curve)
        noisy[row : row + 256] = np.rint(codes).astype(np.uint8)
    return np.ascontiguousarray(noisy[..., ::-1])


def write(folder: Path, light: FloatArray, times: list[float], curve: Any, seed: int) -> list[Path]:
    files = [folder / f"p{k}.jpg" for k in range(len(times))]
    for k, (file, time_s) in enumerate(zip(files, times, strict=True)):
        pixels = photograph(light * np.float32(time_s), curve, np.random.default_rng((seed, k)))
        cv2.imwrite(str(file), pixels, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return files


def curve_error(irradiance: FloatArray, true: FloatArray) -> float:
    """Return the standard deviation of the logarithm of a ratio of curves at `AT`."""
    return float(np.std(np.log(np.maximum(irradiance, 1e-9) / true)))


def light_errors(found: FloatArray, truth: FloatArray, shortest_s: float) -> FloatArray:
    """Return errors of ln(light) in each decade, per cent."""
    logs = np.log(np.maximum(found, 1e-9) / truth)
    seen = truth * shortest_s < 0.9
    logs -= [np.median(logs[..., c][seen[..., c]]) for c in range(3)]
    place = np.floor(np.log10(truth * shortest_s))
    rms = []
    for decade in DECADES:
        use = (place == decade) & seen
        rms.append(100 * float(np.sqrt(np.mean(logs[use] ** 2))) if use.sum() > 200 else np.nan)
    return np.array(rms)


def compare(data: Path, count: int) -> None:
    """Print the errors of sets of photographs through measured curves."""
    light, found = scene(data), np.load(data / "dorf" / "curves.npz")
    chosen = np.linspace(0, len(found["index"]) - 1, count).astype(int)
    rows: dict[str, list[FloatArray]] = {}
    for number, place in enumerate(chosen.tolist()):
        n, step = BRACKETS[number % len(BRACKETS)]
        irradiance, brightness = found["irradiance"][place], found["brightness"][place]
        shortest_s = 0.9 if n > 4 else 4.0
        times = [shortest_s * 2.0 ** (step * k) for k in range(n)]
        true = np.interp(AT, brightness, irradiance)
        with tempfile.TemporaryDirectory() as name:
            files = write(Path(name), light, times, (irradiance, brightness), place)
            began = time.process_time()
            plan = plan_merge(files, CaptureRequest(), PhotographOptions(times=tuple(times)))
            report = plan.capture(None, overwrite=False)
            used_s = time.process_time() - began
            pictures: list[Any] = [cv2.imread(str(file)) for file in files]
        controls = plan.opened.camera.controls
        curves = [np.interp(AT, _places(each.M), each.levels) for each in controls.plane_levels]
        curves = (curves * 3)[:3]
        results = {"camctl": (curves, np.asarray(report.radiance(), np.float64))}
        exposures = np.array(times, np.float32)
        for label, make, merge in (
            ("Debevec", cv2.createCalibrateDebevec, cv2.createMergeDebevec),
            ("Robertson", cv2.createCalibrateRobertson, cv2.createMergeRobertson),
        ):
            response = make().process(pictures, exposures)
            merged = merge().process(pictures, exposures, response)[..., ::-1]
            theirs = [np.interp(AT, np.arange(256) / 255, response[:, 0, c]) for c in range(3)]
            results[label] = (theirs, np.asarray(merged, np.float64))
        line = [f"{n:2d} x {step:g} stops, curve {found['index'][place]:3d}"]
        for label, (each, radiance) in results.items():
            error = 100 * float(np.mean([curve_error(one, true) for one in each]))
            by_decade = light_errors(radiance, light, times[0])
            rows.setdefault(label, []).append(np.array([error, *by_decade]))
            line.append(f"{label} {error:5.2f} | {' '.join(f'{x:5.1f}' for x in by_decade)}")
        warned = ", ".join(sorted({each.code for each in plan.notes}))
        print("; ".join(line), f"; {used_s:.1f} s; {plan.opened.response}; {warned}", flush=True)
    print("medians: curve, then decades", DECADES)
    for label, each in rows.items():
        print(f"{label:10s}", np.nanmedian(np.array(each), axis=0).round(2))


def _places(count: int) -> FloatArray:
    return np.arange(1, count + 1) / (count + 1)


def large(data: Path, megapixels: list[float]) -> None:
    """Print the error of the response of large sRGB photographs."""
    codes = np.linspace(0, 1, 1024)
    srgb = srgb_to_linear(codes), codes
    for each in megapixels:
        light = scene(data, 1e6 * each)
        times = [0.9 * 4.0**k for k in range(5)]
        with tempfile.TemporaryDirectory() as name:
            files = write(Path(name), light, times, srgb, 1)
            began = time.process_time()
            opened = open_photographs(files, PhotographOptions(times=tuple(times)))
            used_s = time.process_time() - began
            series = Series(Layout.RGB, 8)
            for file, time_s in zip(files, times, strict=True):
                series.add(np.asarray(cv2.imread(str(file)))[..., ::-1], time_s, file.name)
            channels = estimate_response(series, is_scene_checked=False).record.channels
        chosen = [(_places(x.M), x.levels) for x in opened.camera.controls.plane_levels]
        estimated = [(np.array(x.brightness), np.array(x.irradiance)) for x in channels]
        for what, curves in ((opened.response, chosen), ("as estimated", estimated)):
            logs = np.array([np.log2(np.interp(AT, *x) / srgb_to_linear(AT)) for x in curves])
            errors = np.abs(logs - np.median(logs, axis=1)[:, None])
            print(
                f"{each:g} MP, {what}: median error {np.median(errors):.3f} stops, largest "
                f"{np.max(errors):.3f}; {used_s:.1f} s",
                flush=True,
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=12)
    parser.add_argument("--megapixels", default="")
    arguments = parser.parse_args()
    data = Path(os.environ["CAMCTL_DATA"])
    if arguments.megapixels:
        large(data, [float(each) for each in arguments.megapixels.split(",")])
    else:
        compare(data, arguments.sets)


if __name__ == "__main__":
    main()
