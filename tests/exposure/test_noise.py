from __future__ import annotations

import numpy as np
import pytest

from camctl.errors import UsageError
from camctl.exposure.effective import EffectiveCamera, effective_levels
from camctl.exposure.noise import noisy_effective_levels, quiet_levels, signal
from camctl.exposure.objective import xi
from camctl.exposure.robustness import sensitivity, shifted
from camctl.response.camera import linear_response, standard_response
from camctl.response.desired import desired_response

EIGHT_BIT = linear_response(8)
LOG = desired_response("log", 1000.0)


@pytest.mark.parametrize("phase", [0.0, 0.5])
def test_the_signal_is_what_the_quantiser_floors(phase: float) -> None:
    E = np.linspace(0, 0.99, 500)
    seen = signal(linear_response(8, phase=phase), E)
    np.testing.assert_allclose(seen, 256 * E + phase, atol=1e-9)


@pytest.mark.parametrize(("sigma", "electrons"), [(0.3, np.inf), (1.5, np.inf), (0.5, 8.0)])
def test_effective_levels_in_noise_against_drawn_frames(sigma: float, electrons: float) -> None:
    """A million noisy sums of three frames, read off the middles of their gaps."""
    camera = EffectiveCamera.of(EIGHT_BIT, (1, 9.91, 88.38))
    predicted = noisy_effective_levels(
        camera, LOG, read_noise_levels=sigma, electrons_per_level=electrons
    )
    rng = np.random.default_rng(21)
    u = rng.random(1_000_000)
    E = LOG.inverse(u)
    total = np.zeros(u.size, dtype=np.int64)
    for e in camera.exposures:
        spread = np.sqrt(sigma**2 + e * E * 256 / electrons)
        frame = np.floor(e * E * 256 + spread * rng.standard_normal(u.size))
        total += np.clip(frame, 0, 255).astype(np.int64)
    heights = LOG.u(np.concatenate([[LOG.e_min], camera.levels, [1.0]]))
    middles = (heights[1:] + heights[:-1]) / 2
    drawn = (12 * np.mean((middles[total] - u) ** 2)) ** -0.5
    assert predicted == pytest.approx(drawn, rel=0.01)


@pytest.mark.parametrize("exposures", [(1,), (1, 1.003, 2.985), (1, 9.91, 88.38)])
def test_without_noise_they_are_the_effective_levels(exposures: tuple[float, ...]) -> None:
    camera = EffectiveCamera.of(EIGHT_BIT, exposures)
    for name in ("linear", "gamma", "log"):
        desired = desired_response(name, 300.0)
        noisy = noisy_effective_levels(camera, desired, read_noise_levels=0)
        assert noisy == pytest.approx(effective_levels(camera, desired), rel=0.02)


def test_half_a_level_of_noise_makes_an_interleave_worthless() -> None:
    desired = desired_response("linear", 256.0)
    found = sensitivity(EIGHT_BIT, desired, (1, 1.003))
    assert found.effective_levels > 1.4 * 255
    assert found.noise[0.1] > 1.2 * found.noise_of_equal[0.1]
    assert found.noise[0.5] == pytest.approx(found.noise_of_equal[0.5], rel=0.01)
    assert found.noise[2.0] == pytest.approx(found.noise_of_equal[2.0], rel=0.01)


def test_one_percent_off_destroys_an_interleave_and_not_a_wide_set() -> None:
    linear = desired_response("linear", 256.0)
    fragile = sensitivity(EIGHT_BIT, linear, (1, 1.00278))
    sturdy = sensitivity(EIGHT_BIT, LOG, (1, 9.91, 88.38))
    assert fragile.exposure_errors[1e-2].xi > 1.2 * fragile.xi
    assert fragile.exposure_errors[1e-4].xi < 1.01 * fragile.xi
    assert sturdy.exposure_errors[1e-2].xi < 1.05 * sturdy.xi
    for spread in (*fragile.exposure_errors.values(), fragile.phase):
        assert spread.xi <= spread.xi_worst
        assert spread.effective_levels >= spread.effective_levels_worst


def test_shifting_by_a_phase_is_the_camera_with_that_phase() -> None:
    np.testing.assert_allclose(
        shifted(EIGHT_BIT, 0.25).levels, linear_response(8, phase=0.25).levels, rtol=1e-12
    )
    shifted(standard_response("srgb", 8), 0.9)  # a valid camera too


def test_the_phase_spread_holds_floor_and_rounding() -> None:
    desired = desired_response("gamma", 1000.0)
    found = sensitivity(EIGHT_BIT, desired, (1, 2, 4))
    rounding = EffectiveCamera.of(linear_response(8, phase=0.5), (1, 2, 4))
    assert round(effective_levels(rounding, desired)) == 448
    assert found.phase.effective_levels_worst <= found.effective_levels < 448
    assert found.phase.effective_levels > found.effective_levels


def test_drowned_levels_leave_the_camera() -> None:
    camera = EffectiveCamera.of(EIGHT_BIT, (1, 9.91, 88.38))
    all_levels = quiet_levels(camera, LOG, 765, read_noise_levels=0)
    some = quiet_levels(camera, LOG, 765, read_noise_levels=0.5)
    none = quiet_levels(camera, LOG, 765, read_noise_levels=60, share=1e-3)
    assert np.array_equal(all_levels, camera.levels)
    assert 0 < some.size < camera.levels.size
    assert xi(some, LOG, 765) > xi(camera, LOG, 765)
    assert not np.any((none > LOG.e_min) & (none < 1))
    # the first frame's noise is 0.5 / 256 of irradiance, the wanted step E ln(1000) / 765 at E
    first_frame = np.arange(1, 256) / 256
    kept = first_frame[first_frame * np.log(1000) / 765 >= 0.5 / 256]
    assert np.all(np.isin(kept, some))


@pytest.mark.parametrize(
    ("noise", "electrons"), [(-1.0, 1.0), (float("nan"), 1.0), (1e3, 1.0), (0.5, 0.0)]
)
def test_noise_that_cannot_be(noise: float, electrons: float) -> None:
    camera = EffectiveCamera.of(EIGHT_BIT, (1, 2))
    with pytest.raises(UsageError):
        noisy_effective_levels(camera, LOG, read_noise_levels=noise, electrons_per_level=electrons)
