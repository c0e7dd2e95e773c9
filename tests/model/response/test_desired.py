from __future__ import annotations

import mpmath
import numpy as np
import pytest

from camctl.errors import DataError, UsageError
from camctl.model.response.desired import desired_response
from camctl.model.response.tabulated import tabulated_desired


@pytest.mark.parametrize(
    ("name", "dynamic_range", "message"),
    [
        ("lgo", 100.0, "unknown response 'lgo'; did you mean log"),
        ("log", 1.0, "invalid dynamic range 1: expected a number above 1"),
        ("log", 0.5, "invalid dynamic range 0.5: expected a number above 1"),
        ("log", float("nan"), "invalid dynamic range nan: expected a number above 1"),
        ("log", float("inf"), "no value at zero irradiance; choose a finite dynamic range"),
        ("log", "mediun", "unknown dynamic range 'mediun'; did you mean medium"),
    ],
)
def test_invalid_desired_responses_are_refused(
    name: str, dynamic_range: float | str, message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        desired_response(name, dynamic_range)


@pytest.mark.parametrize("name", ["linear", "gamma", "log"])
@pytest.mark.parametrize("dynamic_range", [1.001, 256.0, 1e7])
def test_inverse_of_a_desired_response(name: str, dynamic_range: float) -> None:
    desired = desired_response(name, dynamic_range)
    u = np.linspace(0, 1, 101)
    np.testing.assert_allclose(desired.u(desired.inverse(u)), u, atol=1e-12)
    assert desired.u([desired.e_min, 1.0]).tolist() == pytest.approx([0, 1], abs=1e-12)
    assert desired.u([0.0, 5.0]).tolist() == pytest.approx([0, 1], abs=1e-12)


@pytest.mark.parametrize("gamma", [0.01, 0.2, 0.45, 1.0, 2.2, 100.0])
def test_any_gamma_follows_its_formula(gamma: float) -> None:
    desired = desired_response("gamma", 100.0, gamma=gamma)
    E = np.linspace(0.01, 1, 200)
    expected = (E**gamma - 0.01**gamma) / (1 - 0.01**gamma)
    np.testing.assert_allclose(desired.u(E), expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("gamma", [0.01, 0.45, 0.5, 1 - 1e-9, 1 + 1e-7, 2.2, 50.0, 100.0])
@pytest.mark.parametrize("dynamic_range", [1.001, 1000.0, 1e7, 1e12])
def test_rise_of_any_gamma_is_exact_over_any_range(gamma: float, dynamic_range: float) -> None:
    """At gamma 100 and 1:10^7, e_min^gamma is 10^-700: far below the smallest float."""
    desired = desired_response("gamma", dynamic_range, gamma=gamma)
    power = np.random.default_rng(1).random((50, 2))
    a, b = np.sort(desired.e_min**power, axis=1).T
    b[:10] = np.minimum(a[:10] * (1 + 1e-14), 1.0)
    with mpmath.workdps(50):
        q = mpmath.mpf(gamma)
        span = 1 - mpmath.mpf(desired.e_min) ** q
        exact = [
            float((mpmath.mpf(high) ** q - mpmath.mpf(low) ** q) / span)
            for low, high in zip(a.tolist(), b.tolist(), strict=True)
        ]
    # 1 - e_min^gamma loses three digits at a range of 1.001, where e_min itself is rounded.
    np.testing.assert_allclose(desired.rise(a, b), exact, rtol=1e-12, atol=1e-290)
    np.testing.assert_allclose(desired.u(desired.inverse(power)), power, rtol=0, atol=1e-10)


@pytest.mark.parametrize("gamma", [0.01, 0.999, 1.001, 100.0])
def test_a_slope_that_no_irradiance_has_overflows_silently(gamma: float) -> None:
    found = desired_response("gamma", 1e7, gamma=gamma).inverse_slope(np.array([1e-300, 1e300]))
    assert not np.isnan(found).any()


@pytest.mark.parametrize("dynamic_range", [1e13, 1e308])
@pytest.mark.parametrize("name", ["linear", "gamma", "log"])
def test_dynamic_range_is_limited(name: str, dynamic_range: float) -> None:
    with pytest.raises(UsageError, match="expected a number above 1, at most 1,000,000,000,000"):
        desired_response(name, dynamic_range)


def test_gammas_have_different_keys() -> None:
    keys = {desired_response("gamma", 100.0, gamma=g).key for g in (0.45, 0.45 + 1e-9, 0.5, 1.0)}
    assert len(keys) == 4
    assert desired_response("gamma", 100.0).key == desired_response("gamma", 100.0, gamma=0.5).key


@pytest.mark.parametrize("gamma", [0.0, -1.0, 101.0, float("nan")])
def test_gamma_out_of_range_is_refused(gamma: float) -> None:
    with pytest.raises(UsageError, match=f"invalid gamma {gamma:g}: expected 0.01 to 100"):
        desired_response("gamma", 100.0, gamma=gamma)


@pytest.mark.parametrize("name", ["linear", "log"])
def test_gamma_is_refused_for_other_responses(name: str) -> None:
    message = f"gamma 0.45 does not apply to the response '{name}'; choose the response 'gamma'"
    with pytest.raises(UsageError, match=message):
        desired_response(name, 100.0, gamma=0.45)


def test_sampled_curve_is_scaled_to_full_range() -> None:
    """Irradiance and u may be in any unit; the curve is linear between its points."""
    desired = tabulated_desired([2.0, 20.0, 200.0], [10, 40, 50], name="custom")
    assert desired.name == "custom"
    assert desired.dynamic_range == 100
    assert desired.u([0.01, 0.1, 0.55, 1.0]).tolist() == pytest.approx([0, 0.75, 0.875, 1])
    assert desired.key != tabulated_desired([2.0, 20.0, 200.0], [10, 41, 50], name="custom").key


def test_inverse_of_a_table_at_a_flat_run_is_its_left_end() -> None:
    table = tabulated_desired([0.1, 0.2, 0.4, 1.0], [0, 0.5, 0.5, 1])
    assert table.inverse([0.0, 0.25, 0.5, 0.75, 1.0]).tolist() == pytest.approx(
        [0.1, 0.15, 0.2, 0.7, 1.0]
    )


@pytest.mark.parametrize(
    ("E", "u", "message"),
    [
        ([0.1], [0.0], "expected two or more pairs"),
        ([0.1, 1.0], [0.0], "expected two or more pairs"),
        ([0.1, 1.0], [0.0, float("nan")], "a number is not finite"),
        ([0.0, 1.0], [0.0, 1.0], "irradiance must be positive and increase from row to row"),
        ([0.5, 0.5], [0.0, 1.0], "irradiance must be positive and increase from row to row"),
        ([0.1, 0.5, 1.0], [0.0, 0.6, 0.5], "u must not decrease and must not be constant"),
        ([0.1, 1.0], [0.5, 0.5], "u must not decrease and must not be constant"),
    ],
)
def test_invalid_tables_are_refused(E: list[float], u: list[float], message: str) -> None:
    with pytest.raises(DataError, match=f"invalid desired response 'table': {message}"):
        tabulated_desired(E, u)
