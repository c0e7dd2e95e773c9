"""What a command line of camctl leaves behind, for the fixture `run` of tests/cli."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from importlib.util import find_spec
from typing import Any, TypeAlias


@dataclass(frozen=True)
class Ran:
    """Exit status and output of a command line."""

    status: int
    out: str
    err: str
    words: tuple[str, ...] = field(default=(), compare=False)

    @property
    def json(self) -> Any:
        """Standard output, which must be one JSON value, and fit the schema of the command."""
        value = json.loads(self.out, parse_constant=_refuse_constant)
        if isinstance(value, dict) and "--json" in self.words and find_spec("jsonschema"):
            check("error" if "error" in value else self._command(), value)
        return value

    def _command(self) -> str:
        from camctl.cli.schema.types import schema_names

        names = schema_names()
        return next(name for k in (2, 1) if (name := " ".join(self.words[:k])) in names)

    @property
    def error(self) -> str:
        """The error message of a command that wrote nothing else."""
        assert self.out == ""
        assert self.err.startswith("camctl: ")
        assert self.err.endswith("\n")
        assert self.err.count("\n") == 1, self.err
        return self.err.removeprefix("camctl: ").rstrip("\n")


@cache
def _validator(name: str) -> Any:
    import jsonschema

    from camctl.cli.schema.types import schema

    return jsonschema.Draft202012Validator(schema(name))


def check(name: str, content: Any) -> None:
    """Check that content fits the JSON schema of what a command prints."""
    _validator(name).validate(content)


def _refuse_constant(name: str) -> None:
    raise AssertionError(f"{name} is not JSON")


Run: TypeAlias = Callable[..., Ran]
"""Runs camctl with these arguments."""
