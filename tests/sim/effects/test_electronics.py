"""Effects of dark charge and of reading, one by one: each follows its model."""

from __future__ import annotations

import math
from collections.abc import Collection
from itertools import pairwise, product
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from sampling import some

from camctl.sim.effects.budget import plan_frame
from camctl.sim.effects.record import Lines, Tile
from camctl.sim.frame_cache import FrameCache
from camctl.sim.noise import Stream, TileNoise, largest_noise, line_noise
from camctl.sim.render import Renderer
from camctl.sim.scenes.motion import PwmLamps
from camctl.sim.scenes.scene import Scene, load_scene
from camctl.sim.scenes.view import View
from camctl.sim.sensors.parts import Dark, ReadOut
from camctl.sim.sensors.sensor import Sensor, load_sensor

Array = NDArray[np.float64]

ABSENT: dict[str, dict[str, Any]] = {
    "DCNU": {"dark": {"dcnu_e_s": 0.0}},
    "ADC noise": {"read_out": {"adc_noise_e": 0.0}},
    "RTS pixels": {"read_out": {"rts_share": 0.0}},
    "black sun": {"read_out": {"reset_s": 0.0}},
    "diffraction": {"lens": {"diffraction": False}},
    "lateral colour": {"lens": {"lateral_colour": 0.0}},
}


def sensor_with(**parts: Any) -> Sensor:
    return Sensor(name="s", bits=16, full_well_e=60_000, photon_noise=False, black=2000, **parts)


def charge(
    sensor: Sensor,
    time_s: float = 0.01,
    *,
    scene: Scene | None = None,
    light: float = 1e3,
    gain: float = 1.0,
    number: int = 0,
    left_out: Collection[str] = (),
) -> Array:
    """Return the electrons of a frame, (rows, columns)."""
    scene = scene or Scene("even", np.full((400, 500), light, dtype=np.float32))
    renderer = Renderer(View.of(scene, sensor), sensor, seed=3)
    shot = renderer.shot(time_s, gain, number)
    dn = renderer.brightness(shot, plan_frame(shot, 0.0, left_out=left_out)).astype(np.float64)
    return (dn - sensor.black - sensor.phase) * (sensor.electrons_per_dn / gain)


@pytest.mark.parametrize("name", ABSENT)
def test_left_out_is_the_same_as_absent_and_changes_the_frame(name: str) -> None:
    sensor = load_sensor("security")
    fields = sensor.model_dump()
    for part, values in ABSENT[name].items():
        fields[part] = {**fields[part], **values}
    # Light that comes near to that of the sun at the right border.
    light = load_scene("colour-chart", (90, 130)).irradiance * np.geomspace(1e4, 1e9, 130)[:, None]
    scene = Scene("bright", light.astype(np.float32))
    frames = []
    for chosen, left_out in ((sensor, [name]), (Sensor.model_validate(fields), []), (sensor, [])):
        renderer = Renderer(View.of(scene, chosen), chosen, seed=9)
        shot = renderer.shot(0.02, 1.0, 5)
        frames.append(renderer.expose(shot, plan_frame(shot, 0.0, left_out=left_out)))
    assert np.array_equal(frames[0], frames[1])
    assert not np.array_equal(frames[0], frames[2])


@pytest.mark.parametrize(("has_rows", "has_columns"), [(True, False), (False, True), (True, True)])
@pytest.mark.parametrize(("start", "stop"), [(0, 35), (0, 3), (2, 5), (5, 7), (3, 20), (9, 35)])
def test_lines_are_added_to_a_tile_that_begins_and_ends_anywhere(
    start: int, stop: int, has_rows: bool, has_columns: bool
) -> None:
    rows, columns = np.arange(5, dtype=np.float32) * 100, np.arange(7, dtype=np.float32)
    expected = np.full((5, 7), 0.5, dtype=np.float32)
    expected += rows[:, np.newaxis] * has_rows + columns * has_columns
    shot = Renderer(View(np.ones((5, 7), np.float32)), sensor_with()).shot(0.01, 1.0, 0)
    values = np.full(stop - start, 0.5, dtype=np.float32)
    tile = Tile(shot, values, values, start, 0, TileNoise(), FrameCache(0))
    Lines(np.add, rows if has_rows else None, columns if has_columns else None).apply(tile)
    assert np.array_equal(values, expected.reshape(-1)[start:stop])


