"""The sum with its inverse against other ways to combine the same frames: error and time.

    python tests/bench/bench_rivals.py [--megapixels 24] [--size 640x480]

Needs scipy, for the monotone map of Mertens.  The simulated camera takes 8-bit frames of two scenes
with a linear and with a curved response; the truth is the light that the simulation began with.
Errors are the root mean square of ln(estimate / truth) by decade of irradiance, where 1 saturates
the shortest exposure, in per cent.  What each method is given:

sum and inverse        the camera's response and noise, and the exposures (as `camctl shoot`)
inverse variance       the response, and weights from the true light: no real merge can know those
Debevec, Robertson     the camera's response, as OpenCV's table of 256 irradiances
... calibrated         a response that OpenCV's own calibration finds from the same frames
Mertens                has no radiance; the best monotone map from its result to the truth is used

Where the response is calibrated, the scale of each channel is unknown: the best one is used.  No
estimate is below half of the first level of the longest exposure: the logarithm of 0 does not
exist.  Samples that are saturated in the shortest exposure are left out.  Times are those of one
run on mono frames of 24 MP, repeated from the small ones, with tables made before.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression

from camctl.captures.sequencer import capture
from camctl.exposure.goal import CaptureRequest
from camctl.model.effective import EffectiveCamera
from camctl.model.inverse import Posterior
from camctl.model.response.camera import CameraResponse
from camctl.model.response.desired import desired_response
from camctl.pictures.accumulator import Accumulator
from camctl.profiles.calibrated import open_camera
from camctl.sim.scenes.scene import load_scene
from camctl.sim.scenes.view import View
from camctl.sim.sensors.sensor import Sensor, load_sensor

Floats = NDArray[np.floating]

DECADES = (-4, -3, -2, -1)
"""Each from 10^k to 10^(k+1)."""

RANGE = 10_000.0
_STRIP = 1 << 20
_BINS = 4096


@dataclass(frozen=True)
class Case:
    """One scene, sensor and set of exposures, with its frames.

    Attributes:
        name: for the table
        frames: uint8, (rows, columns[, 3])
        exposures: of the frames, relative to the shortest
        truth: irradiance at exposure 1, in the shape of a frame
        response: of the camera
        sensor: that took the frames
        sum_result: the radiance that camctl gives, as irradiance at exposure 1
    """

    name: str
    frames: tuple[NDArray[np.uint8], ...]
    exposures: tuple[float, ...]
    truth: Floats
    response: CameraResponse
    sensor: Sensor
    sum_result: Floats

    @property
    def times(self) -> NDArray[np.float32]:
        """The exposures as OpenCV takes them."""
        return np.array(self.exposures, np.float32)

    @property
    def table(self) -> Floats:
        """The irradiance of each brightness 0 to 255: the middle of its interval."""
        edges = np.concatenate([[0.0], self.response.levels, [1.0]])
        return np.asarray((edges[:-1] + edges[1:]) / 2)

    @property
    def opencv_table(self) -> NDArray[np.float32]:
        """The same in the layout of OpenCV, (256, 1, 3)."""
        return np.ascontiguousarray(np.broadcast_to(self.table[:, None, None], (256, 1, 3)), "f4")

    @property
    def opencv_frames(self) -> list[NDArray[np.uint8]]:
        """The frames in three channels, which are equal if they are mono: Robertson needs them."""
        if self.truth.ndim == 3:
            return list(self.frames)
        return [np.repeat(frame[..., np.newaxis], 3, axis=2) for frame in self.frames]

    def plane(self, result: NDArray[Any]) -> Floats:
        """Return a result for `opencv_frames` in the shape of a frame."""
        return np.asarray(result if self.truth.ndim == 3 else result[..., 0], np.float64)


def shoot(scene_name: str, sensor_name: str, ratios: Sequence[float], size: str) -> Case:
    """Take frames whose highlights (the 99.9th percentile) are just below saturation."""
    sensor = load_sensor(sensor_name)
    columns, rows = (int(part) for part in size.split("x"))
    light = View.of(load_scene(scene_name, (rows, columns)), sensor).light
    per_second = light.astype(np.float64) * sensor.quantum_efficiency / sensor.full_scale_e
    wanted_s = 0.97 / float(np.quantile(per_second, 0.999))
    with open_camera("sim", {"scene": scene_name, "sensor": sensor_name, "size": size}) as camera:
        request = CaptureRequest(
            response="log",
            dynamic_range=RANGE,
            ratios=tuple(ratios),
            base_s=camera.controls.time_s.nearest(wanted_s),
        )
        report = capture(camera, request)
        response = camera.controls.levels
    times = [frame.applied.time_s for frame in report.frames]
    base_s = min(times)
    shown = ", ".join(f"{time_s / base_s:.4g}" for time_s in times)
    frames = [report.frame(place).astype(np.uint8) for place in range(len(times))]
    full_scale = report.irradiance.full_scale_exposure
    return Case(
        f"{scene_name}, {sensor_name}, {shown}",
        tuple(frames),
        tuple(time_s / base_s for time_s in times),
        per_second * base_s,
        response,
        sensor,
        report.radiance().astype(np.float64) * full_scale,
    )


def inverse_variance(case: Case) -> Floats:
    """Return the mean of the frames, weighted by their inverse variance at the true light."""
    total = np.zeros(case.truth.shape)
    weights = np.zeros(case.truth.shape)
    electrons = case.sensor.full_scale_e
    for frame, e in zip(case.frames, case.exposures, strict=True):
        x = e * case.truth
        slope = np.maximum(case.response.slope(x), 1e-9)
        photon = x / electrons if case.sensor.photon_noise else 0.0
        read = (case.sensor.read_noise_e / electrons) ** 2
        variance = (photon + read + 1 / (12 * slope**2)) / e**2
        weight = np.where(frame < 255, 1 / variance, 0.0)
        total += weight * case.table[frame] / e
        weights += weight
    return np.where(weights > 0, total / np.where(weights > 0, weights, 1.0), 1.0)


def mertens(case: Case) -> Floats:
    """Return Mertens' fusion through the best monotone map to the logarithm of the truth."""
    fused = case.plane(cv2.createMergeMertens().process(case.opencv_frames))
    result = np.empty(case.truth.shape)
    planes = [...] if fused.ndim == 2 else [(..., channel) for channel in range(3)]
    for plane in planes:
        order = np.argsort(fused[plane], axis=None, kind="stable")
        logs = np.log(np.maximum(case.truth[plane].ravel()[order], 1e-9))
        bins = np.array_split(logs, _BINS)
        fitted = isotonic_regression(
            [part.mean() for part in bins], weights=[part.size for part in bins]
        ).x
        mapped = np.empty(order.size)
        mapped[order] = np.repeat(np.exp(fitted), [part.size for part in bins])
        result[plane] = mapped.reshape(result[plane].shape)
    return result


