"""Each module can be imported, and the examples in docstrings give what they say."""

from __future__ import annotations

import doctest
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest

import camctl

LARGE = {"camctl.adapters.bluesky"}
"""Modules that import large libraries, and that only their own tests import."""


def modules() -> Iterator[tuple[str, Path]]:
    """Yield the names of the modules, and their files; folders in camctl may be links."""
    root = Path(camctl.__file__).parent
    for top in (root, *(each for each in root.iterdir() if each.is_symlink())):
        for path in sorted(top.rglob("*.py")):
            parts = (root.name, *path.relative_to(root).with_suffix("").parts)
            if parts[-1] != "__main__":
                yield ".".join(parts[:-1] if parts[-1] == "__init__" else parts), path


def test_every_module_can_be_imported() -> None:
    names = {name for name, _ in modules()}
    assert {"camctl.errors", "camctl.sim", "camctl.drivers.ptp.backend"} <= names
    assert names >= LARGE
    for name in names - LARGE:
        import_module(name)


@pytest.mark.parametrize("name", [name for name, path in modules() if ">>>" in path.read_text()])
def test_examples_in_docstrings_give_what_they_say(name: str) -> None:
    found = doctest.testmod(import_module(name))
    assert found.attempted
    assert not found.failed
