"""Fixtures of the drivers' tests."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture
def own_profiles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder of camera profiles for this test alone."""
    folder = tmp_path / "profiles"
    monkeypatch.setenv("CAMCTL_PROFILES", str(folder))
    return folder
