from __future__ import annotations

import doctest

import pytest
from hypothesis import given
from hypothesis import strategies as st

import menu.numbers
from menu.numbers import count_of, exact_time, multiple, share, short_time, times


def test_the_examples_hold() -> None:
    assert doctest.testmod(menu.numbers).failed == 0


@pytest.mark.parametrize(
    ("time_s", "words"),
    [
        (1e-6, "1 us"),
        (999.6e-6, "1 ms"),
        (999.4e-6, "999 us"),
        (0.9996, "1 s"),
        (1 / 30, "33.3 ms"),
        (3599.6, "3600 s"),
        (100.0, "100 s"),
        (86400.0, "24 h"),
    ],
)
def test_short_times(time_s: float, words: str) -> None:
    assert short_time(time_s) == words


@given(st.floats(1e-6, 3600))
def test_times_keep_their_digits(time_s: float) -> None:
    for write, digits in ((short_time, 3), (exact_time, 7)):
        number, unit = write(time_s).split()
        value = float(number) * {"s": 1.0, "ms": 1e-3, "us": 1e-6}[unit]
        assert value == pytest.approx(time_s, rel=0.51 * 10.0 ** (1 - digits), abs=0)
        assert len(number) <= digits + 1


@given(st.floats(1e-3, 9.9e7))
def test_counts_fit(levels: float) -> None:
    assert len(count_of(levels)) <= 5


@given(st.floats(1, 1e7))
def test_ratios_keep_their_digits(ratio: float) -> None:
    assert len(times(ratio)) <= 6
    assert float(times(ratio).replace("k", "e3")) == pytest.approx(ratio, rel=0.0051)
    assert float(multiple(ratio)) == pytest.approx(ratio, rel=0.00051)


def test_a_little_is_not_nothing() -> None:
    assert (share(0.0), share(1e-9), share(1.0)) == ("0 %", "<0.01 %", "100 %")
