"""Pictures by numpy: compiling for them takes longer than all of these tests, in each process."""

from __future__ import annotations

import pytest

from camctl.pictures import chroma_light


@pytest.fixture(autouse=True)
def by_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    """Load nothing compiled but where a test says so: slow tests hold both ways equal."""
    monkeypatch.setattr(chroma_light, "_WORTH_LOADING", 1 << 60)
