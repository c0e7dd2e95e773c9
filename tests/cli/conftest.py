from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from camctl.cli import main


@dataclass(frozen=True)
class Ran:
    """What a command line left behind."""

    status: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        return json.loads(self.out, parse_constant=_no_such_number)

    @property
    def error(self) -> str:
        """The one line on standard error, of a command that wrote nothing else."""
        assert self.out == ""
        assert self.err.startswith("camctl: ")
        assert self.err.endswith("\n")
        assert self.err.count("\n") == 1, self.err
        return self.err.removeprefix("camctl: ").rstrip("\n")


def _no_such_number(word: str) -> None:
    raise AssertionError(f"{word} is not JSON")


Run = Callable[..., Ran]


@pytest.fixture
def run(capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Run a command line in an empty folder, with an empty cache and no profiles."""
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    monkeypatch.setenv("CAMCTL_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path / "profiles"))

    def run_words(*words: str | Path) -> Ran:
        capfd.readouterr()
        status = main([str(word) for word in words])
        out, err = capfd.readouterr()
        return Ran(status, out, err)

    return run_words
