"""Effects one by one: left out is the same as absent, and each follows its model."""

from __future__ import annotations

import math
from collections.abc import Collection
from itertools import product
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from sampling import some

import camctl.interface.camera
from camctl.interface.controls import Layout
from camctl.sim.effects import EFFECTS
from camctl.sim.effects.budget import plan_frame
from camctl.sim.effects.charge import cosmic_hits
from camctl.sim.noise import TILE
from camctl.sim.render import Renderer
from camctl.sim.scenes.motion import Lamps, Target
from camctl.sim.scenes.scene import Scene, load_scene
from camctl.sim.scenes.view import View
from camctl.sim.sensors.parts import Dark, Lens, Pixels, ReadOut
from camctl.sim.sensors.sensor import Sensor, load_sensor

EFFECT = {effect.name: effect for effect in EFFECTS}

ABSENT: dict[str, dict[str, Any]] = {
    "veiling glare": {"lens": {"glare": 0.0}},
    "point spread": {"lens": {"blur_px": 0.0}},
    "crosstalk": {"pixels": {"crosstalk": 0.0}},
    "vignetting": {"lens": {"vignetting": 0.0}},
    "PRNU": {"pixels": {"prnu": 0.0}},
    "lag": {"pixels": {"lag": 0.0}},
    "smear": {"pixels": {"smear_s": 0.0}},
    "dark current": {"dark": {"current_e_s": 0.0}},
    "hot pixels": {"dark": {"hot_share": 0.0}},
    "photon noise": {"photon_noise": False},
    "cosmic rays": {"read_out": {"cosmic_rate_s": 0.0}},
    "blooming": {"pixels": {"blooming": 0.0}},
    "DSNU": {"pixels": {"dsnu_e": 0.0}},
    "row noise": {"read_out": {"row_noise_e": 0.0}},
    "column noise": {"read_out": {"column_noise_e": 0.0}},
    "ADC non-linearity": {"read_out": {"nonlinearity_dn": 0.0}},
}


def without(sensor: Sensor, name: str) -> Sensor:
    fields = sensor.model_dump()
    for key, value in ABSENT[name].items():
        fields[key] = {**fields[key], **value} if isinstance(value, dict) else value
    return Sensor.model_validate(fields)


def even(shape: tuple[int, ...], light: float, **fields: Any) -> Scene:
    return Scene("even", np.full(shape, light, dtype=np.float32), **fields)


def frame(
    scene: Scene,
    sensor: Sensor,
    time_s: float = 0.02,
    *,
    left_out: Collection[str] = (),
    threads: int = 2,
) -> camctl.interface.camera.Pixels:
    renderer = Renderer(View.of(scene, sensor), sensor, seed=9, threads=threads)
    shot = renderer.shot(time_s, 1.0, 5, start_s=1.234)
    return renderer.expose(shot, plan_frame(shot, 0.0, left_out=left_out))


def adc_input(
    scene: Scene, sensor: Sensor, time_s: float, *, left_out: Collection[str] = ()
) -> NDArray[np.float32]:
    renderer = Renderer(View.of(scene, sensor), sensor)
    shot = renderer.shot(time_s, 1.0, 0)
    return renderer.brightness(shot, plan_frame(shot, 0.0, left_out=left_out))


@pytest.mark.parametrize(
    ("sensor", "name"), some(product(("complete", "mobile", "ccd"), ABSENT), every=4)
)
def test_left_out_is_the_same_as_absent(name: str, sensor: str) -> None:
    """The random bits of an effect do not depend on whether another effect runs."""
    parts = load_sensor(sensor)
    scene = load_scene("night-street", (150, 200))
    if "cosmic" in name:
        rate = {"read_out": parts.read_out.model_copy(update={"cosmic_rate_s": 1e5})}
        parts = parts.model_copy(update=rate)
    left_out = frame(scene, parts, left_out=[name])
    assert np.array_equal(left_out, frame(scene, without(parts, name)))


