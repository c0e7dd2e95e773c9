"""Whether measured noise has the truth in its 95 % intervals, and agrees with the package emva1288.

    python tests/bench/bench_noise_calibration.py [--runs 200] [--only coverage|emva1288]

Coverage: `--runs` runs in all on simulated cameras of known noise, in turn, each with another seed;
each figure's share of intervals with the truth in it must be 91 to 98 %, as 200 runs with a true
coverage of 95 % have.  Full well: what saturates a sample, by the well or the end of the ADC.

Agreement: conversion gain, read noise, PRNU and DSNU from the same flat and dark frames, by the
package in an environment of its own, which the bench makes with pip; and the parameters that the
frames were simulated with.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
import venv
from collections import defaultdict
from pathlib import Path

import numpy as np

from camctl.calibration.noise.dark import DarkFrames, estimate_dark, measure_dark
from camctl.calibration.noise.estimate import NoiseFrames, estimate_noise, same_response
from camctl.calibration.noise.pairs import reduce_pair
from camctl.calibration.noise.shooting import measure_noise
from camctl.interface.controls import ExposureSetting, Layout
from camctl.profiles.noise import Figure, NoiseRecord
from camctl.sim.camera import SimulatedCamera
from camctl.sim.scenes.scene import Scene, load_scene
from camctl.sim.sensors.sensor import Sensor, load_sensor

PINNED = (
    "emva1288==1.0.2",
    "numpy==1.26.4",
    "scipy==1.13.1",
    "matplotlib==3.9.4",
    "pillow==11.0.0",
)
LEAST, MOST, AGREEMENT = 0.91, 0.98, 0.02
SHAPE = (240, 320)


def varied(name: str, **changes: object) -> Sensor:
    """Return a built-in sensor with other parameters."""
    fields = load_sensor(name).model_dump(exclude_unset=True)
    return Sensor.model_validate({**fields, **changes})


#: Name, sensor and scene: linear and curved, mono, Bayer and RGB, 8 to 12 bits.
CAMERAS = (
    ("8 bit mono", load_sensor("standard"), "tile-floor"),
    ("10 bit Bayer, gains", load_sensor("phone"), "tile-floor"),
    ("12 bit mono, gains", load_sensor("machine-vision"), "room"),
    ("8 bit RGB, gains", load_sensor("webcam"), "colour-chart"),
    ("8 bit RGB, sRGB curve", load_sensor("consumer"), "tile-floor"),
    (
        "10 bit mono, power curve",
        varied(
            "standard",
            bits=10,
            curve=0.45,
            read_noise_e=6.0,
            full_well_e=10_100,
            electrons_per_dn=9.765625,
        ),
        "tile-floor",
    ),
    (
        "12 bit Bayer, sRGB curve",
        varied("consumer", bits=12, layout="rggb", electrons_per_dn=2.9296875),
        "room",
    ),
    ("14 bit CCD, PRNU, flat field", load_sensor("ccd"), "uniform"),
)


def contains(figure: Figure, true: float) -> bool:
    """Return whether the interval has the truth."""
    return figure.low <= true <= figure.high


def one_run(number: int) -> list[tuple[str, str, bool, float]]:
    """Return (camera, figure, whether the interval has the truth, half its relative width)."""
    name, sensor, scene = CAMERAS[number % len(CAMERAS)]
    noise = sensor.noise_model
    rows = []

    def add(figure: str, found: Figure | None, true: float) -> None:
        assert found is not None
        width = (found.high - found.low) / 2 / true if true else 0.0
        rows.append((name, figure, contains(found, true), width))

    view = load_scene(scene, SHAPE, usual=SHAPE)
    is_flat = scene == "uniform"
    with SimulatedCamera(view, sensor, seed=1000 + number) as camera:
        record = measure_noise(camera, is_flat=is_flat, exposures=8)
    for each in record.gains:
        kind = "" if each.gain == 1 else " at higher gain"
        conversion = noise.conversion_e_per_dn / each.gain
        add(f"conversion gain{kind}", each.conversion_e_per_dn, conversion)
        add(f"read noise{kind}", each.read_noise_e, noise.read_noise(each.gain))
    # In its linear scale the camera has the light of its last level at saturation.
    response = camera.controls.levels
    add("full well", record.full_well_e, float(response.levels[-1]) * sensor.full_scale_e)
    if is_flat:
        add("PRNU", record.prnu, sensor.pixels.prnu)
    return rows + dark_run(number)


def dark_run(number: int) -> list[tuple[str, str, bool, float]]:
    """Return the same for a lens cap, on a sensor whose dark current and offsets differ."""
    sensor = varied(
        "phone",
        dark={"current_e_s": 2.0 + number % 7},
        pixels={"dsnu_e": 1.0 + number % 3},
    )
    true = sensor.noise_model
    conversion = Figure(
        value=true.conversion_e_per_dn, low=true.conversion_e_per_dn, high=true.conversion_e_per_dn
    )
    known = NoiseRecord.model_validate(
        {
            "gains": [
                {
                    "gain": 1.0,
                    "conversion_e_per_dn": conversion.model_dump(),
                    "read_noise_e": {"value": 5.0, "low": 5.0, "high": 5.0},
                    "patches": 1,
                    "misfit": 1.0,
                }
            ],
            "full_well_e": conversion.model_dump(),
            "saturates": True,
            "measured_at": "",
        }
    )
    cap = Scene("cap", np.full((120, 160), 1e-9, np.float32))
    with SimulatedCamera(cap, sensor, seed=5000 + number) as camera:
        found = measure_dark(camera, known)
    return [
        ("lens cap", name, contains(figure, value), (figure.high - figure.low) / 2 / value)
        for name, figure, value in (
            ("dark current", found.dark_current_e_s, true.dark_current_e_s),
            ("DSNU", found.dsnu_e, true.dsnu_e),
        )
    ]


def coverage(runs: int) -> bool:
    """Print the coverage of each figure; return whether all are within the limits."""
    by_figure: dict[str, list[tuple[bool, float]]] = defaultdict(list)
    by_camera: dict[str, list[bool]] = defaultdict(list)
    began = time.perf_counter()
    for number in range(runs):
        for camera, figure, is_inside, width in one_run(number):
            by_figure[figure].append((is_inside, width))
            by_camera[camera].append(is_inside)
        if number % 20 == 19:
            print(f"{number + 1} runs, {time.perf_counter() - began:.0f} s", file=sys.stderr)
    good = True
    print(
        f"{runs} runs\nfigure                          intervals  with the truth  +- (median)",
        flush=True,
    )
    for name, values in by_figure.items():
        share = np.mean([is_inside for is_inside, _ in values])
        # The limits are for 200 intervals; fewer scatter more.
        slack = 0.0 if len(values) >= 200 else 2 * np.sqrt(0.05 * 0.95 / len(values))
        good &= bool(LEAST - slack <= share <= MOST + slack)
        width = np.median([width for _, width in values])
        print(f"{name:32}{len(values):8}{share:15.1%}{width:13.2%}", flush=True)
    total = [is_inside for values in by_figure.values() for is_inside, _ in values]
    print(f"{'all':32}{len(total):8}{np.mean(total):15.1%}", flush=True)
    for name, inside in by_camera.items():
        print(f"  {name:30}{len(inside):8}{np.mean(inside):15.1%}", flush=True)
    return good and LEAST <= float(np.mean(total)) <= MOST


def reference_python(folder: Path) -> Path:
    """Make a virtual environment with the package, unless it is there; return its Python."""
    python = folder / "bin" / "python"
    if not (folder / "done").exists():
        venv.create(folder, with_pip=True, clear=True)
        install = [
            str(python),
            "-m",
            "pip",
            "install",
            "--quiet",
            "--only-binary",
            ":all:",
            *PINNED,
        ]
        subprocess.run(install, check=True, timeout=600)
        (folder / "done").touch()
    return python


def agreement(folder: Path, frames_folder: Path) -> bool:
    """Print both results for flat and dark frames; return whether they agree."""
    good = True
    python = reference_python(folder)
    sensors = {
        "machine-vision": varied("machine-vision", pixels={"prnu": 0.008, "dsnu_e": 1.5}),
        "ccd": varied("ccd", lens={}),  # the standard's flat field has no lens, which shades
    }
    for name, sensor in sensors.items():
        ours, named = flat_and_dark(sensor, frames_folder)
        descriptor = frames_folder / "images.json"
        descriptor.write_text(json.dumps(named))
        script = Path(__file__).with_name("emva1288_reference.py")
        ran = subprocess.run(
            [str(python), str(script), str(descriptor)],
            check=True,
            capture_output=True,
            timeout=600,
        )
        theirs = json.loads(ran.stdout)
        model = sensor.noise_model
        given = {
            "conversion_e_per_dn": model.conversion_e_per_dn,
            "read_noise_e": model.read_noise_e[0][1],
            "prnu": model.prnu,
            "dsnu_e": model.dsnu_e,
        }
        for figure, value in theirs.items():
            difference = ours[figure] / value - 1
            good &= abs(difference) <= AGREEMENT
            off = value / given[figure] - 1
            print(
                f"{name:16}{figure:22} simulated {given[figure]:9.5g}, emva1288 {value:9.5g}:"
                f" {off:+.2%}, camctl {ours[figure]:9.5g}: {difference:+.2%}",
                flush=True,
            )
    return good


def flat_and_dark(
    sensor: Sensor, folder: Path
) -> tuple[dict[str, float], dict[str, dict[float, dict[float, list[str]]]]]:
    """Return the figures by camctl, and the names of the same frames for the package."""
    shape, photons_s = (480, 640), 1e5
    full_s = sensor.full_well_e / sensor.quantum_efficiency / photons_s
    flat = Scene("flat", np.full(shape, photons_s, np.float32))
    cap = Scene("cap", np.full(shape, 1e-9, np.float32))
    named: dict[str, dict[float, dict[float, list[str]]]] = {"temporal": {}, "spatial": {}}
    with (
        SimulatedCamera(flat, sensor, seed=7) as lit,
        SimulatedCamera(cap, sensor, seed=7) as dark,
    ):
        controls = lit.controls
        times = sorted(
            {controls.time_s.nearest(float(each)) for each in full_s * np.linspace(0.02, 1.15, 24)}
        )
        middle = min(times, key=lambda each: abs(each - full_s / 2))
        frames = NoiseFrames(
            Layout.MONO,
            controls.black,
            controls.white,
            same_response(controls.levels, Layout.MONO),
            is_flat=True,
        )
        offsets = DarkFrames(controls.black, controls.white)
        for time_s in times:
            count = 16 if time_s == middle else 2
            for photons, camera in ((0.0, dark), (photons_s * time_s, lit)):
                files = []
                setting = ExposureSetting(time_s)
                pixels = [each.pixels for each in camera.shoot([setting] * count)]
                for k, each in enumerate(pixels):
                    files.append(str(folder / f"{photons:g}-{time_s:g}-{k}.npy"))
                    np.save(files[-1], each)
                named["temporal"].setdefault(time_s, {})[photons] = files[:2]
                if count > 2:
                    named["spatial"].setdefault(time_s, {})[photons] = files
                limits = (controls.black, controls.white)
                for first, second in zip(pixels[::2], pixels[1::2], strict=True):
                    pair = reduce_pair(first, second, setting, Layout.MONO, limits)
                    frames.pairs.append(pair)
                if not photons:
                    for each in pixels[:2]:
                        offsets.add(each, time_s)
    record = estimate_noise(frames)
    assert record.prnu is not None
    of_dark = estimate_dark(offsets, record.reference)
    ours = {
        "conversion_e_per_dn": record.reference.conversion_e_per_dn.value,
        "read_noise_e": record.reference.read_noise_e.value,
        "prnu": record.prnu.value,
        "dsnu_e": of_dark.dsnu_e.value,
    }
    return ours, named


def main() -> int:
    """Print both tables; return 1 if a limit is exceeded."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--only", choices=("coverage", "emva1288"))
    parser.add_argument(
        "--environment",
        type=Path,
        default=Path(tempfile.gettempdir()) / "camctl-emva1288",
        help="folder of the virtual environment of the package",
    )
    arguments = parser.parse_args()
    good = True
    if arguments.only != "coverage":
        with tempfile.TemporaryDirectory() as folder:
            good &= agreement(arguments.environment, Path(folder))
    if arguments.only != "emva1288":
        good &= coverage(arguments.runs)
    return int(not good)


if __name__ == "__main__":
    sys.exit(main())