def methods() -> dict[str, Callable[[Case], Floats]]:
    """Return the methods by name; each gives irradiance in any unit."""

    def with_table(merge: Callable[[], cv2.MergeExposures]) -> Callable[[Case], Floats]:
        return lambda case: case.plane(
            merge().process(case.opencv_frames, case.times, case.opencv_table)
        )

    def calibrated(
        calibrate: Callable[[], cv2.CalibrateCRF], merge: Callable[[], cv2.MergeExposures]
    ) -> Callable[[Case], Floats]:
        def run(case: Case) -> Floats:
            response = calibrate().process(case.opencv_frames, case.times)
            return case.plane(merge().process(case.opencv_frames, case.times, response))

        return run

    debevec, robertson = cv2.createMergeDebevec, cv2.createMergeRobertson
    return {
        "sum and inverse": lambda case: case.sum_result,
        "inverse variance, true weights": inverse_variance,
        "Debevec": with_table(debevec),
        "Debevec, calibrated": calibrated(lambda: cv2.createCalibrateDebevec(200), debevec),
        "Robertson": with_table(robertson),
        "Robertson, calibrated": calibrated(cv2.createCalibrateRobertson, robertson),
        "Mertens, best monotone map": mertens,
    }


def errors(case: Case, estimate: Floats, *, is_scaled: bool) -> list[float]:
    """Return the rms of ln(estimate / truth) for each of `DECADES`, NaN without samples.

    With `is_scaled`, each channel is first scaled by the factor that makes the sum of the squares
    of these least.
    """
    lowest = case.response.levels[0] / (2 * max(case.exposures))
    is_in_range = case.frames[int(np.argmin(case.exposures))] < 255
    squares: list[list[float]] = [[] for _ in DECADES]
    planes = [...] if estimate.ndim == 2 else [(..., channel) for channel in range(3)]
    for plane in planes:
        truth, inside = case.truth[plane], is_in_range[plane]
        with np.errstate(divide="ignore"):
            logs = np.log(np.maximum(np.nan_to_num(estimate[plane]), lowest)) - np.log(truth)
        parts = [
            logs[inside & (truth >= 10.0**decade) & (truth < 10.0 ** (decade + 1))]
            for decade in DECADES
        ]
        shift = np.mean([part.mean() for part in parts if part.size > 100]) if is_scaled else 0.0
        for kept, part in zip(squares, parts, strict=True):
            kept.extend(((part - shift) ** 2).tolist())
    return [float(np.sqrt(np.mean(kept))) if len(kept) > 100 else np.nan for kept in squares]


