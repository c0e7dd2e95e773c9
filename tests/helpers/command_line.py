"""What a command line of camctl leaves behind, for the fixture `run` of tests/cli."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias


@dataclass(frozen=True)
class Ran:
    """Exit status and output of a command line."""

    status: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        """Standard output, which must be one JSON value."""
        return json.loads(self.out, parse_constant=_refuse_constant)

    @property
    def error(self) -> str:
        """The error message of a command that wrote nothing else."""
        assert self.out == ""
        assert self.err.startswith("camctl: ")
        assert self.err.endswith("\n")
        assert self.err.count("\n") == 1, self.err
        return self.err.removeprefix("camctl: ").rstrip("\n")


def _refuse_constant(name: str) -> None:
    raise AssertionError(f"{name} is not JSON")


Run: TypeAlias = Callable[..., Ran]
"""Runs camctl with these arguments."""
