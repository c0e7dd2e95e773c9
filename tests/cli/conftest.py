"""The fixture that runs a command line."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_line import Ran, Run

from camctl.cli import main


@pytest.fixture
def run(capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Run a command line in an empty folder, with an empty cache and no profiles."""
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    monkeypatch.setenv("CAMCTL_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path / "profiles"))

    def run_arguments(*arguments: str | Path) -> Ran:
        capfd.readouterr()
        status = main([str(argument) for argument in arguments])
        out, err = capfd.readouterr()
        return Ran(status, out, err)

    return run_arguments