@pytest.mark.parametrize("name", ["veiling glare", "crosstalk", "PRNU", "blooming", "read noise"])
def test_leaving_out_changes_the_frame(name: str) -> None:
    scene, sensor = load_scene("night-street", (150, 200)), load_sensor("ccd")
    without_it = frame(scene, sensor, 0.5, left_out=[name])
    assert not np.array_equal(without_it, frame(scene, sensor, 0.5))


@pytest.mark.parametrize("sensor", some(["complete", "mobile", "ccd", "security"], every=3))
def test_the_frame_does_not_depend_on_threads_or_on_those_of_opencv(sensor: str) -> None:
    scene = load_scene("moving-target", (520, 1100))
    assert scene.irradiance.size > 2 * TILE  # one tile has one thread
    before = cv2.getNumThreads()
    frames = []
    try:
        for threads in (1, 2):
            cv2.setNumThreads(threads)
            frames.append(frame(scene, load_sensor(sensor), threads=threads))
    finally:
        cv2.setNumThreads(before)
    assert np.array_equal(frames[0], frames[1])


def test_the_frame_of_a_seed_does_not_change_between_versions() -> None:
    """Reports name the seed only.  Without what OpenCV computes, whose rounding may change."""
    plain = {"glare": 0.0, "blur_px": 0.0}
    sensor = load_sensor("ccd")
    update: dict[str, Any] = {"lens": sensor.lens.model_copy(update=plain)}
    update["pixels"] = sensor.pixels.model_copy(update={"crosstalk": 0.0, "blooming": 0.0})
    light = np.linspace(1e3, 1e6, 12, dtype=np.float32).reshape(3, 4)
    seen = Renderer(View(light), sensor.model_copy(update=update), seed=1).frame(0.01, 1.0, 0)
    assert seen.tolist() == [
        [503, 921, 1314, 1670],
        [2175, 2787, 3263, 3372],
        [3502, 4486, 4941, 4678],
    ]


def test_lamps_peak_twice_a_mains_period_and_average_out_over_whole_periods() -> None:
    lamps = Lamps(50.0, 0.5)
    starts = np.arange(0, 0.02, 0.0005)
    short = lamps.factors(starts, 1e-5)
    assert (short.min(), short.max()) == pytest.approx((0.5, 1.5), abs=0.01)
    assert np.allclose(short[:20], short[20:], atol=1e-4)
    assert np.allclose(lamps.factors(starts, 0.01), 1, atol=1e-6)
    assert lamps.remaining_depth(0.01) < 1e-12
    # By the trapezoid rule over the exposure.
    t = np.linspace(0.003, 0.003 + 0.004, 20_001)
    mean = np.trapezoid(1 + 0.5 * np.cos(2 * np.pi * 100 * t), t) / 0.004
    assert lamps.factors(np.array([0.003]), 0.004)[0] == pytest.approx(mean, rel=1e-6)


def test_a_rolling_shutter_turns_flicker_into_bands() -> None:
    sensor = Sensor(
        name="s", bits=12, full_well_e=1e5, photon_noise=False, read_out=ReadOut(row_s=5e-5)
    )
    lamps = Lamps(50.0, 0.4)
    scene = even((400, 8), 1e7, lamps=lamps)
    rows = frame(scene, sensor, 1e-3).mean(axis=1)
    assert np.allclose(rows[:200], rows[200:], atol=1.5)  # 200 rows are a period of 10 ms
    assert rows.max() / rows.min() > 1.8
    still = frame(scene, sensor, 1e-3, left_out=["rolling shutter"])
    assert len(np.unique(still)) == 1


def a_bar(velocity: float, width: int = 10) -> Scene:
    target = Target(
        np.full((20, width), 1e6, np.float32), np.ones((20, width), np.float32), 5, 30.0, velocity
    )
    return even((30, 200), 1e3, target=target)


