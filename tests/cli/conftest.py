"""The fixtures that run a command line, and write photographs for one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from bracketed_photographs import TIMES, Series, write_series
from command_line import Ran, Run

from camctl.cli import main


@pytest.fixture
def run(capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Run a command line in an empty folder, with no profiles."""
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path / "profiles"))

    def run_arguments(*arguments: str | Path) -> Ran:
        capfd.readouterr()
        words = tuple(str(argument) for argument in arguments)
        status = main(list(words))
        out, err = capfd.readouterr()
        return Ran(status, out, err, words)

    return run_arguments


@pytest.fixture
def series(run: Run) -> Series:
    """Return a function that writes photographs, and returns arguments that name them."""

    def write(
        times: Sequence[float] = TIMES,
        suffix: str = ".png",
        labels: Sequence[float] | None = None,
        **more: Any,
    ) -> list[str]:
        names = write_series(times, suffix, **more)
        return [*names, "--times", ",".join(f"{each:.9g}" for each in labels or times)]

    assert run is not None  # it has changed to an empty folder
    return write
