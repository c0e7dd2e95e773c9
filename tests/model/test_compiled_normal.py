"""Compiled exponentials and probabilities are those of the library of C."""

import math

import numpy as np
import pytest

from camctl.model.compiled_normal import exponential, probability


def test_exponentials_and_probabilities_are_exact_to_what_is_stated() -> None:
    pytest.importorskip("numba")
    x = np.linspace(-87, 80, 501).astype(np.float32)
    found = np.array([exponential(each) for each in x])
    np.testing.assert_allclose(found, np.exp(x.astype(np.float64)), rtol=2e-7)
    x = np.linspace(-11.8, 11.8, 501).astype(np.float32)
    found = np.array([probability(each) for each in x])
    exact = [math.erfc(-float(each) / math.sqrt(2)) / 2 for each in x]
    np.testing.assert_allclose(found, exact, rtol=2e-5)
    assert 0 <= probability(np.float32(-np.inf)) < 1e-37
    assert probability(np.float32(np.inf)) == 1