def test_motion_blur_keeps_the_light_and_spreads_it() -> None:
    sensor = Sensor(name="s", bits=14, full_well_e=1e5, photon_noise=False)
    scene = a_bar(1000.0)
    for time_s in (0.0001, 0.0123, 0.05):
        blurred = frame(scene, sensor, time_s).astype(float)
        sharp = frame(scene, sensor, time_s, left_out=["motion blur"]).astype(float)
        assert blurred.sum() == pytest.approx(sharp.sum(), rel=2e-3)
    travelled = 50
    lit = np.flatnonzero(blurred[10] > blurred[0].min() * 1.5)
    assert lit.size == pytest.approx(10 + travelled, abs=3)
    assert np.flatnonzero(sharp[10] > sharp[0].min() * 1.5).size == pytest.approx(10, abs=2)


def test_motion_blur_is_the_mean_over_the_exposure() -> None:
    target = Target(
        np.random.default_rng(3).random((6, 9)).astype(np.float32),
        np.random.default_rng(4).random((6, 9)).astype(np.float32),
        2,
        20.3,
        -700.0,
    )
    behind = np.random.default_rng(5).random((10, 60)).astype(np.float32)
    starts = 0.01 + np.arange(10, dtype=np.float64) * 1e-4
    drawn = behind.copy()
    target.draw(drawn, starts, 0.02, is_blurred=True)
    total = np.zeros(behind.shape)
    steps = 2000
    for step in range(steps):
        still = behind.copy()
        moment = starts + 0.02 * (step + 0.5) / steps
        target.draw(still, moment, 0.0, is_blurred=False)
        total += still
    assert np.abs(total / steps - drawn).max() < 2e-4


@pytest.mark.parametrize("travel", [1e-5, 9e-4, 1.1e-3])
def test_a_target_that_hardly_moves_is_drawn_in_the_middle_of_its_path(travel: float) -> None:
    target = a_bar(travel).target
    assert target is not None
    blurred, still = (np.zeros((30, 200), np.float32) for _ in range(2))
    target.draw(blurred, np.zeros(30), 1.0, is_blurred=True)
    target.draw(still, np.zeros(30), 1.0, is_blurred=False)
    assert np.abs(blurred - still).max() <= 1e6 * travel / 4 + 0.1


def test_a_target_that_has_left_comes_in_on_the_other_side() -> None:
    scene = a_bar(1000.0)
    target = scene.target
    assert target is not None
    pictures = []
    for start in (0.0, 0.21, 0.42):  # (200 + 10) columns at 1,000 a second
        picture = scene.irradiance.copy()
        target.draw(picture, np.full(30, start), 0.0, is_blurred=False)
        pictures.append(picture)
    assert np.allclose(pictures[0], pictures[1], rtol=1e-4)
    assert np.allclose(pictures[0], pictures[2], rtol=1e-4)
    assert pictures[0][10].argmax() == 30


def test_the_lens_does_not_change_even_light_and_spreads_a_point() -> None:
    lens = Lens(glare=0.1, glare_width=0.1, blur_px=1.0)
    sensor = Sensor(name="s", bits=14, full_well_e=1e5, photon_noise=False, lens=lens)
    flat = frame(even((60, 80), 1e6), sensor, 0.01)
    assert np.ptp(flat.astype(int)) <= 1
    light = np.full((61, 81), 1.0, dtype=np.float32)
    light[30, 40] = 1e8
    point = Scene("point", light)
    halo = adc_input(point, sensor, 0.01)
    assert halo[30, 40] == halo.max()
    assert halo[30, 45] > halo[30, 60] > halo[30, 79] > 0
    sharp = adc_input(point, sensor, 0.01, left_out=["veiling glare", "point spread"])
    assert np.count_nonzero(sharp > 0.1) == 1


def test_vignetting_darkens_the_corners_by_its_share() -> None:
    sensor = Sensor(
        name="s", bits=14, full_well_e=1e5, photon_noise=False, lens=Lens(vignetting=0.3)
    )
    for shape in ((101, 151), (101, 151, 3)):
        seen = frame(even(shape, 1e6), sensor, 0.1).astype(float)
        assert seen[0, 0].mean() / seen[50, 75].mean() == pytest.approx(0.7, abs=0.001)
        assert seen[0, 0].mean() == seen[-1, -1].mean()


