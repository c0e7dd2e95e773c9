from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from camctl.model.convolution import LEFT_OUT, convolved
from camctl.model.response.camera import FloatArray

WIDE, NARROW, RARE = (300.0, 60.0), (6.0, 1.2), (0.0, 0.4)
"""Means and standard deviations of values of at least 0: most, all and few of them are above."""


def part(mean: float, sigma: float) -> FloatArray:
    """Return the probabilities of two integers: a normal one about `mean`, cut off at 0, and less.

    (W, 2); it is not symmetrical: a tenth is at the largest value.
    """
    value = np.arange(int(mean + 6 * sigma) + 2)
    columns = np.exp(-(((value[:, np.newaxis] - [mean, 0.9 * mean]) / sigma) ** 2) / 2)
    columns[-1] += columns.sum(axis=0) / 9
    return np.asarray(columns / columns.sum(axis=0))


@pytest.mark.parametrize(
    ("kinds", "counts"),
    [
        ([NARROW], [1]),
        ([RARE], [64]),
        ([WIDE], [12]),
        ([NARROW, RARE], [2, 1]),
        ([WIDE, NARROW], [1, 1]),
        ([WIDE, NARROW, RARE], [1, 64, 31]),
        ([NARROW, RARE], [40, 7]),
    ],
)
def test_sums_have_the_probabilities_of_convolutions(
    kinds: Sequence[tuple[float, float]], counts: Sequence[int]
) -> None:
    parts = [part(*kind) for kind in kinds]
    low, found = convolved(parts, counts)
    for column in range(2):
        exact = np.ones(1)
        for each, count in zip(parts, counts, strict=True):
            for _ in range(count):
                exact = np.convolve(exact, each[:, column])
        assert exact[:low].sum() <= LEFT_OUT
        assert exact[low + len(found) :].sum() <= LEFT_OUT
        np.testing.assert_allclose(
            found[:, column], exact[low : low + len(found)], rtol=0, atol=2 * LEFT_OUT
        )


def test_of_many_summands_few_of_the_possible_sums_are_probable() -> None:
    narrow = part(*NARROW)
    _, found = convolved([narrow], [64])
    assert len(found) < 64 * (len(narrow) - 1) / 2
