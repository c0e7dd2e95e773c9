"""The light that `combine` finds beside the best rivals: errors by decade, z scores, coverage.

    python tests/bench/bench_light_rivals.py CURVES.npz [--memorial MAP.hdr] [--only 3,7]

CURVES.npz has irradiance and brightness, (curves, samples), from 0 to 1, such as measured responses
of the DoRF database.  Each set is a known light, a measured curve of 8 bits, photon and read noise,
3 to 16 exposures, 0.7 MP (some 6 and 24 MP), mono or RGB, kept as PNG or as JPEG.  `combine` knows
the curve and measures the noise.  The rivals know the curve, too: OpenCV's Debevec and Robertson,
and the mean weighted by the inverse variance, which knows the noise.  That with the variance at the
true light is no rival, since nobody knows that light, but a measure of what could be had.

Errors are root mean squares of ln(found / true) in a decade of light, where 1 saturates the
shortest exposure, of samples of at least a level of the longest exposure; below, any estimate is a
matter of the prior.  A ratio is our error over the least one of the rivals.  z is (found - true) /
sd of these samples that are neither dark nor saturated; contradictory ones count.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import camctl
from camctl.model.noise import FrameNoise
from camctl.model.response.camera import CameraResponse
from camctl.model.response.measured import measured_response
from camctl.model.sensor import SensorModel
from camctl.sim.scenes.scene import load_scene
from camctl.stills.jpeg import JpegStructure

Floats = NDArray[np.float64]
Frames = list[NDArray[np.uint8]]

DECADES = (-4, -3, -2, -1)
RIVALS = ("inverse variance", "Debevec", "Robertson", "inverse variance at the true light")
#: Samples that a decade needs for its error to be compared.
_LEAST = 2000
#: Sets of this and the next size: one of so many is larger, of 6 and of 24 MP.
_LARGE, _LARGEST = 10, 20
_SCENES = ("room", "tile-floor", "night-street", "ball")
_STRIP = 1 << 22


@dataclass(frozen=True)
class Case:
    """One set of photographs.

    Attributes:
        curve: place of the response in the file of curves
        scene: name, or a path
        shape: rows, columns
        exposures: relative to the shortest
        noise: before the response
        quality: of JPEG; None: PNG
        is_colour: RGB, else mono
    """

    curve: int
    scene: str
    shape: tuple[int, int]
    exposures: tuple[float, ...]
    noise: FrameNoise
    quality: int | None
    is_colour: bool

    @property
    def name(self) -> str:
        """What is printed of it."""
        size = f"{self.shape[0] * self.shape[1] / 1e6:.1f} MP{' RGB' if self.is_colour else ''}"
        kind = "PNG" if self.quality is None else f"JPEG {self.quality}"
        scene, n = Path(self.scene).stem, len(self.exposures)
        step = self.exposures[-1] ** (1 / (n - 1))
        return f"{scene}, curve {self.curve}, {n} x {step:.3g}, {size}, {kind}"


def cases(curves: int, count: int, memorial: str | None) -> Iterator[Case]:
    """Yield the sets."""
    rng = np.random.default_rng(0)
    scenes = [*_SCENES, *([memorial] if memorial else [])]
    for place in range(count):
        n = int(rng.integers(3, 17))
        span = float(np.exp(rng.uniform(np.log(30), np.log(1000))))
        shape = (683, 1024)
        if place % _LARGE == _LARGE - 1:
            shape = (4000, 6000) if place % _LARGEST == _LARGEST - 1 else (2000, 3000)
            n = min(n, 4)
        yield Case(
            curve=place * curves // count,
            scene=scenes[place % len(scenes)],
            shape=shape,
            exposures=tuple(span ** (k / (n - 1)) for k in range(n)),
            noise=FrameNoise(float(rng.uniform(10, 60)), float(rng.uniform(0.4, 1.2))),
            quality=None if place % 2 else int(rng.choice([90, 95, 98])),
            is_colour=place % 5 == 4 and shape[0] < 1000,
        )


def light_of(case: Case) -> Floats:
    """Return the light of a scene, 0.95 at its 99.9th percentile."""
    size = (480, 640) if case.scene in _SCENES else None
    found = load_scene(case.scene, size).irradiance.astype(np.float32)
    colours = found if found.ndim == 3 else np.repeat(found[..., None], 3, axis=2)
    light = cv2.resize(colours, case.shape[::-1], interpolation=cv2.INTER_CUBIC)
    light = np.maximum(light, colours[colours > 0].min())
    if not case.is_colour:
        light = light[..., 1]
    return np.asarray(light * (0.95 / np.percentile(light, 99.9)), np.float64)


def shot(case: Case, light: Floats, real: CameraResponse, seed: int) -> Frames:
    """Return the frames, as they are after they were kept as files."""
    rng, full = np.random.default_rng(seed), np.float32(real.M + 1)
    electrons = full * np.float32(case.noise.electrons_per_level)
    levels = real.levels.astype(np.float32)
    # An index of equal steps of the light is faster than a search, and the levels stay exact.
    frames = []
    for exposure in case.exposures:
        pixels = np.empty(light.shape, np.uint8)
        flat, source = pixels.reshape(-1), light.reshape(-1)
        for start in range(0, flat.size, _STRIP):
            x = np.minimum(exposure * source[start : start + _STRIP], 4.0).astype(np.float32)
            x = rng.poisson(x * electrons).astype(np.float32) / electrons
            read = np.float32(case.noise.read_noise_levels) / full
            x += rng.standard_normal(x.shape, np.float32) * read
            flat[start : start + _STRIP] = np.searchsorted(levels, x, "right")
        if case.quality is not None:
            options = [cv2.IMWRITE_JPEG_QUALITY, case.quality]
            turn = slice(None, None, -1 if case.is_colour else 1)  # OpenCV has colours as BGR
            done, data = cv2.imencode(".jpg", pixels[..., turn], options)
            assert done
            pixels = np.asarray(cv2.imdecode(data, cv2.IMREAD_UNCHANGED), np.uint8)[..., turn]
        frames.append(pixels)
    return frames


def stated_steps(case: Case) -> tuple[int, ...] | None:
    """Return the steps of brightness that headers of the files of a set state; None: PNG."""
    if case.quality is None:
        return None
    options = [cv2.IMWRITE_JPEG_QUALITY, case.quality]
    _, data = cv2.imencode(".jpg", np.zeros((8, 8), np.uint8), options)
    return JpegStructure.of(data.tobytes()).brightness_steps


def inverse_variance(
    frames: Frames, case: Case, real: CameraResponse, light: Floats | None
) -> NDArray[np.float32]:
    """Return the mean of the light of each sample, weighted with the inverse variance.

    The variance is that at the true light, or, where that is None, at the mean itself, iterated
    (Granados et al., Optimal HDR reconstruction with linear digital cameras, 2010).
    """
    sensor = SensorModel(real, 0)
    highest = sensor.highest(case.noise)
    values = sensor.light.astype(np.float32)
    shape = frames[0].shape
    nodes = np.geomspace(sensor.level / max(case.exposures) / 100, sensor.full, 4096)
    found = np.empty(frames[0].size, np.float32)
    for start in range(0, found.size, _STRIP):
        part = slice(start, start + _STRIP)
        flat = [each.reshape(-1)[part] for each in frames]
        at = None if light is None else light.reshape(-1)[part]
        for _ in range(1 if light is not None else 4):
            above = np.zeros(flat[0].size, np.float32)
            below = np.zeros(flat[0].size, np.float32)
            for frame, exposure in zip(flat, case.exposures, strict=True):
                x = exposure * nodes
                variance = sensor.variance(x, case.noise) + sensor.step(x) ** 2 / 12
                table = (exposure**2 / variance).astype(np.float32)
                weight = (frame <= highest) * (
                    np.float32(exposure) if at is None else np.interp(at, nodes, table)
                )
                above += (weight * values[frame] / exposure).astype(np.float32)
                below += weight.astype(np.float32)
            at = np.where(below > 0, above / np.maximum(below, 1e-30), sensor.full)
        found[part] = at
    return found.reshape(shape)


def by_opencv(kind: str, frames: Frames, case: Case, real: CameraResponse) -> NDArray[np.float32]:
    """Return OpenCV's merge with the true response."""
    table = SensorModel(real, 0).light.astype(np.float32)
    table = np.ascontiguousarray(np.broadcast_to(table[:, None, None], (256, 1, 3)))
    merging = cv2.createMergeDebevec() if kind == "Debevec" else cv2.createMergeRobertson()
    colours = frames if case.is_colour else [np.repeat(each[..., None], 3, 2) for each in frames]
    found = merging.process(colours, np.array(case.exposures, np.float32), table)
    return np.asarray(found if case.is_colour else found[..., 0])


