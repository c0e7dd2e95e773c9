"""A simulated sensor, measured as EMVA 1288 measures a camera, has the parameters it was given.

Flat fields without a lens, with every effect.  Tolerances are five standard deviations of the
estimate, from the number of samples.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from sampling import some

from camctl.sim.noise import largest_noise
from camctl.sim.render import Renderer
from camctl.sim.scenes.view import View
from camctl.sim.sensors.parts import Dark, Pixels, ReadOut
from camctl.sim.sensors.sensor import Sensor

SHAPE = (400, 500)
SAMPLES = SHAPE[0] * SHAPE[1]
FRAMES = 24

Frames = NDArray[np.float64]

SENSOR = Sensor(
    name="measured",
    bits=12,
    black=100,
    phase=0.5,
    full_well_e=10_500,
    electrons_per_dn=2.7,
    read_noise_e=3.0,
    quantum_efficiency=0.6,
    gain_maximum=4.0,
    dark=Dark(current_e_s=25.0, temperature_c=33.0, reference_c=25.0, doubling_k=8.0),
    pixels=Pixels(prnu=0.008, dsnu_e=2.0),
)


def flat(filled: float, time_s: float = 1e-3, sensor: Sensor = SENSOR) -> Frames:
    """Return (FRAMES, *SHAPE) frames of even light that fills the share `filled` of the well."""
    photons_s = filled * sensor.full_well_e / sensor.quantum_efficiency / time_s
    renderer = Renderer(View(np.full(SHAPE, photons_s, dtype=np.float32)), sensor, seed=11)
    shots = [renderer.shot(time_s, 1.0, number) for number in range(FRAMES)]
    return np.stack([renderer.expose(shot, renderer.plan(shot)) for shot in shots]).astype(float)


def temporal_variance(frames: Frames) -> float:
    """Return the variance from frame to frame, without fixed patterns."""
    return float(frames.var(axis=0, ddof=1).mean())


def spatial_variance(frames: Frames) -> float:
    """Return the variance of fixed patterns, without the rest of the temporal noise."""
    return float(frames.mean(axis=0).var(ddof=1)) - temporal_variance(frames) / FRAMES


def test_gain_read_noise_prnu_and_dsnu() -> None:
    """Gain is the slope of variance over mean, read noise its value at 0."""
    levels = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
    stacks = {level: flat(level) for level in levels}
    means = np.array([stacks[level].mean() for level in levels])
    variances = np.array([temporal_variance(stacks[level]) for level in levels])
    slope = np.polyfit(means - means[0], variances - variances[0], 1)[0]
    gain_error = 5 * math.sqrt(2 / (SAMPLES * (FRAMES - 1)))
    assert 1 / slope == pytest.approx(SENSOR.electrons_per_dn, rel=gain_error + 1e-3)
    dark_e = SENSOR.dark.current_e_s * SENSOR.dark.rate_factor * 1e-3
    read_e = math.sqrt(variances[0] - 1 / 12 - dark_e / 2.7**2) * SENSOR.electrons_per_dn
    assert read_e == pytest.approx(SENSOR.read_noise_e, rel=gain_error + 2e-3)
    dark, half = spatial_variance(stacks[0.0]), spatial_variance(stacks[0.5])
    dsnu_e = math.sqrt(dark) * SENSOR.electrons_per_dn
    prnu = math.sqrt(half - dark) / (stacks[0.5].mean() - stacks[0.0].mean())
    # Patterns are estimated from SAMPLES pixels, each with the noise of a mean of FRAMES.
    dark_share = 1 + variances[0] / FRAMES / dark
    half_share = 1 + variances[5] / FRAMES / (half - dark)
    dsnu_error = 5 * dark_share / math.sqrt(2 * SAMPLES)
    prnu_error = 5 * half_share / math.sqrt(2 * SAMPLES)
    assert dsnu_e == pytest.approx(SENSOR.pixels.dsnu_e, rel=dsnu_error)
    assert prnu == pytest.approx(SENSOR.pixels.prnu, rel=prnu_error)
    print(
        f"K {1 / slope:.4f} e-/DN of 2.7, read noise {read_e:.4f} e- of 3, DSNU {dsnu_e:.4f} e- of"
        f" 2 (+-{dsnu_error:.1%}), PRNU {prnu:.3%} of 0.8 % (+-{prnu_error:.1%})"
    )


def test_full_well() -> None:
    """Beyond saturation the mean is the full well, and there is no photon noise."""
    full = flat(3.0)
    well_e = (full.mean() - SENSOR.black) * SENSOR.electrons_per_dn
    pattern_e = math.hypot(SENSOR.read_noise_e, SENSOR.pixels.dsnu_e)
    error_e = 5 * pattern_e / math.sqrt(SAMPLES) + SENSOR.electrons_per_dn * 0.01
    assert well_e == pytest.approx(SENSOR.full_well_e, abs=error_e)
    assert temporal_variance(full) < 1.2 * temporal_variance(flat(0.0))
    print(f"full well {well_e:.2f} e- of {SENSOR.full_well_e:g} (+-{error_e:.2f})")


@pytest.mark.parametrize(
    ("temperature_c", "times"), some([(25.0, 1.0), (33.0, 2.0), (49.0, 8.0)], every=2)
)
def test_dark_current_doubles_every_eight_kelvin(temperature_c: float, times: float) -> None:
    """By the slope of the mean over time, and by that of the variance, which is its noise."""
    dark = SENSOR.dark.model_copy(update={"temperature_c": temperature_c})
    sensor = SENSOR.model_copy(update={"dark": dark})
    short, long = flat(0.0, 1.0, sensor), flat(0.0, 9.0, sensor)
    rate = (long.mean() - short.mean()) * sensor.electrons_per_dn / 8
    error = 5 * math.sqrt(2 * temporal_variance(long) / SAMPLES / FRAMES) * 2.7 / 8
    expected = SENSOR.dark.current_e_s * times
    assert rate == pytest.approx(expected, abs=error + 1e-3 * expected)
    noise = (temporal_variance(long) - temporal_variance(short)) * sensor.electrons_per_dn**2 / 8
    noise_error = 5 * temporal_variance(long) * math.sqrt(2 / SAMPLES / FRAMES) * 2.7**2 / 8
    assert noise == pytest.approx(expected, abs=2 * noise_error + 1e-3 * expected)
    print(f"{temperature_c:g} C: {rate:.3f} e-/s by mean, {noise:.3f} by noise, of {expected:g}")


def test_row_and_column_noise() -> None:
    """EMVA 1288 4.0: row noise changes from frame to frame, column noise does not."""
    lines = ReadOut(row_noise_e=6.0, column_noise_e=4.0)
    update = {"read_out": lines, "pixels": Pixels(), "dark": Dark()}
    frames = flat(0.0, 1e-3, SENSOR.model_copy(update=update)) * SENSOR.electrons_per_dn
    pixel = SENSOR.read_noise_e**2 + SENSOR.electrons_per_dn**2 / 12
    rows = frames.mean(axis=2).var(axis=0, ddof=1).mean() - pixel / SHAPE[1]
    columns = frames.mean(axis=(0, 1)).var(ddof=1) - pixel / FRAMES / SHAPE[0]
    assert math.sqrt(rows) == pytest.approx(6.0, rel=5 / math.sqrt(2 * SHAPE[0] * FRAMES))
    assert math.sqrt(columns) == pytest.approx(4.0, rel=5 / math.sqrt(2 * SHAPE[1]))


def test_hot_pixels_have_their_share_and_their_rates() -> None:
    dark = Dark(hot_share=0.01, hot_rate_e_s=1000.0)
    sensor = SENSOR.model_copy(update={"dark": dark, "pixels": Pixels()})
    excess = (flat(0.0, 1.0, sensor).mean(axis=0) - sensor.black) * sensor.electrons_per_dn
    hot = excess > 20
    assert hot.mean() == pytest.approx(0.01 * 0.98, rel=0.1)
    assert excess.max() < 1000 + largest_noise() * math.sqrt(1000)
    assert excess[hot].mean() == pytest.approx(510, rel=0.1)


def test_the_linearity_error_is_the_bow_of_the_adc() -> None:
    bow = SENSOR.model_copy(
        update={"read_out": ReadOut(nonlinearity_dn=6.0), "pixels": Pixels(), "dark": Dark()}
    )
    plain = SENSOR.model_copy(update={"pixels": Pixels(), "dark": Dark()})
    for filled in (0.1, 0.5, 0.9):
        off = flat(filled, 1e-3, bow).mean() - flat(filled, 1e-3, plain).mean()
        u = filled * SENSOR.full_well_e / SENSOR.adc_range_e
        assert off == pytest.approx(6.0 * 4 * u * (1 - u), abs=0.05)
