"""Write the reference pages of findings, report and options from the code that defines them.

    python docs/write_reference.py

Writes docs/reference/findings.md from `camctl.findings.CODES` and the sentences of
`camctl.messages`, report.md from the models of `camctl.records`, and options.md from the commands.
"""

from __future__ import annotations

import dataclasses
import inspect
import re
import sys
import typing
from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from typing import Any

import click
from pydantic import BaseModel

from camctl.cli import cli
from camctl.exposure.goal import CaptureRequest
from camctl.findings import CODES, Finding
from camctl.messages.command_line import OPTIONS as FIELD_OPTIONS
from camctl.messages.command_line import with_remedies
from camctl.messages.plain import sentence
from camctl.photographs.photograph_set import PhotographOptions
from camctl.records.report import CaptureReport
from camctl.records.report_json import FOLLOWS

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

from finding_examples import EXAMPLES

FOLDER = Path(__file__).parent / "reference"
FINDINGS = """\
# Findings

What camctl measured and a reader must know, as data: `findings` in `report.json` and in the
output of `--json`, and `findings` of a `camctl.CaptureReport`. Each finding has these fields:

| field | meaning |
|---|---|
| `code` | one of the table below; the codes are stable |
| `frames` | positions of the frames it is about, 0 first; empty: all frames |
| `value` | what was measured, see the table |
| `low`, `high` | its 95 % confidence interval, if it has one |
| `place` | pixels of a rectangle: `top`, `left`, `bottom`, `right`; null: the whole picture |
| `details` | what else its sentence names |
| `remedies` | what helps: fields of the request, with a value, null (another one) or false (none) |

`warnings` has each finding as a plain sentence. The command line adds the options that help.

| code | `value` | sentence, an example | options that help |
|---|---|---|---|"""
SHORTER = """
## What JSON leaves out

`report.json` and `--json` leave out what is null or has its default, except for `format_version`,
`status`, `trustworthy`, `findings`, `warnings`, `plan.objective` and `noise`, and what follows
from other fields:

| field | in JSON |
|---|---|"""
REPORT = """\
# Fields of the report

`report.json` in [the folder of a capture](folder.md), the output of `camctl shoot --json` and
`camctl.CaptureReport` have these fields. A capture that lacks frames or pictures has the status
"incomplete", and no `achieved`, `irradiance` and `movement`.

| field | type | meaning |
|---|---|---|"""
OPTIONS = """\
# Options

The options of the commands that make pictures, with the field of `camctl.CaptureRequest` (of
`camctl.PhotographOptions` for `merge`) that has the same meaning in Python.
`camctl COMMAND --help` has the options of every command.

| option | field | commands | meaning |
|---|---|---|---|"""
PICTURE_COMMANDS = ("shoot", "series", "preview", "resume", "merge")


def findings_page() -> str:
    """Return the page of the codes, with an example of each sentence."""
    lines = [FINDINGS]
    for code, value in CODES.items():
        finding = EXAMPLES.get(code)
        if finding is None:
            lines.append(f"| `{code}` | {value} | - | |")
            continue
        remedies = with_remedies("", finding.remedies).strip("() ")
        cells = (
            f"`{code}`",
            value,
            sentence(finding),
            f"`{remedies}`" if remedies else "",
        )
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join([*lines, "", "`python docs/write_reference.py` writes this page.", ""])


def report_page() -> str:
    """Return the page of the fields of a report."""
    lines = [REPORT]
    described: dict[type, str] = {Finding: "[finding](findings.md)"}
    for path, kind, meaning in _fields(CaptureReport, "", described):
        lines.append(f"| `{path}` | {kind} | {_json_words(meaning)} |")
    lines += [SHORTER, *(f"| `{path}` | {where} |" for path, where in FOLLOWS.items())]
    return "\n".join([*lines, "", "`python docs/write_reference.py` writes this page.", ""])


def options_page() -> str:
    """Return the page of the options of the commands that make pictures."""
    known = _annotations(CaptureRequest) | _annotations(PhotographOptions)
    fields = {option: field for field, option in FIELD_OPTIONS.items() if field in known}
    found: dict[tuple[str, str], list[str]] = {}
    context = click.Context(cli, info_name="camctl")
    for name in PICTURE_COMMANDS:
        command = cli.get_command(context, name)
        assert command is not None
        for each in command.params:
            if isinstance(each, click.Option) and not each.hidden:
                option = ", ".join(f"`{opt}`" for opt in each.opts)
                if not each.is_flag:
                    option += f" {_cell(each.make_metavar(context))}"
                found.setdefault((option, _cell(each.help or "")), []).append(name)
    lines = [OPTIONS]
    for (option, meaning), commands in found.items():
        own = re.findall(r"`(.*?)`", option)
        field = ", ".join(f"`{name}`" for opt, name in fields.items() if opt.split()[0] in own)
        lines.append(f"| {option} | {field} | {', '.join(commands)} | {meaning} |")
    return "\n".join([*lines, "", "`python docs/write_reference.py` writes this page.", ""])


