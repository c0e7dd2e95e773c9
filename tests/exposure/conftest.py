"""What tests of searches have in common."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest

from camctl.exposure.candidates import BatchScore
from camctl.exposure.objective import ExposureProblem
from camctl.model.response.camera import FloatArray


@pytest.fixture
def spent(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Return the times that scores are stated to take, s.

    The scores are numbers that depend on the set, so that a test takes no time for them.
    """
    spent: list[float] = []

    def score_sets(batch: BatchScore, exposures: FloatArray) -> FloatArray:
        batch.evaluations += len(exposures)
        spent.append(batch.seconds * len(exposures))
        return np.asarray(np.abs(np.sin(1e6 * exposures.sum(axis=1)))) + 1

    def score(problem: ExposureProblem, exposures: Sequence[float]) -> float:
        spent.append(problem.seconds)
        return abs(math.sin(1e6 * sum(exposures))) + 1

    monkeypatch.setattr(BatchScore, "__call__", score_sets)
    monkeypatch.setattr(ExposureProblem, "score", score)
    return spent
