"""The light of samples from all frames, against exact likelihoods on a fine grid."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest
from sampling import some

from camctl.model.light import light_tables
from camctl.model.noise import FrameNoise
from camctl.model.response.camera import (
    CameraResponse,
    FloatArray,
    linear_response,
    standard_response,
)
from camctl.model.step_posterior import FrameSet

GRID = np.linspace(0.0, 2.0, 8001)


def probabilities(frames: FrameSet) -> list[FloatArray]:
    """Return the probability of each value at each light of the grid, (values, grid) a frame."""
    real, found = frames.response, []
    below = real.levels[0] - (real.levels[1] - real.levels[0]) * np.arange(frames.black, 0, -1)
    thresholds = np.concatenate([below, real.levels])
    full = real.M + 1
    for exposure, noise in zip(frames.exposures, frames.noise, strict=True):
        x = exposure * GRID + noise.dark_levels / full
        sigma = np.sqrt(
            x / noise.electrons_per_level / full + (noise.read_noise_levels / full) ** 2
        )
        above = np.array(
            [
                [
                    0.5 * math.erfc((t - at) / s / math.sqrt(2))
                    for at, s in zip(x, sigma, strict=True)
                ]
                for t in thresholds
            ]
        )
        above = np.concatenate([np.ones((1, GRID.size)), above, np.zeros((1, GRID.size))])
        found.append(above[:-1] - above[1:])
    return found


def exact(frames: FrameSet) -> tuple[list[tuple[int, ...]], FloatArray, FloatArray, FloatArray]:
    """Return the values that occur, how probable they are, and mean and deviation of the light."""
    single = probabilities(frames)
    within = GRID < 0.95
    tuples, weights, means, deviations = [], [], [], []
    for values in product(*(range(each.shape[0]) for each in single)):
        if all(value == each.shape[0] - 1 for value, each in zip(values, single, strict=True)):
            continue
        joint = np.prod([each[value] for value, each in zip(values, single, strict=True)], axis=0)
        weight = joint[within].sum() / np.count_nonzero(within)
        if weight > 1e-5:
            mean = (joint * GRID).sum() / joint.sum()
            tuples.append(values)
            weights.append(weight)
            means.append(mean)
            deviations.append(math.sqrt((joint * (GRID - mean) ** 2).sum() / joint.sum()))
    return tuples, np.array(weights), np.array(means), np.array(deviations)


@pytest.mark.parametrize(
    ("response", "black", "exposures", "electrons", "read"),
    some(
        [
            (linear_response(4), 0, (1.0, 3.0), 40.0, 0.1),  # the quantiser decides
            (linear_response(4), 0, (1.0, 1.03, 2.9), 1000.0, 0.05),  # interleaved levels
            (standard_response("srgb", 4), 0, (1.0, 5.0), 200.0, 0.15),
            (linear_response(4), 2, (1.0, 2.5), 20.0, 0.7),  # dithered, with a black level
            (linear_response(4), 0, (1.0, 3.0), 20.0, 0.8),  # dithered, clipped at black
        ],
        every=2,
    ),
)
def test_light_is_near_the_exact_posterior(
    response: CameraResponse,
    black: int,
    exposures: tuple[float, ...],
    electrons: float,
    read: float,
) -> None:
    """The mean square error is at most 3 % above the least possible one."""
    noise = FrameNoise(electrons, read, black=black)
    frames = FrameSet(response, black, exposures, (noise,) * len(exposures))
    tuples, weights, mean, deviation = exact(frames)
    values = [np.array(each, np.uint8) for each in zip(*tuples, strict=True)]
    total = np.asarray(np.sum(values, axis=0, dtype=np.uint16))
    E, sd = light_tables(frames).estimate(values, total)
    weights /= weights.sum()
    least = np.sum(weights * deviation**2)
    assert np.sum(weights * (E - mean) ** 2) <= 0.03 * least
    assert np.sum(weights * sd**2) == pytest.approx(least, rel=0.05)


def test_a_posterior_of_the_quantiser_alone_is_the_middle_of_the_common_interval() -> None:
    """Levels of exposures 1 and 1.5 meet: 2 of 16 and more, and less than 3 of 24."""
    noise = FrameNoise(math.inf, 0.0)
    frames = FrameSet(linear_response(4), 0, (1.0, 1.5), (noise, noise))
    values = [np.array([5], np.uint8), np.array([8], np.uint8)]
    E, sd = light_tables(frames).estimate(values, np.array([13], np.uint16))
    low, high = 8 / 24, 6 / 16
    assert E[0] == pytest.approx((low + high) / 2, abs=1e-3 * (high - low))
    assert sd[0] == pytest.approx((high - low) / math.sqrt(12), rel=2e-3)


def test_tables_are_kept_by_response_exposures_and_noise() -> None:
    noise = FrameNoise(10.0, 0.5)
    first = light_tables(FrameSet(linear_response(4), 0, (1.0, 3.0), (noise, noise)))
    assert light_tables(FrameSet(linear_response(4), 0, (1.0, 3.0), (noise, noise))) is first
    other = FrameSet(standard_response("srgb", 4), 0, (1.0, 3.0), (noise, noise))
    assert light_tables(other) is not first


def test_first_lights_beyond_the_table_of_scores_do_not_meet() -> None:
    noise = FrameNoise(40.0, 0.3)
    frames = FrameSet(linear_response(8), 0, (1.0, 4.0), (noise, noise))
    tables = light_tables(frames)
    scores = tables._scores
    assert scores is not None
    values = [np.full(3, 40), np.full(3, 160)]
    bins = np.array([scores.size - 2, scores.size, tables.lights.size - 1])
    light, deviation, meets = scores.of(values, bins)
    assert np.isfinite(light).all()
    assert np.isfinite(deviation).all()
    assert not meets[1:].any()


@pytest.mark.parametrize(
    ("bits", "black", "exposures", "electrons", "read", "samples"),
    [
        # The longer frame is in range, and near saturation a smaller light says far less.
        (4, 0, (1.0, 30.0), 200.0, 0.3, [(0, 12), (0, 13), (1, 14)]),
        (4, 0, (1.0, 30.0), 3000.0, 0.05, [(0, 15), (4, 15), (10, 15)]),
        # The longer frame is saturated: the light is above its full scale, and not much.
        (4, 3, (1.0, 30.0), 100.0, 0.3, [(3, 18), (4, 18)]),
        (4, 0, (1.0, 30.0), math.inf, 0.1, [(0, 15), (1, 15)]),
    ],
)
def test_light_beside_full_scale_is_the_exact_posterior(
    bits: int,
    black: int,
    exposures: tuple[float, ...],
    electrons: float,
    read: float,
    samples: list[tuple[int, ...]],
) -> None:
    noise = FrameNoise(electrons, read, black=black)
    frames = FrameSet(linear_response(bits), black, exposures, (noise,) * len(exposures))
    values = [np.array(each, np.uint8) for each in zip(*samples, strict=True)]
    total = np.asarray(np.sum(values, axis=0, dtype=np.uint16))
    E, sd = light_tables(frames).estimate(values, total)
    single = probabilities(frames)
    for sample, light, deviation in zip(samples, E, sd, strict=True):
        joint = np.prod([each[k] for k, each in zip(sample, single, strict=True)], axis=0)
        mean = (joint * GRID).sum() / joint.sum()
        least = math.sqrt((joint * (GRID - mean) ** 2).sum() / joint.sum())
        assert abs(light - mean) < 0.15 * least, sample
        assert 0.9 < deviation / least < 1.15, sample


def test_frames_of_files_that_are_black_together_say_more_than_the_longest_of_them() -> None:
    """The error of the logarithm is less than with the longest one alone, and is in `sd`.

    Of the light that the longest frame may just show, exposures are a quarter apart.
    """
    rng = np.random.default_rng(1)
    real, exposures = linear_response(8), tuple(1.25**k for k in range(10))
    noise = FrameNoise(20.0, 0.4, compression_levels=0.5)
    frames = FrameSet(real, 0, exposures, (noise,) * len(exposures))
    light = real.levels[0] / exposures[-1] * rng.uniform(0.9, 1.6, 20_000)
    values = []
    for exposure in exposures:
        x = rng.poisson(exposure * light * 20 * 256) / (20 * 256)
        x += rng.normal(0, 0.4 / 256, light.size)
        levels = np.searchsorted(real.levels, x, "right") + rng.normal(0, 0.5, light.size)
        values.append(np.clip(np.round(levels), 0, 255).astype(np.uint8))
    tables = light_tables(frames)
    E, sd = tables.mean(values, np.asarray(np.sum(values, axis=0, dtype=np.uint16)))
    alone = tables.irradiance[-1][values[-1]]
    errors = [np.sqrt(np.mean(np.log(each / light) ** 2)) for each in (E, alone)]
    assert errors[0] < 0.58 * errors[1]
    assert 0.8 < np.sqrt(np.mean(((E - light) / sd) ** 2)) < 1.05
