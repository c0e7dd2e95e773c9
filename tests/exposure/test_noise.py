from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from sampling import some

from camctl.errors import UsageError
from camctl.exposure.noise import (
    MAX_SIGMA,
    MAX_WEIGHT,
    NOISE_KINDS,
    NoiseTerm,
    noisy_effective_levels,
)
from camctl.exposure.robustness import sensitivity, shifted
from camctl.model import convolution, distribution, inverse
from camctl.model.distribution import NoisySum
from camctl.model.effective import EffectiveCamera, effective_levels
from camctl.model.inverse import Posterior, posterior_of
from camctl.model.noise import FrameNoise
from camctl.model.response.camera import FloatArray, linear_response, standard_response
from camctl.model.response.desired import desired_response

EIGHT_BIT = linear_response(8)
LOG = desired_response("log", 1000.0)


@pytest.mark.parametrize(("sigma", "electrons"), [(0.3, np.inf), (1.5, np.inf), (0.5, 8.0)])
def test_effective_levels_with_noise_agree_with_simulated_frames(
    sigma: float, electrons: float
) -> None:
    """A million noisy sums of three frames, each converted by the inverse of the sum."""
    camera = EffectiveCamera.of(EIGHT_BIT, (1, 9.91, 88.38))
    noise = [FrameNoise(electrons, sigma)] * 3
    predicted = noisy_effective_levels(camera, LOG, noise)
    rng = np.random.default_rng(21)
    u = rng.random(1_000_000)
    E = LOG.inverse(u)
    total = np.zeros(u.size, dtype=np.int64)
    for e in camera.exposures:
        spread = np.sqrt(sigma**2 + e * E * 256 / electrons)
        frame = np.floor(e * E * 256 + spread * rng.standard_normal(u.size))
        total += np.clip(frame, 0, 255).astype(np.int64)
    found = Posterior(camera, LOG, noise).inverse.u[total]
    simulated = (12 * np.mean((found - u) ** 2)) ** -0.5
    assert predicted == pytest.approx(simulated, rel=0.005)


@pytest.mark.parametrize("exposures", [(1,), (1, 1.003, 2.985), (1, 9.91, 88.38)])
def test_zero_noise_gives_the_noise_free_effective_levels(exposures: tuple[float, ...]) -> None:
    camera = EffectiveCamera.of(EIGHT_BIT, exposures)
    for name in ("linear", "gamma", "log"):
        desired = desired_response(name, 300.0)
        noisy = noisy_effective_levels(
            camera, desired, [FrameNoise(math.inf, 0.0)] * len(exposures)
        )
        assert noisy == pytest.approx(effective_levels(camera, desired), rel=1e-9)


@pytest.mark.parametrize("dynamic_range", [1.0000000000000002, 1.0000001, 1.00001, 1.001])
@pytest.mark.parametrize("name", ["linear", "gamma", "log"])
def test_a_very_narrow_range_takes_no_more_cells_than_a_wide_one(
    name: str, dynamic_range: float
) -> None:
    camera, noise = EffectiveCamera.of(EIGHT_BIT, (1, 2, 4)), [FrameNoise(10.0, 0.1)] * 3
    cells = Posterior(camera, desired_response(name, dynamic_range), noise)._cells
    assert cells.size < 100_000


def test_interleaved_exposures_gain_nothing_with_half_a_level_of_noise() -> None:
    desired = desired_response("linear", 256.0)
    found = sensitivity(EIGHT_BIT, desired, (1, 1.003))
    assert found.effective_levels > 1.4 * 255
    assert found.noise[0.1] > 1.2 * found.noise_of_equal[0.1]
    assert found.noise[0.5] == pytest.approx(found.noise_of_equal[0.5], rel=0.01)
    assert found.noise[2.0] == pytest.approx(found.noise_of_equal[2.0], rel=0.01)


def test_exposure_errors_of_one_percent_destroy_only_interleaved_exposures() -> None:
    linear = desired_response("linear", 256.0)
    interleaved = sensitivity(EIGHT_BIT, linear, (1, 1.00278))
    wide = sensitivity(EIGHT_BIT, LOG, (1, 9.91, 88.38))
    assert interleaved.exposure_errors[1e-2].xi > 1.2 * interleaved.xi
    assert interleaved.exposure_errors[1e-4].xi < 1.01 * interleaved.xi
    assert wide.exposure_errors[1e-2].xi < 1.05 * wide.xi
    for spread in (*interleaved.exposure_errors.values(), interleaved.phase):
        assert spread.xi <= spread.xi_worst
        assert spread.effective_levels >= spread.effective_levels_worst