def errors(found: NDArray[Any], light: Floats, least: float) -> list[float]:
    """Return the rms of ln(found / light) by decade; NaN where few samples are."""
    ratio = np.log(np.maximum(found, least) / light)
    rows = []
    for k in DECADES:
        within = (light >= max(10.0**k, 2 * least)) & (light < 10.0 ** (k + 1))
        many = np.count_nonzero(within) >= _LEAST
        rows.append(float(np.sqrt(np.mean(ratio[within] ** 2))) if many else np.nan)
    return rows


def measured(case: Case, curves: Any, seed: int) -> tuple[Floats, Floats, Floats]:
    """Print a row; return ratios by decade to the best rival, to each rival, and the z scores."""
    real = measured_response(curves["irradiance"][case.curve], curves["brightness"][case.curve])
    light = light_of(case)
    frames = shot(case, light, real, seed)
    began = time.process_time()
    found = camctl.combine(
        frames,
        case.exposures,
        response=real,
        # The headers of files state it: OpenCV writes them as 4:2:0.
        few_chroma_samples=case.is_colour and case.quality is not None,
        brightness_steps=stated_steps(case),
    )
    spent = time.process_time() - began
    least = float(real.levels[0]) / max(case.exposures) / 2
    mine = errors(found.irradiance, light, least)
    rivals = [
        errors(inverse_variance(frames, case, real, None), light, least),
        *(
            errors(by_opencv(kind, frames, case, real), light, least)
            for kind in ("Debevec", "Robertson")
        ),
        errors(inverse_variance(frames, case, real, light), light, least),
    ]
    each = np.array(mine) / np.array(rivals)
    worst = each[:-1].max(axis=0)  # the last one knows the true light
    with np.errstate(invalid="ignore"):
        z = (found.irradiance - light) / found.sd
    within = (found.mask & 3 == 0) & np.isfinite(found.sd) & (light >= 2 * least)
    size = np.abs(z[within])
    scores = (
        np.array([z[within].std(), np.mean(size < 0.99446), np.mean(size < 1.95996)])
        if within.any()
        else np.full(3, np.nan)
    )
    unknown = float(np.isnan(found.sd).mean())
    cells = " | ".join("-" if np.isnan(x) else f"{x:.3f}" for x in worst)
    own = ", ".join("-" if np.isnan(x) else f"{100 * x:.2f}" for x in mine)
    print(
        f"| {case.name} | {own} | {cells} | {scores[0]:.3f} | {scores[1]:.1%} | {scores[2]:.1%} | "
        f"{unknown:.1%} | {spent:.1f} s |",
        flush=True,
    )
    return worst, each, scores