def _cell(text: str) -> str:
    """Return a text of a help page as a cell of a table."""
    return " ".join(text.replace("|", "\\|").split())


def _fields(model: type, prefix: str, described: dict[type, str]) -> Iterator[tuple[str, str, str]]:
    """Yield path, type and meaning of each field of a model, and the fields of models in it once.

    Args:
        model: a pydantic model or a dataclass
        prefix: its path, with a dot
        described: where the fields of each model stand that have been yielded
    """
    meanings = _meanings(model)
    for name, annotation in _annotations(model).items():
        path = f"{prefix}{name}"
        parts = _models(annotation)
        kind = _kind(annotation)
        for part in parts:
            if part in described:
                kind = kind.replace("object", described[part], 1)
        yield path, kind, meanings.get(name, "")
        for part in parts:
            if part not in described:
                described[part] = f"object as `{path}`"
                yield from _fields(part, f"{path}{_below(annotation)}.", described)


def _below(annotation: Any) -> str:
    """Return what stands between the path of a field and the fields of the models in it."""
    if typing.get_origin(annotation) in (list, tuple):
        return "[]"
    if typing.get_origin(annotation) is dict:
        return ".NAME"
    return "".join(map(_below, typing.get_args(annotation)))


def _json_words(text: str) -> str:
    """Return a meaning with Python's constants as JSON has them, and without its markup."""
    for name, value in (("None", "null"), ("True", "true"), ("False", "false")):
        text = re.sub(rf"\b{name}\b", value, text)
    return text.replace("``", "`").strip() or "-"


def _annotations(model: type) -> dict[str, Any]:
    """Return the type of each field of a pydantic model or a dataclass."""
    hints = typing.get_type_hints(model)
    if issubclass(model, BaseModel):
        computed = {
            name: typing.get_type_hints(field.wrapped_property.fget)["return"]
            for name, field in model.model_computed_fields.items()
        }
        return {name: hints[name] for name in model.model_fields} | computed
    # What is not shown of a value is not part of a report.
    return {field.name: hints[field.name] for field in dataclasses.fields(model) if field.repr}


def _meanings(model: type) -> dict[str, str]:
    """Return the meaning of each field, from the section Attributes of the docstrings."""
    found: dict[str, str] = {}
    for each in reversed(model.__mro__):
        text = inspect.cleandoc(each.__doc__ or "")
        section = re.search(r"^(?:Attributes|Args):\n((?:    .*\n?|\n)*)", text, re.MULTILINE)
        for entry in re.split(r"\n(?=    \S)", section[1].rstrip() if section else ""):
            names, _, meaning = entry.strip().partition(": ")
            for name in names.split(", "):
                found[name] = " ".join(meaning.split()).replace("|", "\\|")
    if issubclass(model, BaseModel):
        for name, field in model.model_computed_fields.items():
            found.setdefault(name, inspect.cleandoc(field.description or "").split("\n")[0])
    return found


def _kind(annotation: Any) -> str:
    """Return the type of a field in words."""
    origin, parts = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Annotated:
        return _kind(parts[0])
    if origin is typing.Literal:
        return ", ".join(f'"{part}"' for part in parts)
    if annotation is type(None):
        return "null"
    if origin in (list, tuple):
        inner = dict.fromkeys(_kind(part) for part in parts if part is not Ellipsis)
        return f"list of {' or '.join(inner)}"
    if origin is dict:
        return f"object of {_kind(parts[1])}"
    if parts:
        return " or ".join(dict.fromkeys(map(_kind, parts)))
    if isinstance(annotation, type) and issubclass(annotation, Enum):
        return ", ".join(f'"{each.value}"' for each in annotation)
    names = {str: "text", int: "integer", float: "number", bool: "true or false", Any: "any"}
    return names.get(annotation, "object" if _models(annotation) else "text")


def _models(annotation: Any) -> list[type]:
    """Return the models in a type."""
    if isinstance(annotation, type) and (
        dataclasses.is_dataclass(annotation) or issubclass(annotation, BaseModel)
    ):
        return [annotation]
    return [model for part in typing.get_args(annotation) for model in _models(part)]


def main() -> None:
    """Write the pages."""
    for name, page in (
        ("findings", findings_page()),
        ("report", report_page()),
        ("options", options_page()),
    ):
        (FOLDER / f"{name}.md").write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
