"""Scenes that do not move before cameras with measured responses: answers, errors, intervals.

    CAMCTL_DATA=DIR python tests/bench/bench_response_curves.py

DIR holds dorf/curves.npz: `index`, `irradiance` and `brightness` of curves of Grossberg and Nayar's
Database of Response Functions.  Six frames of 8 bits, a factor of 2 apart, with a full well of
20,000 electrons, show a room, and overlapping blocks of one light each, whose edges are sharp.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np

from camctl.calibration.response.estimate import estimate_response
from camctl.calibration.response.series import Series
from camctl.errors import DataError
from camctl.interface.controls import Layout
from camctl.model.quantiles import Z_95
from camctl.model.response.camera import FloatArray, srgb_to_linear
from camctl.sim.scenes.drawings import DRAWINGS

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "helpers"))

from scene_maps import blocks

EXPOSURES = 2.0 ** np.arange(-3, 3)
FULL_E, READ_E = 2e4, 5.0


def scenes() -> dict[str, FloatArray]:
    """Return irradiance, saturated in 2 % of the samples at exposure 1."""
    room = np.asarray(DRAWINGS["room"](240, 320)).mean(axis=2)
    return {
        name: E / np.quantile(E, 0.98)
        for name, E in (("room", room), ("blocks", blocks(np.random.default_rng(7))))
    }


def series_of(E: FloatArray, irradiance: FloatArray, brightness: FloatArray, seed: int) -> Series:
    rng, series = np.random.default_rng(seed), Series(Layout.MONO, 8, levels_are_stated=True)
    for number, exposure in enumerate(EXPOSURES.tolist()):
        charge = FULL_E * E * exposure
        charge = charge + np.sqrt(charge + READ_E**2) * rng.normal(size=E.shape)
        level = 256 * np.interp(np.clip(charge / FULL_E, 0, 1), irradiance, brightness)
        series.add(np.minimum(level, 255).astype(np.uint8), exposure, f"frame {number}")
    return series


def main() -> None:
    data = np.load(Path(os.environ["CAMCTL_DATA"]) / "dorf" / "curves.npz")
    curves = list(zip(data["index"].tolist(), data["irradiance"], data["brightness"], strict=True))
    flatness = [
        np.log(srgb_to_linear(np.array(0.05))) / np.log(np.interp(0.05, brightness, irradiance))
        for _, irradiance, brightness in curves
    ]
    print("times as flat as sRGB at 5 %, quantiles 0, 5, 10, 50, 90, 95, 100 %:")
    print(np.quantile(flatness, (0, 0.05, 0.1, 0.5, 0.9, 0.95, 1)).round(2))
    errors, inside, refused = [], [], 0
    for name, E in scenes().items():
        for index, irradiance, brightness in curves:
            try:
                found = estimate_response(series_of(E, irradiance, brightness, index))
            except DataError as error:
                refused += 1
                print(f"{name}, curve {index}: {error}")
                continue
            channel = found.record.main_channel
            at = np.linspace(max(0.05, channel.measured[0]), min(0.95, channel.measured[1]), 60)
            logs = np.log(
                np.interp(at, channel.brightness, channel.irradiance)
                / np.interp(at, brightness, irradiance)
            )
            errors.append(float(np.std(logs)))
            half = np.log(
                np.interp(0.5, channel.brightness, channel.irradiance)
                / np.interp(0.5, brightness, irradiance)
            )
            deviation = np.interp(at, channel.brightness, channel.deviation or (0.0,))
            inside.append(float(np.mean(np.abs(logs - half) <= Z_95 * deviation)))
    print(
        f"{len(errors)} answered, {refused} refused; error of ln(irradiance): median "
        f"{np.median(errors):.4f}, 90 % {np.quantile(errors, 0.9):.4f}; in the 95 % intervals: "
        f"{np.mean(inside):.1%} of the levels"
    )


if __name__ == "__main__":
    main()
