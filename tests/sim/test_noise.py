"""Noise: its distribution, its bound, and its independence of threads and other streams."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from camctl.sim import noise
from camctl.sim.noise import TILE, Stream, TileNoise, largest_noise, normal_quantiles, tile_bits

COUNT = 1 << 16

Array = NDArray[np.float64]


@pytest.fixture
def every_quantile(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make a tile draw each of the 65,536 quantiles once, which is the exact distribution."""

    def counted(seed: int, frame: int, stream: Stream, tile: int, count: int) -> NDArray[np.uint16]:
        return np.arange(count).astype(np.uint16)

    monkeypatch.setattr(noise, "tile_bits", counted)


def photon_draws(mean: float) -> Array:
    electrons = np.full(COUNT, mean, dtype=np.float32)
    TileNoise().add_photon_noise(electrons, 0, 0, 0)
    return electrons.astype(np.float64)


def test_the_quantile_table_is_standard_normal_and_bounded() -> None:
    table = normal_quantiles().astype(np.float64)
    assert table.size == COUNT
    assert abs(table.mean()) < 1e-7
    assert table.var() == pytest.approx(1, abs=1e-6)
    assert np.mean(table**4) == pytest.approx(3, abs=0.01)
    assert np.all(np.diff(table) > 0)
    assert np.array_equal(table, -table[::-1])
    assert 4.32 < np.abs(table).max() <= largest_noise() < 4.33


@pytest.mark.usefixtures("every_quantile")
@pytest.mark.parametrize("mean", [0.0, 0.01, 0.1, 0.5, 1.0, 3.0, 10.0, 100.0, 1e4, 1e6])
def test_photon_noise_has_the_mean_and_variance_of_poisson(mean: float) -> None:
    draws = photon_draws(mean)
    assert draws.mean() == pytest.approx(mean, rel=2e-6, abs=1e-6)
    assert draws.var() == pytest.approx(mean, rel=1e-3, abs=1e-9)


@pytest.mark.usefixtures("every_quantile")
@pytest.mark.parametrize(
    ("mean", "tolerance"), [(3.0, 0.06), (10.0, 0.02), (100.0, 0.01), (1e4, 0.02)]
)
def test_photon_noise_has_the_skewness_of_poisson(mean: float, tolerance: float) -> None:
    draws = photon_draws(mean)
    skewness = np.mean((draws - mean) ** 3) / draws.var() ** 1.5
    assert skewness == pytest.approx(1 / math.sqrt(mean), rel=tolerance)


def wasserstein_to_poisson(mean: float, read_noise: float) -> float:
    """Return W1 of the draws and Poisson, both with Gaussian read noise, from their exact cdfs."""
    reach = 6 * math.sqrt(mean) + 6 * read_noise
    x = np.linspace(mean - reach, mean + 1.4 * reach + 4, 1200)
    grid = np.linspace(-7, 7, 8001)
    gauss = np.array([0.5 * math.erfc(-g / math.sqrt(2)) for g in grid])

    def cdf(points: Array, weights: Array) -> Array:
        steps = np.interp((x[:, None] - points) / read_noise, grid, gauss, left=0, right=1)
        return np.asarray(steps @ weights)

    k = np.arange(int(mean + 9 * math.sqrt(mean) + 12))
    poisson = np.array([math.exp(i * math.log(mean) - mean - math.lgamma(i + 1)) for i in k])
    draws = photon_draws(mean)[16::32]  # 2,048 quantiles
    mine = cdf(draws, np.full(draws.size, 1 / draws.size))
    return float(np.abs(mine - cdf(k.astype(float), poisson)).sum() * (x[1] - x[0]))


@pytest.mark.usefixtures("every_quantile")
@pytest.mark.parametrize("mean", [0.03, 0.3, 1.0, 3.0, 10.0, 50.0])
def test_photon_and_read_noise_are_close_to_exact_poisson(mean: float) -> None:
    assert wasserstein_to_poisson(mean, 1.0) < 0.009
    assert wasserstein_to_poisson(mean, 3.0) < 0.005


def test_read_noise_has_its_standard_deviation() -> None:
    tiles = []
    for tile in range(4):
        electrons = np.zeros(TILE, dtype=np.float32)
        TileNoise().add_read_noise(electrons, 2.5, 7, 0, tile)
        tiles.append(electrons)
    draws = np.concatenate(tiles).astype(np.float64)
    assert abs(draws.mean()) < 5 * 2.5 / math.sqrt(draws.size)
    assert draws.std() == pytest.approx(2.5, rel=5 / math.sqrt(2 * draws.size))


@given(
    st.integers(0, 2**64 - 1), st.integers(0, 2**40), st.integers(0, 10_000), st.integers(1, TILE)
)
def test_bits_depend_on_seed_frame_stream_and_tile_only(
    seed: int, frame: int, tile: int, count: int
) -> None:
    bits = tile_bits(seed, frame, Stream.READ, tile, TILE)
    assert np.array_equal(tile_bits(seed, frame, Stream.READ, tile, count), bits[:count])
    others = (
        tile_bits((seed + 1) % 2**64, frame, Stream.READ, tile, TILE),
        tile_bits(seed, frame + 1, Stream.READ, tile, TILE),
        tile_bits(seed, frame, Stream.PHOTON, tile, TILE),
        tile_bits(seed, frame, Stream.READ, tile + 1, TILE),
    )
    for other in others:
        # 1 in 65,536 is equal by chance: the probability of more than 12 in 32,768 is below 1e-13.
        assert np.count_nonzero(bits[:32_768] == other[:32_768]) <= 12


def test_streams_of_the_same_tile_are_not_correlated() -> None:
    table = normal_quantiles()
    streams = [
        table[tile_bits(3, frame, stream, tile, TILE)]
        for frame in (0, 1)
        for stream in Stream
        for tile in (0, 1)
    ]
    correlation = np.corrcoef(streams) - np.eye(len(streams))
    assert np.abs(correlation).max() < 5 / math.sqrt(TILE)
