"""No sentence of the library names an option or a command: only front ends do."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from camctl.cli import cli

ROOT = Path(__file__).parents[2]
FRONT_ENDS = ("camctl/cli", "camctl/messages")
#: The last three are links in a clone, which a search below camctl does not follow.
PACKAGES = ("camctl", "camctl/drivers", "camctl/menu", "camctl/sim")
#: Programs of their own, with options that are not camctl's.
PROGRAMS = ("camctl/sim/devices/hub.py",)
#: Between two literals that Python joins.
_BETWEEN_PARTS = re.compile(r"""["']\s*\n\s*f?["']""")


def commands(group: click.Group, context: click.Context) -> Iterator[tuple[str, click.Command]]:
    """Yield every command with its name."""
    for name in group.list_commands(context):
        found = group.get_command(context, name)
        assert found is not None
        yield name, found
        if isinstance(found, click.Group):
            yield from commands(found, context)


@pytest.fixture(scope="module")
def named() -> re.Pattern[str]:
    """A pattern of all options and commands of the command line."""
    found = list(commands(cli, click.Context(cli)))
    options = {
        option
        for _, each in found
        for parameter in each.params
        if isinstance(parameter, click.Option)
        for option in (*parameter.opts, *parameter.secondary_opts)
    }
    longest = sorted(options, key=len, reverse=True)
    names = "|".join(cli.list_commands(click.Context(cli)))
    words = "|".join(map(re.escape, longest))
    return re.compile(rf"(?<![\w-])(?<!ulimit )(?:{words})(?![\w-])|\bcamctl (?:{names})\b")


def sentences(tree: ast.AST) -> Iterator[ast.Constant]:
    """Yield the constants of a module that are no docstrings."""
    documentation = {
        id(node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and id(node) not in documentation:
            yield node


def test_only_front_ends_name_options(named: re.Pattern[str]) -> None:
    files = [file for package in PACKAGES for file in sorted((ROOT / package).rglob("*.py"))]
    assert len(files) > 300
    found = []
    for file in files:
        name = file.relative_to(ROOT).as_posix()
        if name.startswith(FRONT_ENDS) or name in PROGRAMS:
            continue
        text = file.read_text(encoding="utf-8")
        if not named.search(_BETWEEN_PARTS.sub("", text)):  # parsing takes long
            continue
        found += [
            f"{name}:{node.lineno}: {str(node.value)[:80]!r}"
            for node in sentences(ast.parse(text))
            if named.search(str(node.value))
        ]
    assert not found, "\n".join(found)


def test_the_pattern_finds_what_it_looks_for(named: re.Pattern[str]) -> None:
    for text in ("give it with --base SECONDS", "(-n 4)", "-O format=raw", "run camctl calibrate"):
        assert named.search(text), text
    for text in ("var(--line)", "camctl 0.2.0", "ulimit -n", "a non-linear-n curve", "--"):
        assert not named.search(text), text
