"""Exposure ratios estimated from pixels: unbiased, with correct intervals, or refused."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from camctl.errors import DataError
from camctl.evidence.patches import Patches, sample_patches
from camctl.evidence.ratios import RatioEstimates, estimate_comparable, estimate_ratios
from camctl.model.noise import FrameNoise
from camctl.model.response.camera import CameraResponse, linear_response, standard_response
from camctl.model.sensor import SensorModel

NOISE = FrameNoise(40.0, 0.7)


def smooth(low: float = 0.02, rows: int = 240, columns: int = 320) -> NDArray[np.float64]:
    """Return light with gradients in all directions, from `low` to 1."""
    y, x = np.mgrid[0:rows, 0:columns] / columns
    light = np.exp(np.sin(9 * x) + np.sin(7 * y + 2) + x)
    light = (light - light.min()) / np.ptp(light)
    return np.asarray(low + (1 - low) * light, np.float64)


def shoot(
    light: NDArray[np.floating],
    exposure: float,
    real: CameraResponse,
    *,
    black: int = 0,
    noise: FrameNoise = NOISE,
    seed: int = 0,
) -> Patches:
    """Return the patches of a simulated frame; the noise is that of the linear scale."""
    random = np.random.default_rng(seed)
    levels = real.M + 1
    electrons = np.maximum(light * exposure * levels * noise.electrons_per_level, 0)
    E = random.poisson(electrons) / noise.electrons_per_level / levels
    E = E + random.normal(0, noise.read_noise_levels / levels, light.shape)
    code = np.searchsorted(real.levels, E, side="right") + black
    if black:
        step = real.levels[1] - real.levels[0]
        below = np.floor((E - real.levels[0]) / step).astype(int) + 1
        code = np.where(below < 0, np.maximum(below + black, 0), code)
    return sample_patches([code.astype(np.uint16)], real.M + black)


def errors(found: RatioEstimates, true: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the relative errors of the ratios to the reference frame."""
    ratios = np.array(found.exposures) / found.exposures[found.reference]
    return np.asarray(ratios / (true / true[found.reference]) - 1)


@pytest.mark.parametrize(
    ("real", "black"),
    [
        (linear_response(8, phase=0.5), 0),
        pytest.param(linear_response(10, phase=0.5, levels=959), 64, marks=pytest.mark.slow),
        pytest.param(linear_response(12), 0, marks=pytest.mark.slow),
        pytest.param(standard_response("srgb", 8, phase=0.5), 0, marks=pytest.mark.slow),
        pytest.param(
            standard_response("power", 10, phase=0.5, gamma=1.8), 0, marks=pytest.mark.slow
        ),
    ],
)
def test_ratios_are_unbiased_and_their_intervals_are_honest(
    real: CameraResponse, black: int
) -> None:
    true = np.array([0.25, 0.51, 0.985, 2.03])
    labels = [0.25, 0.5, 1.0, 2.0]
    scale, light = SensorModel(real, black), smooth()
    found = []
    covered = 0
    for seed in range(12):
        frames = [
            shoot(light, each, real, black=black, seed=seed * 10 + k) for k, each in enumerate(true)
        ]
        estimates = estimate_ratios(frames, labels, scale, [NOISE] * 4)
        error = errors(estimates, true)
        half = np.array(estimates.high) / np.array(estimates.exposures) - 1
        covered += int(np.count_nonzero(np.abs(error) <= half + 1e-15))
        found.append(error)
    bias, spread = np.mean(found, axis=0), np.std(found, axis=0) / np.sqrt(12)
    assert (np.abs(bias) <= 3.5 * spread + 1e-4).all()
    assert np.abs(bias).max() < 5e-4
    assert covered >= 0.9 * 12 * 4


def test_black_offset_is_within_the_interval() -> None:
    real = linear_response(8, phase=0.5)
    true = np.array([0.25, 1.0])
    light = smooth()
    frames = [shoot(light + 0.3 / 256 / each, each, real, seed=k) for k, each in enumerate(true)]
    found = estimate_ratios(frames, list(true), SensorModel(real, 0), [NOISE] * 2)
    half = np.array(found.high) / np.array(found.exposures) - 1
    assert (np.abs(errors(found, true)) <= half + 1e-12).all()


def test_unknown_noise_costs_little() -> None:
    real = linear_response(8, phase=0.5)
    true = np.array([0.3, 1.0])
    frames = [shoot(smooth(), each, real, seed=k) for k, each in enumerate(true)]
    found = estimate_ratios(frames, [0.3, 1.0], SensorModel(real, 0))
    half = max(np.array(found.high) / np.array(found.exposures) - 1)
    assert half < 1.5e-3
    assert np.abs(errors(found, true)).max() < 1.5 * half


@pytest.mark.parametrize("bits", [4, 6, 8])
def test_rounding_without_noise_widens_the_interval(bits: int) -> None:
    real = linear_response(bits)
    true = np.array([0.4, 1.0])
    # A chart of few grey levels, whose rounding errors do not average out.
    light = np.kron(np.linspace(0.3, 0.95, 12).reshape(3, 4), np.ones((64, 64)))
    none = FrameNoise(1e12, 0.0)
    frames = [shoot(light, each, real, noise=none) for each in true]
    found = estimate_ratios(frames, list(true), SensorModel(real, 0), [none] * 2)
    half = max(np.array(found.high) / np.array(found.exposures) - 1)
    assert np.abs(errors(found, true)).max() <= half
    assert half > 0.1 / 2**bits


