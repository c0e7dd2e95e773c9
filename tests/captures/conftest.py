"""Fixtures of the tests of captures."""

from __future__ import annotations

from pathlib import Path

import pytest
from series_bench import Bench


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    """Return a series of fake sets in a folder that is not made yet."""
    return Bench(tmp_path / "series")
