"""Photon counts are whole and Poisson, change no more than their bound, and predict as before."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from sampling import some

from camctl.sim.noise import largest_noise
from camctl.sim.photon_counts import (
    COUNT_ERROR_E,
    GUIDE_CELLS,
    GUIDE_STEPS,
    LARGEST_CHECKED,
    LARGEST_COUNT_NOISE,
    UNSURE,
    guide,
    normal_of,
    poisson_quantiles,
)
from camctl.sim.render import Renderer
from camctl.sim.scenes.view import View
from camctl.sim.sensors.parts import Dark, Pixels
from camctl.sim.sensors.sensor import Sensor, load_sensor

SAMPLES = (600, 1000)
COUNTING = Sensor(
    name="counting", bits=12, full_well_e=4096, electrons_per_dn=1.0, phase=0.5, black=0
)


def stats() -> Any:
    """Return scipy.stats, whose import takes a second: in each process that collects tests."""
    from scipy import stats

    return stats


def counted(mean: float, sensor: Sensor = COUNTING, seed: int = 3) -> NDArray[np.int64]:
    """Return pixels of even light of `mean` electrons."""
    light = np.full(SAMPLES, mean / sensor.quantum_efficiency, dtype=np.float32)
    return Renderer(View(light), sensor, seed=seed).frame(1.0, 1.0, 0).astype(np.int64)


def chi_square(counts: NDArray[np.int64], mean: float) -> tuple[float, int]:
    """Return Pearson's chi-square against Poisson, and its degrees of freedom.

    Neighbouring counts share a class until each class expects 10 samples.
    """
    expected = stats().poisson.pmf(np.arange(counts.max() + 60), mean) * counts.size
    classes = np.minimum.accumulate(np.cumsum(expected)[::-1])[::-1] // 10
    _, first = np.unique(classes, return_index=True)
    classed = np.add.reduceat(expected, first)
    seen = np.add.reduceat(np.bincount(counts.ravel(), minlength=expected.size), first)
    if classed[-1] < 10:
        classed[-2:], seen[-2:] = classed[-2:].sum() / 2, seen[-2:].sum() / 2
    return float(((seen - classed) ** 2 / classed).sum()), classed.size - 1


@pytest.mark.parametrize("mean", [0.5, 1.0, 2.0, 5.0, 7.99, 8.01, 20.0, 24.01, 60.0])
def test_counts_are_poisson(mean: float) -> None:
    chi, freedom = chi_square(counted(mean), mean)
    print(f"mean {mean} e-: chi-square {chi:.1f} for {freedom} degrees of freedom")
    assert stats().chi2.sf(chi, freedom) > 1e-4


def test_the_chi_square_finds_the_continuous_noise() -> None:
    """Read noise of 2.5 e- makes the charge continuous, which no longer is Poisson."""
    sensor = COUNTING.model_copy(update={"read_noise_e": 2.5, "black": 20})
    chi, _ = chi_square(np.maximum(counted(0.5, sensor) - 20, 0), 0.5)
    assert chi > 1000


@pytest.mark.parametrize("mean", some([0.01, 0.3, 3.0, 7.9, 8.0, 12.5, 19.0, 23.9], every=3))
def test_low_counts_are_the_exact_quantiles(mean: float) -> None:
    random = np.random.default_rng(1)
    tail = (np.arange(500) + 0.5) / 2**32
    uniform = np.concatenate([random.random(50_000), tail, 1 - tail])
    means = np.full(uniform.size, mean, dtype=np.float32)
    exact = stats().poisson.ppf(uniform, float(means[0]))
    assert np.array_equal(poisson_quantiles(means, uniform), exact)


@pytest.mark.slow
def test_higher_counts_are_the_exact_quantiles_but_for_few_that_differ_by_one() -> None:
    uniform = np.random.default_rng(2).random(40_000)
    for mean in (24.0, 60.0, 1e3, 1e5):
        means = np.full(uniform.size, mean, dtype=np.float32)
        off = poisson_quantiles(means, uniform) - stats().poisson.ppf(uniform, mean)
        assert np.abs(off).max() <= 1
        assert np.count_nonzero(off) < 1e-3 * off.size


def test_counts_stay_near_the_formula_of_the_bounds() -> None:
    """`COUNT_ERROR_E`: highest minus lowest difference over all means, for one z."""
    means = np.concatenate([np.geomspace(1e-11, 30, 8000), np.geomspace(30, 1e6, 4000)])
    means = means.astype(np.float32)
    tail = (np.array([0, 1, 10, 1e3, 1e5, 1e7, 1e9, 2**31]) + 0.5) / 2**32
    m = means.astype(np.float64)
    a = m / (6 * m + 0.2)
    widest = 0.0
    for u in np.concatenate([tail, 1 - tail]):
        z = float(stats().norm.ppf(u))
        assert abs(z) <= LARGEST_COUNT_NOISE
        counts = poisson_quantiles(means, np.full(means.size, u)).astype(np.float64)
        assert np.all(np.diff(counts) >= 0)
        off = counts - (m + np.sqrt(m - 2 * a * a) * z + a * (z * z - 1))
        widest = max(widest, float(np.ptp(off)))
    print(f"counts differ from the formula by {widest:.2f} e- over all means")
    assert 0.8 * COUNT_ERROR_E < widest <= COUNT_ERROR_E


def test_normal_quantiles_are_near_the_exact_ones() -> None:
    uniform = np.random.default_rng(4).random(50_000)
    uniform = np.concatenate([uniform, (np.arange(3000) + 0.5) / 2**24])
    assert np.abs(normal_of(uniform) - stats().norm.ppf(uniform)).max() < 2e-3


@pytest.mark.parametrize("name", ["qcmos", "quanta-1", "quanta-3"])
def test_frames_of_counting_sensors_have_the_predicted_mean_and_noise(name: str) -> None:
    """The noise model of the planner holds for whole counts, below saturation."""
    sensor = load_sensor(name)
    quiet = {"pixels": Pixels(), "dark": Dark()}
    sensor = sensor.model_copy(update=quiet)
    mean = 0.4 if sensor.bits == 1 else 2.0 if sensor.bits == 3 else 20.0
    dn = counted(mean, sensor) - sensor.black
    noise = sensor.noise_model
    if sensor.bits == 16:
        expected = mean + noise.read_noise_e[0][1] ** 2
        step = sensor.electrons_per_dn
        assert dn.mean() * step == pytest.approx(mean, abs=5 * math.sqrt(mean / dn.size))
        assert dn.var() * step**2 == pytest.approx(expected, rel=5 * math.sqrt(2 / dn.size) + 1e-3)
        near = np.abs(dn * step - np.rint(dn * step))
        # Peaks at whole electrons: uniform would be a mean distance of 0.25.
        assert near.mean() < 0.22
        return
    # One electron is one level: the chance to reach the top level, with the read noise.
    top = sensor.white
    charge = np.minimum(np.arange(60), sensor.full_well_e)
    reached = stats().norm.sf((top - 0.5 - charge) / sensor.read_noise_e)
    chance = float((stats().poisson.pmf(np.arange(60), mean) * reached).sum())
    error = 5 * math.sqrt(chance / dn.size) + 1e-3
    assert (dn >= top).mean() == pytest.approx(chance, abs=error)


def test_largest_noise_of_counts_is_beyond_that_of_the_table() -> None:
    assert largest_noise() < LARGEST_COUNT_NOISE < 6.35


def test_the_guide_holds_the_count_of_every_mean_and_uniform_number_in_its_cells() -> None:
    random = np.random.default_rng(4)
    means = random.uniform(0, LARGEST_CHECKED, 1_000_000).astype(np.float32)
    means = np.minimum(means, np.nextafter(np.float32(LARGEST_CHECKED), np.float32(0)))
    uniform = np.asarray(random.integers(0, 1 << 32, means.size), np.float64)
    uniform = (uniform + 0.5) * 2.0**-32
    place = (means * np.float32(GUIDE_STEPS)).astype(int), (uniform * GUIDE_CELLS).astype(int)
    found = guide()[place]
    sure = found != UNSURE
    assert sure.mean() > 0.94
    assert np.array_equal(found[sure], poisson_quantiles(means, uniform)[sure])
