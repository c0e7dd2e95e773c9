"""Leaving effects out never changes a frame by more than its bound.

Scenes, sensors and exposures are random, half of them of the kinds in which rounding matters most:
sensors that count photons, light that is nearly uniform, much dark current, long exposures.  The
frame with effects left out and the frame with every effect have the same random bits, so that only
what was left out makes a difference.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from camctl.interface.camera import Pixels
from camctl.sim.effects.bounds import Bounds
from camctl.sim.effects.budget import greedy, plan_frame
from camctl.sim.effects.record import Shot
from camctl.sim.render import Renderer
from camctl.sim.scenes.motion import Lamps, PwmLamps, Target
from camctl.sim.scenes.scene import Scene, load_scene
from camctl.sim.scenes.view import Light, View
from camctl.sim.sensors.parts import Dark, Lens
from camctl.sim.sensors.sensor import Sensor, load_sensor

CASES = 833  # 5,000 in all
CHUNKS = 6


def log_uniform(random: np.random.Generator, low: float, high: float) -> float:
    return float(low * (high / low) ** random.random())


def a_scene(random: np.random.Generator) -> Scene:
    rows, columns = (int(n) for n in random.integers(1, 28, 2))
    shape = (rows, columns, 3) if random.random() < 0.3 else (rows, columns)
    kind = random.integers(6)
    if kind == 0:
        light = np.full(shape, random.random())
    elif kind == 1:
        along = int(random.integers(2))
        ramp = np.linspace(random.random() * 0.2, 1, shape[along])
        light = np.moveaxis(
            np.broadcast_to(ramp, (*np.delete(shape, along), shape[along])), -1, along
        )
    elif kind == 2:
        light = random.random(shape)
    elif kind == 3:
        light = np.exp(random.normal(0, 3, shape))
    elif kind == 4:
        light = (random.random(shape) < 0.05) * 1.0 + 1e-3 * random.random()
    else:
        light = 0.5 + 1e-3 * random.random(shape)
    irradiance: NDArray[np.float64] = np.maximum(np.asarray(light, dtype=np.float64), 0)
    irradiance[(0,) * irradiance.ndim] += 1e-6
    lamps: Lamps | PwmLamps = Lamps(float(random.choice([50.0, 60.0])), random.random() * 0.9)
    if random.random() < 0.4:
        lamps = PwmLamps(log_uniform(random, 10, 1e4), random.uniform(0.01, 1), random.random())
    target = None
    if random.random() < 0.35:
        height, width = (int(n) for n in random.integers(1, 9, 2))
        surface = random.random((height, width, *shape[2:])) * random.choice([0.1, 1.0, 5.0])
        target = Target(
            surface.astype(np.float32),
            random.random((height, width)).astype(np.float32),
            int(random.integers(-4, rows + 2)),
            float(random.uniform(-5, columns + 5)),
            float(random.choice([-1, 1])) * log_uniform(random, 0.1, 1e4),
        )
    return Scene(
        "random",
        irradiance.astype(np.float32),
        photons_per_unit=log_uniform(random, 1e2, 1e8),
        lamps=lamps if random.random() < 0.4 else None,
        target=target,
    )


def some(random: np.random.Generator, low: float, high: float) -> float:
    return log_uniform(random, low, high) if random.random() < 0.7 else 0.0


def a_sensor(random: np.random.Generator) -> Sensor:
    bits = int(random.integers(4, 15))
    black = int(random.integers(0, max(1, 2**bits // 8))) if random.random() < 0.5 else 0
    well = log_uniform(random, 500, 50_000)
    curved = black == 0 and random.random() < 0.1
    per_dn = well / (2**bits - black) / (1.3 if curved else 1.0)
    layout = (None, "mono", "rgb", "rggb", "gbrg")[int(random.integers(5))]
    fields: dict[str, Any] = {
        "name": "random",
        "bits": bits,
        "black": black,
        "phase": float(random.choice([0.0, 0.5])),
        "full_well_e": well,
        "electrons_per_dn": per_dn,
        "layout": layout,
        "photon_noise": bool(random.random() < 0.9),
        "read_noise_e": some(random, 0.001, well / 400),
        "gain_maximum": 8.0,
        "time_minimum_s": 1e-6,
        "line_s": 1e-6,
        "time_maximum_s": 1000.0,
        "curve": "srgb" if curved else "linear",
        "lens": {
            "vignetting": some(random, 1e-6, 0.6),
            "glare": some(random, 1e-6, 0.2),
            "blur_px": some(random, 0.05, 2.5),
            "f_number": log_uniform(random, 1, 30),
            "diffraction": bool(random.random() < 0.4),
            "lateral_colour": some(random, 1e-5, 0.05) if random.random() < 0.5 else 0.0,
        },
        "dark": {
            "current_e_s": some(random, 1e-4, 1e3),
            "temperature_c": float(random.uniform(-20, 60)),
            "hot_share": some(random, 1e-4, 0.02),
            "hot_rate_e_s": some(random, 1e-2, 1e4),
            "hot_decades": some(random, 0.1, 8),
            "dcnu_e_s": some(random, 1e-4, 1e3) if random.random() < 0.6 else 0.0,
        },
        "pixels": {
            "prnu": some(random, 1e-7, 0.05),
            "dsnu_e": some(random, 1e-3, well / 400),
            "crosstalk": some(random, 1e-7, 0.1),
            "blooming": some(random, 0.01, 1.0),
            "smear_s": some(random, 1e-9, 1e-3),
            "lag": some(random, 1e-7, 0.2),
        },
        "read_out": {
            "row_noise_e": some(random, 1e-3, well / 400),
            "column_noise_e": some(random, 1e-3, well / 400),
            "row_s": some(random, 1e-7, 1e-3),
            "pink_share": random.random(),
            "adc_noise_e": some(random, 1e-3, well / 400),
            "rts_share": some(random, 1e-4, 0.1),
            "rts_e": some(random, 1e-2, well / 40),
            "reset_s": some(random, 1e-8, 1e-3) if random.random() < 0.5 else 0.0,
            "nonlinearity_dn": 0.0 if curved else min(some(random, 0.001, 3), 2**bits / 16),
            "cosmic_rate_s": some(random, 1, 1e5),
        },
    }
    if layout != "mono" and random.random() < 0.3:
        fields["spectrum"] = (random.random((3, 3)) * 0.5).tolist()
    return Sensor.model_validate(fields)


@dataclass(frozen=True, eq=False)
class Case:
    """A random scene, sensor and exposure, to be rendered with and without some effects."""

    renderer: Renderer
    shot: Shot
    sensor: Sensor

    def measured(self, left_out: tuple[str, ...]) -> tuple[float, int]:
        """Return the largest difference to the full frame: DN before the ADC, levels after it."""
        before, after = self.rendered(left_out)
        full_before, full_after = self.full
        largest = float(np.abs(before.astype(np.float64) - full_before).max())
        return largest, int(np.abs(after.astype(int) - full_after).max())

    @cached_property
    def bounds(self) -> Bounds:
        """The bounds of the exposure."""
        return Bounds(self.shot)

    @cached_property
    def full(self) -> tuple[Light, Pixels]:
        """The frame with every effect, before and after the ADC."""
        return self.rendered(())

    def rendered(self, left_out: tuple[str, ...]) -> tuple[Light, Pixels]:
        """Return a frame before and after the ADC; before it is 0 for a sensor with a curve."""
        plan = plan_frame(self.shot, 0.0, left_out=left_out, bounds=self.bounds)
        if self.sensor.response is not None:
            pixels = self.renderer.expose(self.shot, plan)
            return np.zeros(pixels.shape, np.float32), pixels
        before = self.renderer.brightness(self.shot, plan)
        return before, np.clip(before, 0, 2**self.sensor.bits - 1).astype(np.uint16)


def where_rounding_matters(
    random: np.random.Generator, scene: Scene, sensor: Sensor
) -> tuple[Scene, Sensor]:
    """Return the scene with nearly uniform light, before the sensor with photons counted."""
    if random.random() < 0.6:
        differs = 1e-5 * random.random(scene.irradiance.shape) * random.integers(2)
        scene = replace(scene, picture=(0.5 + differs).astype(np.float32))
    fields = sensor.model_dump()
    fields["photon_noise"] = True
    fields["read_noise_e"] = float(random.choice([0.0, 0.27, 1.0, 2.4]))
    if random.random() < 0.5:
        fields["dark"] |= {
            "current_e_s": log_uniform(random, 1, 1e5),
            "dcnu_e_s": log_uniform(random, 1, 1e5),
        }
    return scene, Sensor.model_validate(fields)


def a_case(random: np.random.Generator) -> Case:
    scene, sensor = a_scene(random), a_sensor(random)
    is_hard = random.random() < 0.5
    if is_hard:
        scene, sensor = where_rounding_matters(random, scene, sensor)
    renderer = Renderer(
        View.of(scene, sensor), sensor, seed=int(random.integers(1 << 60)), threads=1
    )
    light = float(scene.irradiance.max()) * scene.photons_per_unit * sensor.quantum_efficiency
    # From almost dark to far beyond the full well.
    time_s = min(log_uniform(random, 1e-4, 5) * sensor.full_well_e / light, 900.0)
    if is_hard and random.random() < 0.4:
        time_s = log_uniform(random, 0.1, 900)
    shot = renderer.shot(
        max(time_s, 1e-6),
        float(random.choice([1.0, 2.0, 8.0])),
        int(random.integers(100)),
        start_s=float(random.random() * 3),
        previous_s=None if random.random() < 0.5 else log_uniform(random, 1e-5, 1.0),
    )
    return Case(renderer, shot, sensor)


@pytest.mark.parametrize(
    ("seed", "cases"),
    [
        pytest.param(CHUNKS, 60, id="60 cases"),
        *(
            pytest.param(
                seed,
                CASES,
                id=f"{CASES} cases, seed {seed}",
                marks=[pytest.mark.slow, *[pytest.mark.proof] * (seed > 0)],
            )
            for seed in range(CHUNKS)
        ),
    ],
)
def test_leaving_effects_out_changes_no_sample_by_more_than_the_bound(
    seed: int, cases: int
) -> None:
    """In each case one effect, a random set, and what a random tolerance leaves out."""
    random = np.random.default_rng(seed)
    tightest: dict[str, float] = {}
    for number in range(cases):
        case = a_case(random)
        bounds = case.bounds
        names = list(bounds.changes)
        one = (str(random.choice(names)),)
        several = tuple(name for name in names if random.random() < random.random())
        tolerance = log_uniform(random, 0.02, 8)
        chosen = greedy(bounds, tolerance)
        assert bounds.joint(chosen) <= tolerance
        for left_out in (one, several, chosen):
            bound = bounds.joint(left_out)
            if not left_out or math.isinf(bound):
                continue
            before, after = case.measured(left_out)
            assert before <= bound, (number, left_out, before, bound)
            assert after <= math.ceil(bound), (number, left_out, after, bound)
            if len(left_out) == 1 and bound > 0:
                name = left_out[0]
                tightest[name] = max(tightest.get(name, 0.0), before / bound)
    print({name: round(value, 3) for name, value in sorted(tightest.items())})


def test_rounding_that_flips_a_count_is_in_the_bound() -> None:
    """Glare of uniform light changes its rounding alone, and that a count, of 9 DN."""
    sensor = Sensor.model_validate(load_sensor("qcmos").model_dump() | {"lens": {"glare": 0.02}})
    renderer = Renderer(View.of(load_scene("uniform", (600, 800)), sensor), sensor, seed=0)
    case = Case(renderer, renderer.shot(0.002, 1.0, 0), sensor)
    before, _ = case.measured(("veiling glare",))
    assert 9 < before <= case.bounds.single["veiling glare"] < 12


def test_the_adc_floors_and_clips_what_is_before_it() -> None:
    """`Case.rendered` does so itself, which saves half of the frames."""
    random = np.random.default_rng(5)
    for _ in range(20):
        case = a_case(random)
        plan = plan_frame(case.shot, 0.0)
        assert np.array_equal(case.renderer.expose(case.shot, plan), case.rendered(())[1])


def test_dark_current_matters_most_in_dim_corners() -> None:
    """The bound uses the photon noise of the corners, where vignetting leaves least light."""
    sensor = Sensor(
        name="dim",
        bits=12,
        full_well_e=10_000,
        read_noise_e=2.5,
        lens=Lens(vignetting=0.95),
        dark=Dark(current_e_s=20.0),
    )
    renderer = Renderer(View(np.full((300, 300), 4000.0, np.float32)), sensor, seed=3)
    case = Case(renderer, renderer.shot(0.02, 1.0, 0), sensor)
    bound = Bounds(case.shot).joint(["dark current"])
    before, _ = case.measured(("dark current",))
    assert 0.5 * bound < before <= bound


@pytest.mark.parametrize(
    ("scene", "sensor", "time_s"),
    [
        ("moving-target", "complete", 0.004),  # glare is downsampled at this size
        ("room", "complete", 0.002),
        ("ramp", "mobile", 0.001),
        ("ramp", "consumer", 0.004),  # a curve
        ("colour-chart", "security", 0.002),
        ("outdoor-sun", "security", 2e-5),
        ("pwm-lamp", "security", 0.001),
    ],
)
def test_bounds_hold_for_frames_of_users_size(scene: str, sensor: str, time_s: float) -> None:
    """640 x 480, each with what a tolerance leaves out; the moving target is black and opaque."""
    chosen = load_sensor(sensor)
    seen = load_scene(scene, (480, 640))
    if seen.target is not None:
        black = seen.target.scaled(np.zeros_like(seen.target.light))
        seen = replace(seen, target=replace(black, cover=np.ones_like(black.cover)))
    renderer = Renderer(View.of(seen, chosen), chosen, seed=8)
    shot = renderer.shot(time_s, 1.0, 3, start_s=0.4)
    case, bounds = Case(renderer, shot, chosen), Bounds(shot)
    for tolerance_dn in (0.3, 3.0):
        left_out = greedy(bounds, tolerance_dn)
        before, after = case.measured(left_out)
        bound = bounds.joint(left_out)
        assert before <= bound <= tolerance_dn
        assert after <= math.ceil(bound)
