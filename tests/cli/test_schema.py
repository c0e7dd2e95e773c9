"""JSON schemas of what commands print: what they print now fits them."""

from __future__ import annotations

from collections.abc import Iterator

import click
import pytest
from command_line import Run, check

from camctl.cli import cli
from camctl.cli.schema.types import schema, schema_names

jsonschema = pytest.importorskip("jsonschema", reason="jsonschema is not installed")

SIZE = ("-O", "size=64x48")
LINES: dict[str, list[tuple[str, ...]]] = {
    "solve": [
        ("solve", "-n", "2", "--bits", "3", "--settings", "0.01,0.02,0.04", "--electrons", "40"),
        ("solve", "-n", "2", "--bits", "2", "--certificate"),
    ],
    "evaluate": [("evaluate", "--ratios", "1,2", "--bits", "3", "--no-sensitivity")],
    "table show": [("table", "show", "-n", "1", "--sensitivity")],
    "table build": [
        ("table", "build", "--bits", "3", "-n", "1", "--ranges", "low", "--workers", "1")
    ],
    "simulate": [
        ("simulate", "--scene", "uniform", "--size", "16x12", "--explain"),
        ("simulate", "--scene", "uniform", "--size", "16x12", "--bracket", "1,2"),
    ],
    "calibrate colour": [
        (
            *("calibrate", "colour", "--scene", "colour-chart"),
            *("--sensor", "webcam", "-O", "size=320x240"),
        )
    ],
}
"""Lines beside those of other tests: each that reads `json` of a command checks its schema."""


@pytest.mark.parametrize("name", LINES)
def test_what_a_command_prints_fits_its_schema(run: Run, name: str) -> None:
    for line in LINES[name]:
        ran = run(*line, "--json")
        assert ran.status == 0, ran.err
        assert ran.json["format_version"] >= 1
    with pytest.raises(jsonschema.ValidationError):
        check(name, {**ran.json, "format_version": "many"})


def test_a_resumed_series_fits_the_schema_of_what_is_resumed(run: Run) -> None:
    taken = run("series", *SIZE, "--ratios", "1,2", "--repeat", "1", "-o", "c", "--json")
    check("resume", taken.json)


def with_json(group: click.Group, path: str = "") -> Iterator[str]:
    """Yield the commands that have --json."""
    context = click.Context(group)
    for name in group.list_commands(context):
        found = group.get_command(context, name)
        if isinstance(found, click.Group):
            yield from with_json(found, f"{path}{name} ")
        elif found is not None and any("--json" in each.opts for each in found.params):
            yield path + name


def test_every_command_with_json_has_a_schema() -> None:
    assert sorted([*with_json(cli), "error"]) == schema_names()
    assert [name for name in schema_names() if schema(name).get("type") == "array"] == []


def test_the_command_prints_them(run: Run) -> None:
    names = run("schema").out.splitlines()
    assert names == schema_names()
    assert run("schema", "table", "show").json == schema("table show")
    for name in names:
        of_name = schema(name)
        assert of_name["title"] == f"camctl {name} --json"
        jsonschema.Draft202012Validator.check_schema(of_name)
    assert "did you mean doctor?" in run("schema", "doctr").error
