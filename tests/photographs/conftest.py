"""Photographs in an empty folder, without profiles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest

from camctl import PhotographOptions
from camctl.photographs.photograph_set import OpenedPhotographs, open_photographs

Opened = Callable[..., OpenedPhotographs]
"""Writes the series of `bracketed_photographs.write_series`, and opens it."""


@pytest.fixture
def opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Opened:
    """Return a function that writes photographs, and opens them with options."""
    pytest.importorskip("cv2", reason="OpenCV is blocked")
    from bracketed_photographs import write_series

    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path / "profiles"))

    def open_series(
        times: tuple[float, ...],
        *,
        labels: Sequence[float | Fraction] | None = None,
        curve: str | None = "srgb",
        options: dict[str, Any] | None = None,
        **series: Any,
    ) -> OpenedPhotographs:
        files = list(map(Path, write_series(times, **series)))
        given = tuple(labels or times)
        if "labels" not in (options or {}):  # fractions are corrected from the pixels
            given = tuple(Fraction(each) for each in given)
        known = PhotographOptions(times=given, curve=curve, **(options or {}))
        return open_photographs(files, known)

    return open_series
