"""Write the help pages of all commands as man pages.

    python docs/write_man_pages.py DIR

Writes camctl.1, camctl-shoot.1, camctl-calibrate-noise.1 and so on into DIR; MANPATH or
``man -l DIR/camctl.1`` shows them.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

import click

import camctl
from camctl.cli import cli
from camctl.cli.commands import Command


def pages(command: click.Command, context: click.Context) -> Iterator[tuple[str, str]]:
    """Yield name and text of the man page of a command, and of all commands below it."""
    name = context.command_path.replace(" ", "-")
    below: list[tuple[str, click.Command]] = []
    if isinstance(command, click.Group):
        for each in command.list_commands(context):
            found = command.get_command(context, each)
            assert found is not None
            below.append((each, found))
    yield name, page(command, context, below)
    for each, found in below:
        yield from pages(found, click.Context(found, info_name=each, parent=context))


def page(
    command: click.Command, context: click.Context, below: list[tuple[str, click.Command]]
) -> str:
    """Return the man page of one command in the macros of man(7)."""
    name = context.command_path.replace(" ", "-")
    usage = " ".join(command.collect_usage_pieces(context))
    first, _, rest = (command.help or "").partition("\n\n")
    lines = [
        f'.TH {_escaped(name.upper())} 1 "" "camctl {camctl.__version__}" "camctl manual"',
        ".ad l",
        ".SH NAME",
        f"{_escaped(name)} \\- {_text(first).rstrip('.')}",
        ".SH SYNOPSIS",
        f".B {_escaped(context.command_path)}",
        _text(usage),
    ]
    if rest:
        lines += [".SH DESCRIPTION", *_paragraphs(rest)]
    if below:
        lines.append(".SH COMMANDS")
        for each, found in below:
            lines += [".TP", f".B {_escaped(each)}", _text(found.get_short_help_str(500))]
    records = [
        record
        for each in command.get_params(context)
        if isinstance(each, click.Option) and (record := each.get_help_record(context))
    ]
    if records:
        lines.append(".SH OPTIONS")
        for names, meaning in records:
            lines += [".TP", f".B {_escaped(names)}", _text(meaning)]
    if isinstance(command, Command) and command.examples:
        lines.append(".SH EXAMPLES")
        for line, explanation in command.examples:
            lines += [".TP", f".B {_escaped(line)}", _text(explanation)]
    if below:
        lines += [
            ".SH SEE ALSO",
            ", ".join(f"{_escaped(f'{name}-{each}')}(1)" for each, _ in below),
        ]
    return "\n".join([*lines, ""])


def _paragraphs(text: str) -> Iterator[str]:
    for place, part in enumerate(re.split(r"\n\s*\n", text)):
        if place:
            yield ".PP"
        yield _text(part)


def _text(text: str) -> str:
    """Return a text as one line of roff, which is no request."""
    line = _escaped(" ".join(text.split()))
    return f"\\&{line}" if line.startswith((".", "'")) else line


def _escaped(text: str) -> str:
    return text.replace("\\", "\\e").replace("-", "\\-").replace("'", "\\(aq").replace("`", "\\(ga")


def main(folder: Path) -> None:
    """Write all pages."""
    folder.mkdir(parents=True, exist_ok=True)
    context = click.Context(cli, info_name="camctl", **cli.context_settings)
    for name, text in pages(cli, context):
        (folder / f"{name}.1").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