def test_blooming_and_smear_stay_in_their_column() -> None:
    light = np.full((80, 60), 1e4, dtype=np.float32)
    light[40, 30] = 4e7  # 20 full wells
    sensor = Sensor(name="s", bits=12, full_well_e=10_000, photon_noise=False)
    pixels = Pixels(blooming=1.0, smear_s=1e-4)
    both = sensor.model_copy(update={"pixels": pixels})
    seen = frame(Scene("lamp", light), both, 0.01).astype(int)
    plain = frame(Scene("lamp", light), sensor, 0.01).astype(int)
    assert np.array_equal(np.unique(np.nonzero(seen - plain > 1)[1]), [30])
    assert seen[33, 30] == seen[47, 30] == 4095
    assert seen[25, 30] == seen[55, 30] == seen[0, 30]  # out of the reach of blooming: smear
    assert seen[0, 30] > plain[0, 30] + 1


@pytest.mark.parametrize("over", [1.5, 30.0, 1e3, 1e6])
@pytest.mark.parametrize("share", [0.4, 1.0])
def test_blooming_conserves_charge_and_reaches_further_with_more_of_it(
    over: float, share: float
) -> None:
    """All charge beyond the wells that is not drained lies in the column, or left at its ends."""
    well, dark_e, rows = 1000.0, 10.0, 201
    charge = np.full((rows, 3), dark_e, dtype=np.float32)
    charge[100, 1] = over * well
    sensor = Sensor(name="s", bits=8, full_well_e=well, pixels=Pixels(blooming=share))
    shot = Renderer(View(charge), sensor).shot(0.01, 1.0, 0)
    flow, spread = EFFECT["blooming"].flow, charge.copy()
    assert flow is not None
    flow(spread, shot, None)
    seen = spread.astype(np.float64)
    flowing = share * (over - 1) * well
    room = (rows - 1) * (well - dark_e)
    assert np.all(seen[:, [0, 2]] == dark_e)
    gained = seen[:, 1].sum() - (rows - 1) * dark_e - well
    assert gained == pytest.approx(min(flowing, room), rel=1e-6)
    reached = np.count_nonzero(seen[:, 1] > dark_e)
    assert reached == min(rows, 1 + 2 * math.ceil(flowing / 2 / (well - dark_e)))


def test_an_opaque_black_target_before_a_bright_wall_gives_finite_light() -> None:
    """The mean of its cover over the exposure may be above 1 by the rounding."""
    light = np.full((12, 200), 1e6, dtype=np.float32)
    for width in (1, 7, 30):
        for velocity in (-3.3e4, 77.7, 1e3, 1e5):
            surface, cover = np.zeros((9, width), np.float32), np.ones((9, width), np.float32)
            scene = Scene("s", light, target=Target(surface, cover, 1, 10.3, velocity))
            seen = adc_input(scene, load_sensor("complete"), 0.0101)
            assert np.isfinite(seen).all()
            planes = light.copy()
            assert scene.target is not None
            scene.target.draw(planes, np.linspace(0, 0.01, 12), 0.0101, is_blurred=True)
            assert planes.min() >= 0


def test_the_largest_dark_rates_give_a_full_well() -> None:
    hot = Dark(hot_share=0.1, hot_rate_e_s=1e9, temperature_c=150, reference_c=0, doubling_k=2.5)
    sensor = load_sensor("complete").model_copy(update={"dark": hot})
    assert hot.rate_factor > 1e18
    seen = adc_input(even((60, 80), 1e3), sensor, 60.0)
    assert np.isfinite(seen).all()
    assert seen.max() >= sensor.white


def test_crosstalk_acts_on_light_that_the_lens_has_dimmed() -> None:
    """A corner pixel loses to its neighbours what vignetting has left of its light."""
    pixels, lens = Pixels(crosstalk=0.1), Lens(vignetting=0.5)
    sensor = Sensor(name="s", bits=14, full_well_e=1e5, photon_noise=False, pixels=pixels)
    light = np.zeros((21, 21), dtype=np.float32)
    light[1, 1] = 1e6
    bright, dim = (
        adc_input(Scene("s", light), sensor.model_copy(update={"lens": one}), 0.1)
        for one in (Lens(), lens)
    )
    share = 1 - 0.5 * (9**2 + 9**2) / (10**2 + 10**2)
    lit = bright > 0
    assert np.count_nonzero(lit) == 5
    assert dim[lit] == pytest.approx(bright[lit] * share, rel=1e-5)