@pytest.mark.parametrize(("time_s", "temperature_c"), [(1.0, 25.0), (4.0, 25.0), (1.0, 41.0)])
def test_dcnu_grows_with_time_and_temperature(time_s: float, temperature_c: float) -> None:
    """Four times as long, and two doublings, give four times as much."""
    dark = Dark(current_e_s=100.0, dcnu_e_s=10.0, temperature_c=temperature_c)
    seen = charge(sensor_with(dark=dark), time_s, light=1e-9)
    times = time_s * 2 ** ((temperature_c - 25) / 8)
    assert seen.mean() == pytest.approx(100 * times, rel=1e-3)
    assert seen.std() == pytest.approx(10 * times, rel=5 / math.sqrt(2 * seen.size))


def test_no_pixel_has_a_negative_dark_current() -> None:
    dark = Dark(current_e_s=3.0, dcnu_e_s=10.0)
    sensor = sensor_with(dark=dark).model_copy(update={"photon_noise": True})
    for left_out in ((), ("dark current",)):
        seen = charge(sensor, 10.0, light=1e-9, left_out=left_out)
        assert np.isfinite(seen).all()
        mean = charge(sensor, 10.0, light=1e-9, left_out=("photon noise", *left_out))
        assert mean.min() >= -1e-2  # float32 of 2,000 DN
        # A third of the pixels lies below 3 - 10 x 0.3.
        assert (mean < 0.01).mean() == pytest.approx(0.382 if not left_out else 0.5, abs=0.01)


def test_rates_of_hot_pixels_have_a_long_tail() -> None:
    """Over three decades, each decade has a third of them; the mean is 1 / ln(1000) of the most."""
    dark = Dark(hot_share=0.02, hot_rate_e_s=10_000.0, hot_decades=3.0)
    seen = charge(sensor_with(dark=dark), 1.0, light=1e-9)
    hot = np.sort(seen[seen > 5])
    assert hot.size == pytest.approx(0.02 * seen.size, rel=0.05)
    for low in (10.0, 100.0, 1000.0):
        share = ((hot >= low) & (hot < 10 * low)).mean()
        assert share == pytest.approx(1 / 3, abs=5 * math.sqrt(2 / 9 / hot.size))
    assert hot.max() <= 10_000.5
    assert hot.mean() == pytest.approx(10_000 / math.log(1000), rel=0.1)


def test_read_noise_falls_with_gain_to_that_in_front_of_the_amplifier() -> None:
    read_out = ReadOut(adc_noise_e=12.0)
    sensor = sensor_with(read_out=read_out, read_noise_e=5.0, gain_maximum=16.0)
    models = dict(sensor.noise_model.read_noise_e)
    for gain in (1.0, 4.0, 16.0):
        seen = charge(sensor, light=1e-9, gain=gain)
        expected = math.hypot(5.0, 12.0 / gain)
        assert seen.std() == pytest.approx(expected, rel=5 / math.sqrt(2 * seen.size) + 1e-3)
        assert models[gain] == pytest.approx(expected)
    assert charge(sensor, number=1).std() > 0


def spectrum_slope(z: Array) -> float:
    """Return the exponent of power over frequency, from octaves of a periodogram."""
    power = np.abs(np.fft.rfft(z, axis=-1)) ** 2
    edges = 2 ** np.arange(2, 9)
    means = [power[:, low:high].mean() for low, high in pairwise(edges)]
    return float(np.polyfit(np.log(edges[:-1]), np.log(means), 1)[0])


@pytest.mark.parametrize(("share", "slope"), [(0.0, 0.0), (1.0, -1.0)])
def test_row_noise_is_white_or_pink(share: float, slope: float) -> None:
    z = np.stack([line_noise(4, n, Stream.ROW, 1024, share) for n in range(300)]).astype(float)
    assert spectrum_slope(z) == pytest.approx(slope, abs=0.1)
    assert math.sqrt(np.mean(z**2)) == pytest.approx(1, rel=0.1)
    assert np.abs(z).max() <= largest_noise()