def main() -> None:
    """Print a row for each set, and a summary."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("curves")
    parser.add_argument("--memorial")
    parser.add_argument("--sets", type=int, default=40)
    parser.add_argument("--only", help="numbers of sets, from 0")
    given = parser.parse_args()
    curves = np.load(given.curves)
    chosen = list(enumerate(cases(len(curves["irradiance"]), given.sets, given.memorial)))
    if given.only:
        chosen = [chosen[int(each)] for each in given.only.split(",")]
    names = " | ".join(f"1e{k}" for k in DECADES)
    print(f"| set | error by decade, % | {names} | z | 68 % | 95 % | sd unknown | processor |")
    print("|---|---|" + "---|" * (len(DECADES) + 5))
    rows = [measured(case, curves, seed) for seed, case in chosen]
    for is_jpeg in (False, True):
        kept = [
            row
            for row, (_, case) in zip(rows, chosen, strict=True)
            if is_jpeg == bool(case.quality)
        ]
        if kept:
            summary("JPEG" if is_jpeg else "PNG", kept)


def summary(name: str, rows: Sequence[tuple[Floats, Floats, Floats]]) -> None:
    """Print how many decades and sets are within the limits."""
    worst = np.concatenate([row[0] for row in rows])
    worst = worst[np.isfinite(worst)]
    scores = np.array([row[2] for row in rows])
    scores = scores[np.isfinite(scores[:, 0])]
    print(
        f"{name}: {worst.size} decades, ratio to the best rival: median {np.median(worst):.3f}, "
        f"largest {worst.max():.3f}, at most 1.00 in {np.mean(worst <= 1.0):.0%}, at most 1.02 in "
        f"{np.mean(worst <= 1.02):.0%}"
    )
    for k, rival in enumerate(RIVALS):
        each = np.concatenate([row[1][k] for row in rows])
        each = each[np.isfinite(each)]
        print(f"  {rival}: median {np.median(each):.3f}, largest {each.max():.3f}")
    inside = [
        np.mean((scores[:, k] >= low) & (scores[:, k] <= high))
        for k, (low, high) in enumerate(((0.95, 1.05), (0.66, 0.70), (0.94, 0.96)))
    ]
    print(
        f"  of {len(scores)} sets with known sd: z 0.95 to 1.05 in {inside[0]:.0%}, 66 to 70 % in "
        f"{inside[1]:.0%}, 94 to 96 % in {inside[2]:.0%}"
    )


if __name__ == "__main__":
    main()