def test_shifted_levels_are_those_of_a_camera_with_that_phase() -> None:
    np.testing.assert_allclose(
        shifted(EIGHT_BIT, 0.25).levels, linear_response(8, phase=0.25).levels, rtol=1e-12
    )
    shifted(standard_response("srgb", 8), 0.9)  # is a valid response


def test_phase_spread_includes_truncation_and_rounding() -> None:
    desired = desired_response("gamma", 1000.0)
    found = sensitivity(EIGHT_BIT, desired, (1, 2, 4))
    rounding = EffectiveCamera.of(linear_response(8, phase=0.5), (1, 2, 4))
    assert round(effective_levels(rounding, desired)) == 448
    assert found.phase.effective_levels_worst <= found.effective_levels < 448
    assert found.phase.effective_levels > found.effective_levels


@pytest.mark.parametrize(
    ("noise", "electrons", "message"),
    [
        (-1.0, 1.0, "invalid read noise of -1 levels: expected 0 to 64"),
        (float("nan"), 1.0, "invalid read noise of nan levels: expected 0 to 64"),
        (1e3, 1.0, "invalid read noise of 1000 levels: expected 0 to 64"),
        (0.5, 0.0, "invalid number of electrons per level 0: expected at least 0.001"),
    ],
)
def test_invalid_noise_is_refused(noise: float, electrons: float, message: str) -> None:
    camera = EffectiveCamera.of(EIGHT_BIT, (1, 2))
    with pytest.raises(UsageError, match=message):
        noisy_effective_levels(camera, LOG, [FrameNoise(electrons, noise)] * 2)


def test_noise_of_many_levels_is_that_of_fewer_levels() -> None:
    """Long exposures of the dark have it, at a high gain; 12 bits are rated by 10."""
    noise, fine = FrameNoise(0.5, 100.0), EffectiveCamera.of(linear_response(12), (1, 30.0))
    coarse = EffectiveCamera.of(linear_response(10), (1, 30.0))
    found = noisy_effective_levels(fine, LOG, [noise] * 2)
    expected = noisy_effective_levels(coarse, LOG, [FrameNoise(2.0, 25.0)] * 2)
    assert found == pytest.approx(expected, rel=1e-3)


def test_each_exposure_needs_its_noise() -> None:
    camera = EffectiveCamera.of(EIGHT_BIT, (1, 2))
    with pytest.raises(UsageError, match="noise of 1 frames for 2 exposures"):
        noisy_effective_levels(camera, LOG, [FrameNoise(40.0, 1.0)])


def test_noise_belongs_to_its_exposure() -> None:
    """With (1, 100) the short exposure has few levels where the long one saturates."""
    camera = EffectiveCamera.of(EIGHT_BIT, (1, 100))
    quiet, loud = FrameNoise(40.0, 0.5), FrameNoise(40.0, 3.0)
    short_is_loud = noisy_effective_levels(camera, LOG, [loud, quiet])
    assert short_is_loud < 0.5 * noisy_effective_levels(camera, LOG, [quiet, loud])


def test_unknown_noise_term_suggests_similar_names() -> None:
    with pytest.raises(UsageError, match="unknown noise term 'papr'; did you mean paper"):
        NoiseTerm(0.01, kind="papr")