def test_half_pink_noise_has_the_variance_of_both() -> None:
    z = np.concatenate([line_noise(4, n, Stream.ROW, 700, 0.5) for n in range(300)])
    assert z.astype(float).var() == pytest.approx(1, rel=0.1)
    sensor = sensor_with(read_out=ReadOut(row_noise_e=8.0, pink_share=0.5))
    frames = [charge(sensor, number=n).mean(axis=1) for n in range(60)]
    assert np.std(frames) == pytest.approx(8.0, rel=0.15)


def test_rts_pixels_jump_by_their_step() -> None:
    """Each has three values, the middle one in half of the frames."""
    sensor = sensor_with(read_out=ReadOut(rts_share=0.005, rts_e=300.0))
    light_e = 1e3 * 0.01 * sensor.quantum_efficiency
    frames = np.stack([charge(sensor, number=n) for n in range(40)]) - light_e
    steps = np.abs(frames).max(axis=0)
    jumping = steps > 0.5
    assert jumping.mean() == pytest.approx(0.005, rel=0.1)
    assert steps.max() <= 300.5
    assert steps[jumping].mean() == pytest.approx(150, rel=0.1)
    values = frames[:, jumping] / steps[jumping]
    assert np.abs(values - np.rint(values)).max() < 0.3
    assert (np.rint(values) == 0).mean() == pytest.approx(0.5, abs=0.03)
    assert np.rint(values).mean() == pytest.approx(0, abs=0.03)


def test_the_sun_is_black() -> None:
    """Light that fills the well within the reset time reads as none; less light is not darker."""
    sensor = sensor_with(read_out=ReadOut(reset_s=1e-6))
    well_s = sensor.full_well_e / sensor.quantum_efficiency
    filled = np.array([[0.5, 1.0, 10.0, 1e3, 5e3, 1e4, 1e7]]) * (well_s / 0.01)
    seen = charge(sensor, scene=Scene("sun", filled.astype(np.float32)))[0]
    well = sensor.full_well_e
    expected = [0.5 * well, well, well, 0.9 * well, 0.5 * well, 0, 0]
    assert seen == pytest.approx(np.array(expected), rel=2e-3, abs=1.0)


@pytest.mark.parametrize(
    ("duty", "periods"), some(product((0.05, 0.5, 1.0), (0.03, 0.7, 1.0, 2.3, 17.9)), every=3)
)
def test_pwm_lamps_are_averaged_exactly(duty: float, periods: float) -> None:
    lamps = PwmLamps(200.0, duty, 0.8)
    time_s = periods / 200.0
    starts = np.linspace(0, 0.005, 301)
    factors = lamps.factors(starts, time_s).astype(float)
    t = starts[:, None] + (np.arange(20_000) + 0.5) / 20_000 * time_s
    on = (np.mod(200 * t, 1.0) < duty) / duty
    assert factors == pytest.approx(1 + 0.8 * (on.mean(axis=1) - 1), abs=2e-3 / duty)
    less, more = lamps.swing(time_s)
    assert factors.min() == pytest.approx(1 - less, abs=0.03)
    assert factors.max() == pytest.approx(1 + more, abs=0.03)
    later_s = starts[1] - starts[0]
    rounding = float(np.spacing(np.float32(factors.max())))
    assert np.abs(np.diff(factors)).max() <= lamps.steepest(time_s) * later_s + rounding


def test_a_rolling_shutter_turns_pwm_lamps_into_stripes() -> None:
    """Rows of a short exposure are dark or lit, in the ratio of the duty cycle."""
    sensor = sensor_with(read_out=ReadOut(row_s=5e-5))
    light = np.full((400, 8), 1e7, dtype=np.float32)
    scene = Scene("led", light, lamps=PwmLamps(500.0, 0.3))
    rows = charge(sensor, 1e-5, scene=scene).mean(axis=1)
    assert (rows > rows.max() / 2).mean() == pytest.approx(0.3, abs=0.03)
    assert rows.min() == pytest.approx(0, abs=1)
    assert np.allclose(rows[:40], rows[40:80], atol=2)  # 40 rows are a period of 2 ms
    whole = charge(sensor, 2e-3, scene=scene).mean(axis=1)
    assert np.ptp(whole) < 5