def test_cosmic_rays_are_a_poisson_process_and_differ_from_frame_to_frame() -> None:
    read_out = ReadOut(cosmic_rate_s=50.0, cosmic_e=1000.0)
    sensor = Sensor(name="s", bits=12, full_well_e=20_000, read_out=read_out)
    renderer = Renderer(View(np.full((500, 1000), 1.0, np.float32)), sensor, seed=3)
    counts: list[int] = []
    charge = 0.0
    for number in range(300):
        places, charges = cosmic_hits(renderer.shot(2.0, 1.0, number))
        assert np.all(np.diff(places) > 0)
        counts.append(places.size)
        charge += float(charges.sum())
    assert len(set(counts)) > 10
    # 50 hits a frame of 3.5 samples each, less what lies outside of the picture.
    assert np.mean(counts) == pytest.approx(50 * 3.5, rel=0.03)
    assert charge / 300 == pytest.approx(50 * 1000, rel=0.05)


def test_a_spectrum_mixes_the_colours_of_the_scene() -> None:
    colour = np.broadcast_to(np.array([1.0, 0.0, 0.0], dtype=np.float32), (4, 4, 3))
    sensor = load_sensor("mobile")
    assert sensor.layout is Layout.RGGB
    assert sensor.spectrum is not None
    light = View.of(Scene("red", colour, photons_per_unit=100.0), sensor).light
    column = [row[0] for row in sensor.spectrum]
    expected = [100 * column[i] for i in (0, 1, 1, 2)]
    assert light[:2, :2].ravel() == pytest.approx(expected)


def test_a_tile_with_fixed_patterns_is_the_same_in_a_larger_frame() -> None:
    sensor = Sensor(
        name="s",
        bits=12,
        full_well_e=10_000,
        read_noise_e=2.0,
        dark=Dark(current_e_s=100, hot_share=0.01, hot_rate_e_s=1e5),
        pixels=Pixels(prnu=0.02, dsnu_e=5.0, lag=0.01),
    )
    light = np.full(3 * TILE + 17, 3e5, dtype=np.float32)
    large = Renderer(View(light), sensor, seed=1).frame(0.01, 1.0, 4)
    small = Renderer(View(light[: TILE + 5]), sensor, seed=1).frame(0.01, 1.0, 4)
    assert np.array_equal(large[: TILE + 5], small)
    again = Renderer(View(light), sensor, seed=1).frame(0.01, 1.0, 5)
    pattern = np.corrcoef(large, again)[0, 1]
    assert pattern > 0.3


def test_lag_depends_on_the_exposure_before() -> None:
    sensor = Sensor(name="s", bits=14, full_well_e=1e5, photon_noise=False, pixels=Pixels(lag=0.1))
    renderer = Renderer(View(np.full((4, 4), 1e6, np.float32)), sensor)
    none, twice = (
        renderer.brightness(shot, renderer.plan(shot)).mean()
        for shot in (renderer.shot(0.01, 1.0, 0, previous_s=p) for p in (1e-9, 0.02))
    )
    assert twice / none == pytest.approx(1.2, rel=1e-4)


def test_the_lens_acts_in_front_of_the_colour_filters() -> None:
    """If the scene has the same colour everywhere, the lens changes nothing in a mosaic."""
    colour = np.broadcast_to(np.array([3e5, 6e5, 1e5], dtype=np.float32), (30, 40, 3))
    sensor = Sensor(
        name="s",
        bits=14,
        layout=Layout.RGGB,
        full_well_e=1e5,
        photon_noise=False,
        lens=Lens(glare=0.2, blur_px=1.5),
    )
    scene = Scene("s", colour)
    without_lens = sensor.model_copy(update={"lens": Lens()})
    off = frame(scene, sensor).astype(int) - frame(scene, without_lens).astype(int)
    assert np.abs(off).max() <= 1