@pytest.mark.parametrize(
    ("sigma", "weight", "message"),
    [
        (1e300, 1.0, r"invalid noise sigma 1e\+300: expected 0 to 1000"),
        (math.nan, 1.0, "invalid noise sigma nan: expected 0 to 1000"),
        (-1.0, 1.0, "invalid noise sigma -1: expected 0 to 1000"),
        (1.0, 1e300, r"invalid noise weight 1e\+300: expected 0 to 1e\+15"),
    ],
)
def test_noise_terms_beyond_use_are_refused(sigma: float, weight: float, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        NoiseTerm(sigma, weight)


@pytest.mark.parametrize("kind", NOISE_KINDS)
def test_the_largest_noise_term_is_finite(kind: str) -> None:
    cost = NoiseTerm(MAX_SIGMA, MAX_WEIGHT, kind).cost(np.array([[1.0, 1.0], [1.0, 1e100]]))
    assert np.all(np.isfinite(cost))


@pytest.mark.parametrize("name", ["linear", "gamma", "log"])
@pytest.mark.parametrize("dynamic_range", some([1 + 1e-9, 1.0001, 1.5], every=2))
def test_the_work_does_not_grow_with_the_narrowness_of_the_range(
    name: str, dynamic_range: float
) -> None:
    """Outside of a narrow range v reaches far beyond 0 to 1; levels agree with simulated frames."""
    desired = desired_response(name, dynamic_range)
    camera = EffectiveCamera.of(EIGHT_BIT, (1, 2, 4))
    noise = [FrameNoise(1000.0, 1.5)] * 3
    posterior = Posterior(camera, desired, noise)
    assert posterior._nodes[0].size < 20_000
    rng = np.random.default_rng(3)
    u = rng.random(400_000)
    E = desired.inverse(u)
    total = np.zeros(u.size, dtype=np.int64)
    for e in camera.exposures:
        spread = np.sqrt(1.5**2 + e * E * 256 / 1000)
        frame = np.floor(e * E * 256 + spread * rng.standard_normal(u.size))
        total += np.clip(frame, 0, 255).astype(np.int64)
    simulated = (12 * np.mean((posterior.inverse.u[total] - u) ** 2)) ** -0.5
    assert posterior.inverse.effective_levels == pytest.approx(simulated, rel=0.01)


def test_few_irradiances_are_convolved_where_white_cuts_off_much_noise(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """They are computed apart from the others, whose sums are normal: 13 bits, 4 frames."""
    camera = EffectiveCamera.of(linear_response(13), [1, 2, 5, 12])
    noise = [FrameNoise(0.8, 3.0)] * 4
    posterior = Posterior(camera, LOG, noise)
    expected, sizes = posterior.mse, []
    convolved = convolution.convolved

    def counted(parts: Sequence[FloatArray], counts: Sequence[int]) -> tuple[int, FloatArray]:
        sizes.append(sum(sorted(each.size for each in parts)[:-1]))
        return convolved(parts, counts)

    monkeypatch.setattr(distribution, "convolved", counted)
    assert Posterior(camera, LOG, noise).mse == expected
    apart, sizes = sum(sizes), []
    monkeypatch.setattr(NoisySum, "clips_widely", lambda self, E: np.zeros(E.size, dtype=bool))
    assert Posterior(camera, LOG, noise).mse == pytest.approx(expected, rel=1e-9)
    assert apart < sum(sizes) / 2


def test_of_large_cameras_only_the_last_posterior_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each of 16 frames of 16 bits has a hundred megabytes."""
    desired, noise = desired_response("log", 100.0), [FrameNoise(100.0, 0.5)]
    cameras = [EffectiveCamera.of(linear_response(bits), (1,)) for bits in (3, 4)]

    def kept() -> bool:
        first = posterior_of(cameras[0], desired, noise)
        posterior_of(cameras[1], desired, noise)
        return posterior_of(cameras[0], desired, noise) is first

    assert kept()
    monkeypatch.setattr(inverse, "_MOST_KEPT_LEVELS", 5)
    assert not kept()


@pytest.mark.parametrize(
    "frame",
    [
        FrameNoise(20.0, 1.5),
        FrameNoise(5.0, 0.05, black=4),
        FrameNoise(40.0, 0.8, dark_levels=0.3, dsnu_levels=1.0),
        FrameNoise(math.inf, 0.0),
    ],
)
@pytest.mark.parametrize("exposures", [(1, 9.0, 80.0), (1, 200.0), (1, *range(2, 41))])
def test_what_is_dark_follows_from_the_darker_nodes_alone(
    frame: FrameNoise, exposures: tuple[float, ...]
) -> None:
    camera, noise = EffectiveCamera.of(EIGHT_BIT, exposures), [frame] * len(exposures)
    alone, whole = Posterior(camera, LOG, noise), Posterior(camera, LOG, noise)
    expected = LOG.e_min > whole.inverse.E
    expected[: whole.sum.black + 1] = True
    assert np.array_equal(alone.dark, expected)
    assert "inverse" not in vars(alone)
    E = np.geomspace(1e-5, 1.1, 200)
    assert alone.dark_shares(E) == pytest.approx(whole.shares(E, expected), abs=1e-8)
