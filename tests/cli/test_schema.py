"""JSON schemas of what commands print: what they print now fits them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import pytest
from bracketed_photographs import Series
from command_line import Run

from camctl.cli import cli
from camctl.cli.schema.types import schema, schema_names

jsonschema = pytest.importorskip("jsonschema", reason="jsonschema is not installed")

SIZE = ("-O", "size=64x48")
SMALL_PHONE = ("--sensor", "phone", "-O", "size=160x120")
LINES: dict[str, list[tuple[str, ...]]] = {
    "shoot": [
        ("shoot", *SIZE, "--ratios", "1,4", "-o", "a"),
        ("shoot", *SIZE, "--sensor", "ideal-6", "-n", "2", "-O", "tolerance=2", "-o", "b"),
    ],
    "series": [("series", *SIZE, "--ratios", "1,2", "--repeat", "2", "-o", "c")],
    "preview": [("preview", *SIZE, "-n", "2", "-o", "p.png")],
    "cameras": [("cameras",)],
    "doctor": [("doctor",)],
    "solve": [
        ("solve", "-n", "2", "--bits", "3"),
        ("solve", "-n", "2", "--bits", "3", "--settings", "0.01,0.02,0.04", "--electrons", "40"),
        ("solve", "-n", "2", "--bits", "2", "--certificate"),
    ],
    "evaluate": [
        ("evaluate", "--ratios", "1,2", "--sensor", "standard"),
        ("evaluate", "--ratios", "1,2", "--bits", "3", "--no-sensitivity"),
    ],
    "table show": [("table", "show", "-n", "2"), ("table", "show", "-n", "1", "--sensitivity")],
    "table build": [
        ("table", "build", "--bits", "3", "-n", "1", "--ranges", "low", "--workers", "1")
    ],
    "simulate": [
        ("simulate", "--scene", "uniform", "--size", "16x12", "--explain"),
        ("simulate", "--scene", "uniform", "--size", "16x12", "--bracket", "1,2"),
    ],
    "calibrate colour": [
        (
            "calibrate",
            "colour",
            "--scene",
            "colour-chart",
            "--sensor",
            "webcam",
            "-O",
            "size=320x240",
        )
    ],
    "calibrate delay": [("calibrate", "delay", *SIZE, "--trials", "2")],
    "calibrate exposure": [("calibrate", "exposure", *SMALL_PHONE, "--repeats", "2")],
    "calibrate noise": [("calibrate", "noise", *SMALL_PHONE, "-n", "4")],
    "calibrate response": [("calibrate", "response", "--sensor", "consumer", "-O", "size=160x120")],
    "profile list": [("profile", "list")],
    "figures": [("figures", "--only", "7", "--dpi", "30", "--workers", "1")],
    "tradeoff solver": [
        (
            *("tradeoff", "solver", "-n", "2", "--bits", "4", "--range", "low", "--responses"),
            *("linear", "--methods", "camctl", "--seeds", "1", "--evaluations", "50"),
            *("--limit", "0.1", "--workers", "1"),
        )
    ],
    "tradeoff simulation": [
        (
            *("tradeoff", "simulation", "--scenes", "uniform", "--size", "16x12"),
            *("--tolerances", "0,1", "--frames", "1", "--workers", "1"),
        )
    ],
    "tradeoff capture": [
        (
            *("tradeoff", "capture", "--scene", "uniform", "--size", "16x12", "--sensor"),
            *("ideal-6", "-n", "1,2", "--methods", "doubling", "--repeats", "1", "--workers", "1"),
        )
    ],
    "error": [("solve", "-n", "0"), ("calibrate", "noise", "none.png")],
}


def check(name: str, content: Any) -> None:
    jsonschema.Draft202012Validator(schema(name)).validate(content)


@pytest.mark.parametrize("name", LINES)
def test_what_a_command_prints_fits_its_schema(run: Run, name: str) -> None:
    if name == "solve":
        line = LINES[name][0]
        wrong = {**run(*line, "--json").json, "xi": "many"}
        with pytest.raises(jsonschema.ValidationError):
            check(name, wrong)
    for line in LINES[name]:
        ran = run(*line, "--json")
        assert ran.status == 0 or name in ("error", "doctor"), ran.err
        check(name, ran.json)
        assert ran.json["format_version"] >= 1


def test_profiles_fit_their_schemas(run: Run) -> None:
    run("calibrate", "delay", *SIZE, "--trials", "2")
    listed = run("profile", "list", "--json").json
    check("profile list", listed)
    name = listed["profiles"][0]["name"]
    check("profile show", run("profile", "show", name, "--json").json)
    run("profile", "export", name, "-o", "camera.json")
    check("profile remove", run("profile", "remove", name, "--json").json)
    check("profile import", run("profile", "import", "camera.json", "--json").json)


def test_a_report_and_a_merge_fit_their_schemas(run: Run, series: Series) -> None:
    ran = run("merge", *series(), "--curve", "power:2.222", "-o", "out", "--json")
    assert ran.status in (0, 3), ran.err
    check("merge", ran.json)
    check("shoot", json.loads(Path("out/report.json").read_text()))


def test_what_is_resumed_fits_one_of_two(run: Run) -> None:
    check("resume", run("shoot", *SIZE, "--ratios", "1,4", "-o", "a", "--json").json)
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
    for name in names:
        shown = run("schema", *name.split()).json
        assert shown == schema(name)
        assert shown["title"] == f"camctl {name} --json"
        jsonschema.Draft202012Validator.check_schema(shown)
    assert "did you mean doctor?" in run("schema", "doctr").error