def seconds(work: Callable[[], object], rounds: int = 2) -> float:
    """Return the shortest wall time of a call."""
    spent = []
    for _ in range(rounds):
        start = time.perf_counter()
        work()
        spent.append(time.perf_counter() - start)
    return min(spent)


def times(case: Case, megapixels: float) -> dict[str, float]:
    """Return seconds of each method for large mono frames, repeated from those of the case."""
    rows, columns = case.truth.shape
    across = round((megapixels * 1e6 * columns / rows) ** 0.5 / columns)
    down = max(1, round(megapixels * 1e6 / (across * columns * rows)))
    frames = [np.tile(frame, (down, across)) for frame in case.frames]
    desired = desired_response("log", RANGE)
    effective = EffectiveCamera.of(case.response, case.exposures)
    noise = case.sensor.noise_model.frame(gain=1.0, time_s=0.0)
    inverse = Posterior(effective, desired, [noise] * len(frames)).inverse.E.astype(np.float32)
    values = [case.table / e for e in case.exposures]
    weights = [np.where(np.arange(256) < 255, e / (value + 1e-3), 0.0)
               for e, value in zip(case.exposures, values, strict=True)]  # fmt: skip
    weighted = [(w * v).astype(np.float32) for w, v in zip(weights, values, strict=True)]
    singles = [weight.astype(np.float32) for weight in weights]
    result = np.empty(frames[0].shape, np.float32)
    flat = [frame.reshape(-1) for frame in frames]

    def sum_and_inverse() -> None:
        total = Accumulator(frames[0].shape, np.dtype(np.uint8), len(frames), 255)
        for frame in frames:
            total.accumulate(frame)
        sums = total.total.reshape(-1)
        for start in range(0, sums.size, _STRIP):
            part = slice(start, start + _STRIP)
            result.reshape(-1)[part] = inverse[sums[part]]

    def weighted_mean() -> None:
        for start in range(0, result.size, _STRIP):
            part = slice(start, start + _STRIP)
            above = sum(table[frame[part]] for table, frame in zip(weighted, flat, strict=True))
            below = sum(table[frame[part]] for table, frame in zip(singles, flat, strict=True))
            result.reshape(-1)[part] = above / np.maximum(below, np.float32(1e-9))

    # OpenCV takes three channels: the same samples as a third as many pixels.
    colour = [frame.reshape(frame.shape[0] // 3, -1, 3) for frame in frames]
    table = case.opencv_table
    return {
        "sum and inverse": seconds(sum_and_inverse),
        "inverse variance, true weights": seconds(weighted_mean),
        "Debevec": seconds(lambda: cv2.createMergeDebevec().process(colour, case.times, table)),
        "Robertson": seconds(lambda: cv2.createMergeRobertson().process(colour, case.times, table)),
        "Mertens, best monotone map": seconds(lambda: cv2.createMergeMertens().process(colour)),
    }


def main() -> None:
    """Print one table: a line for each case and method."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--megapixels", type=float, default=24)
    parser.add_argument("--size", default="640x480")
    chosen = parser.parse_args()
    cases = [
        shoot(scene, sensor, ratios, chosen.size)
        for scene, sensor in (("tile-floor", "standard"), ("room", "consumer"))
        for ratios in ((1, 4, 16), (1, 10, 90))
    ]
    spent = times(cases[0], chosen.megapixels)
    names = " | ".join(f"1e{decade} to 1e{decade + 1}" for decade in DECADES)
    print(f"| frames | method | {names} | {chosen.megapixels:g} MP mono |")
    print("|---|---|" + "---|" * (len(DECADES) + 1))
    for case in cases:
        for name, method in methods().items():
            found = errors(case, method(case), is_scaled=name.endswith(", calibrated"))
            cells = ["-" if np.isnan(e) else f"{100 * e:.3g} %" for e in found]
            cost = spent.get(name.removesuffix(", calibrated"))
            timing = "-" if cost is None or case is not cases[0] else f"{cost:.2f} s"
            print(f"| {case.name} | {name} | {' | '.join(cells)} | {timing} |", flush=True)


if __name__ == "__main__":
    main()
