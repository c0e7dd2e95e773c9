"""Effective levels that a calibrated camera promises, beside those measured against the scene.

Each simulated preset is opened so that it states neither response, noise nor control delay; what
`camctl calibrate all` does measures them before one scene.  Then a ramp that is even in u is shot,
and the effective levels that the report promises are compared with (12 mse)^(-1/2) of image.tiff
against the ramp.  The lens is a perfect one: it would change the light itself.  The scene is lit so
that its highlights need as long as those of the ramp: in light so bright that exposures are as
short as the read-out, the smear of a CCD adds to them, and no response describes that.  No single
scene shows how the sensitivity of the pixels varies (PRNU): sensors that vary are shown again after
`camctl calibrate noise --flat` and `--dark`, as "SENSOR, flat, dark".  Run by hand:
``python tests/bench/bench_profile.py [SENSOR...]``; a few minutes.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from contextlib import AbstractContextManager
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "helpers"))

from accuracy import RAMP_COLUMNS, SEED, ramp_base_s, sensor_without_lens, shoot_ramp

from camctl.calibration.noise.dark import measure_dark
from camctl.calibration.noise.shooting import measure_noise
from camctl.calibration.steps import StepOptions, calibrate
from camctl.interface.camera import Camera
from camctl.profiles.calibrated import with_profile
from camctl.profiles.exposures import exposure_mode
from camctl.profiles.profile import Profile, change_profile
from camctl.sim.camera import SimulatedCamera
from camctl.sim.render import Renderer
from camctl.sim.scenes.scene import Scene, load_scene
from camctl.sim.scenes.view import View
from camctl.sim.sensors.sensor import Sensor, sensor_names

CALIBRATED_BEFORE = "tile-floor"
ROWS = 300
TURNED = (17, 29)
"""Rows and columns by which the camera is turned for a second view."""
CAPTURES = (
    ("linear", 256.0, (1.0, 1.003, 2.985)),
    ("gamma", 1000.0, (1.0, 1.003, 5.146)),
    ("log", 1000.0, (1.0, 9.91, 88.38)),
)
LIMIT = 0.05
"""Largest relative difference of promised and measured levels that is allowed."""


def main() -> int:
    """Print one line for each preset and desired response; return 1 if one is above the limit."""
    parser = argparse.ArgumentParser()
    # Photon counters have too few levels for a response.
    names = [name for name in sensor_names() if not name.startswith("quanta")]
    parser.add_argument("sensors", nargs="*", default=names, metavar="SENSOR")
    parser.add_argument("--asked", default="turn,cover", help="what is done when it is asked for")
    arguments = parser.parse_args()
    worst = 0.0
    print(
        "sensor                response  promised  measured  difference  promised if stated",
        flush=True,
    )
    for name in arguments.sensors:
        sensor = sensor_without_lens(name)
        with tempfile.TemporaryDirectory() as folder:
            os.environ["CAMCTL_PROFILES"] = folder
            _calibrate(sensor, set(arguments.asked.split(",")))
            worst = max(worst, _compare(sensor, name))
            if sensor.pixels.prnu:
                _calibrate_noise(sensor)
                worst = max(worst, _compare(sensor, f"{name}, flat, dark"))
    print(f"largest difference {worst:.1%}; allowed {LIMIT:.0%}", flush=True)
    return int(worst > LIMIT)


def _compare(sensor: Sensor, name: str) -> float:
    """Print a line for each desired response; return the largest difference."""
    worst = 0.0
    for response, dynamic_range, ratios in CAPTURES:
        what = (sensor, response, dynamic_range, ratios, ROWS)
        report, measured = shoot_ramp(*what, is_unknown=True)
        stated = shoot_ramp(*what)[0].achieved.effective_levels
        promised = report.achieved.effective_levels
        difference = promised / measured - 1
        worst = max(worst, abs(difference))
        print(
            f"{name:22}{response:8}{promised:10.1f}{measured:10.1f}{difference:+12.1%}"
            f"{stated:20.1f}",
            flush=True,
        )
    return worst


def _calibrate_noise(sensor: Sensor) -> None:
    """Measure the noise again before an evenly lit surface and with the lens cap, and keep it."""
    lit = np.full((ROWS, RAMP_COLUMNS), _full_scale(sensor) / 2, np.float32)
    camera = SimulatedCamera(Scene("flat", lit), sensor, is_unknown=True, seed=SEED)
    capped = SimulatedCamera(
        Scene("cap", lit * np.float32(1e-9)), sensor, is_unknown=True, seed=SEED
    )
    mode = exposure_mode(camera.controls)
    record = measure_noise(with_profile(camera, ("response",)), is_flat=True)
    record = record.model_copy(update={"dark": measure_dark(capped, record)})

    def keep(profile: Profile) -> None:
        profile.noises[mode] = record.joined(profile.noises[mode])

    change_profile(camera.info, keep)


def _full_scale(sensor: Sensor) -> float:
    """Return the light that gives full scale in the shortest exposure of the ramp."""
    return sensor.full_scale_e / sensor.quantum_efficiency / ramp_base_s(sensor)


def _calibrate(sensor: Sensor, asked: set[str]) -> None:
    """Do what `camctl calibrate all` does; the camera is turned and covered as `asked` says."""
    rows, columns = ROWS + TURNED[0], RAMP_COLUMNS + TURNED[1]
    light = load_scene(CALIBRATED_BEFORE, (rows, columns)).irradiance
    light = (light / np.quantile(light, 0.99) * _full_scale(sensor)).astype(np.float32)
    scene, turned = (
        Scene(CALIBRATED_BEFORE, np.ascontiguousarray(light[row:, column:][:ROWS, :RAMP_COLUMNS]))
        for row, column in ((0, 0), TURNED)
    )
    cameras = []

    def opened(parts: str) -> AbstractContextManager[Camera]:
        camera = SimulatedCamera(scene, sensor, is_unknown=True, seed=SEED)
        cameras.append(camera)
        used = () if parts == "none" else tuple(parts.split(","))
        return with_profile(camera, used)

    capped = Scene("cap", np.full_like(scene.irradiance, 1e-9))

    def shown(view: Scene) -> bool:
        cameras[-1]._renderer = Renderer(View.of(view, sensor), sensor, seed=SEED)
        return True

    options = StepOptions(
        turn=(lambda: shown(turned)) if "turn" in asked else None,
        cover=(lambda: shown(capped)) if "cover" in asked else None,
    )
    for step in calibrate(opened, options):
        if step.problem is not None:
            print(f"{sensor.name:16}{step.name} not measured: {step.problem}", flush=True)
        elif step.name in ("pixels", "dark signal"):
            print(f"{sensor.name:16}{step.name}: {step.result}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