@pytest.mark.parametrize("share", [0.02, 0.1])
def test_moving_object_does_not_count(share: float) -> None:
    real = linear_response(8, phase=0.5)
    true = np.array([0.4, 1.0])
    light = smooth()
    frames = []
    for k, each in enumerate(true):
        here = light.copy()
        width = int(share * light.shape[1])
        here[:, 40 * k : 40 * k + width] = 0.8 if k else 0.1
        frames.append(shoot(here, each, real, seed=k))
    found = estimate_ratios(frames, list(true), SensorModel(real, 0), [NOISE] * 2)
    assert np.abs(errors(found, true)).max() < 2e-3
    assert found.moved > 0.3 * share


def test_wrong_labels_do_not_matter() -> None:
    real = linear_response(8, phase=0.5)
    true = np.array([0.2, 0.4, 0.8])
    frames = [shoot(smooth(), each, real, seed=k) for k, each in enumerate(true)]
    right = estimate_ratios(frames, list(true), SensorModel(real, 0), [NOISE] * 3)
    wrong = estimate_ratios(frames, [1.0, 0.1, 5.0], SensorModel(real, 0), [NOISE] * 3)
    assert errors(wrong, true) == pytest.approx(errors(right, true), abs=1e-12)


def test_frames_without_light_in_common_are_left_out() -> None:
    real, true = linear_response(8, phase=0.5), [0.25, 1e4, 1.0]
    light = np.geomspace(0.05, 3, 40_000).reshape(200, 200)
    frames = [shoot(light, each, real, seed=k) for k, each in enumerate(true)]
    scale = SensorModel(real, 0)
    used, found = estimate_comparable(frames, true, scale, [NOISE] * 3)
    assert used == [0, 2]
    assert found == estimate_ratios(frames[::2], true[::2], scale, [NOISE] * 2)


def test_frames_that_share_no_neighbour_are_connected_through_others() -> None:
    real = linear_response(8, phase=0.5)
    true = np.array([0.05, 0.25, 1.0, 4.0])
    light = np.geomspace(0.05, 3, 40_000).reshape(200, 200)
    order = [3, 0, 2, 1]
    frames = [shoot(light, true[k], real, seed=k) for k in order]
    found = estimate_ratios(frames, list(true[order]), SensorModel(real, 0), [NOISE] * 4)
    error = errors(found, true[order])
    half = np.array(found.high) / np.array(found.exposures) - 1
    assert (np.abs(error) <= 2 * half + 1e-12).all()
    assert np.abs(error).max() < 0.02


def refused(frames: list[Patches], labels: list[float], real: CameraResponse) -> str:
    with pytest.raises(DataError) as caught:
        estimate_ratios(frames, labels, SensorModel(real, 0), [NOISE] * len(frames))
    assert caught.value.hint
    return caught.value.what


def test_frames_that_cannot_be_compared_are_refused_with_the_reason() -> None:
    real = linear_response(8, phase=0.5)
    light = smooth()
    one = shoot(light, 0.5, real)
    assert "one frame" in refused([one], [1.0], real)
    assert "sizes" in refused([one, one[:-3]], [1.0, 2.0], real)
    dark = shoot(np.zeros_like(light), 1, real)
    assert "black" in refused([dark, dark], [1.0, 2.0], real)
    white = shoot(light + 3, 1, real)
    assert "saturated everywhere" in refused([white, white], [1.0, 2.0], real)
    flat = np.full_like(light, 0.5)
    apart = [shoot(flat, 0.01, real), shoot(flat, 1.2, real), shoot(flat, 1.3, real)]
    assert refused(apart[:2], [0.01, 1.2], real)
    far = [shoot(light, 0.5, real), shoot(light + 5, 1, real)]
    assert "frames 1 and 2 have no common pixels" in refused(far, [1.0, 10.0], real)


def test_moved_camera_is_refused() -> None:
    real = linear_response(8, phase=0.5)
    random = np.random.default_rng(0)
    light = np.kron(random.uniform(0.05, 0.9, (40, 50)), np.ones((9, 9)))
    frames = [
        shoot(light, 0.4, real),
        shoot(np.roll(light, (60, 75), axis=(0, 1)), 1.0, real, seed=1),
    ]
    assert "moved" in refused(frames, [0.4, 1.0], real)


def test_a_frame_that_shares_one_small_place_with_the_others_is_refused() -> None:
    real = linear_response(8, phase=0.5)
    frames = [shoot(smooth(), exposure, real, seed=k) for k, exposure in enumerate((0.25, 0.5, 1))]
    frames[2][: -len(frames[2]) // 16] = 255  # the rest is one of 16 blocks
    with pytest.raises(DataError, match="agrees with the others in one small place only"):
        estimate_ratios(frames, (0.25, 0.5, 1), SensorModel(real, 0))
