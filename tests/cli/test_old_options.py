"""Options of earlier versions: they work, are on no help page, and say once what they are now."""

from __future__ import annotations

import json
from pathlib import Path

import click
import pytest
from command_line import Run

from camctl.cli import cli
from camctl.cli.old_options import (
    OLD_CAMERA_OPTIONS,
    OLD_COMMANDS,
    OLD_OPTIONS,
    OLD_SETTINGS,
    SILENT,
    new_command,
    new_options,
)

MOST_OPTIONS = 20
"""Options that one picture needs, without --help and --debug."""


def command(name: str) -> click.Command:
    found = cli.get_command(click.Context(cli), name)
    assert found is not None
    return found


def test_what_one_picture_needs_is_at_most_20_options() -> None:
    shown = {each.name for each in command("shoot").params} - {"help", "debug"}
    assert len(shown) <= MOST_OPTIONS


@pytest.mark.parametrize("name", ["shoot", "series", "preview", "menu"])
def test_old_options_are_on_no_help_page(run: Run, name: str) -> None:
    own = {option for each in command(name).params for option in each.opts}
    page = run(name, "--help").out
    for old in (*OLD_CAMERA_OPTIONS, *OLD_OPTIONS, *OLD_SETTINGS, *OLD_COMMANDS):
        assert old in own or f"{old} " not in page


@pytest.mark.parametrize(
    ("line", "command", "rest"),
    [
        ("--resume hall --json", "resume", "--json -- hall"),
        ("--resume=hall --camera sim", "resume", "--camera sim -- hall"),
        ("--resume day --hook up", "resume", "--hook up -- day"),
        ("--preview-only -o p.png", "preview", "-o p.png"),
        ("--repeat 3 --interval 60 -n 2", "series", "-n 2 --repeat 3 --interval 60"),
        ("--on-key --name x", "series", "--on-key --name x"),
        ("--explain -n 2", "shoot", "-n 2"),
        ("-n 2 -- --resume", "shoot", "-n 2 -- --resume"),
    ],
)
def test_old_options_of_shoot_are_commands(line: str, command: str, rest: str) -> None:
    found, words, remarks = new_command(line.split())
    assert (found, words) == (command, rest.split())
    assert len(remarks) == (command != "shoot" or "--explain" in line)


@pytest.mark.parametrize(
    ("line", "rest", "remark"),
    [
        ("--size 9x7", "-O size=9x7", "--size is now: -O size=9x7"),
        ("--seed=4", "-O seed=4", ""),
        ("--fault unplug@3", "-O faults=unplug@3", "--fault is now: -O faults=unplug@3"),
        ("--real-time", "-O time=real", "--real-time is now: -O time=real"),
        ("--no-profile", "-O profile=none", "--no-profile is now: -O profile=none"),
        ("--simulation-tolerance 1", "-O tolerance=1", "--simulation-tolerance is now: -O toler"),
        ("--desired my.txt", "--response my.txt", "--desired is now: --response my.txt"),
        ("--mains 50", "--set mains=50", "--mains is now: --set mains=50"),
        ("--aperture", "--set aperture=yes", "--aperture is now: --set aperture=yes"),
        ("--table t.json", "--set table=t.json", "--table is now: --set table=t.json"),
        ("--objective xi", "--set objective=xi", ""),
        ("--size", "--size", ""),
    ],
)
def test_old_options_are_settings(line: str, rest: str, remark: str) -> None:
    words, remarks = new_options(command("shoot"), line.split())
    assert words == rest.split()
    assert [each[: len(remark)] for each in remarks] == ([remark] if remark else [])


def test_every_old_option_is_tried_and_names_its_place() -> None:
    for name, now in {**OLD_CAMERA_OPTIONS, **OLD_OPTIONS, **OLD_SETTINGS}.items():
        words, remarks = new_options(command("shoot"), [name, *(["x"] if "{}" in now else [])])
        assert words == now.format("x").split()
        assert len(remarks) == (name not in SILENT)


def test_an_old_command_line_does_what_it_did(run: Run) -> None:
    line = ("shoot", "--scene", "uniform", "--size", "9x7", "--base", "0.01", "-n", "1")
    ran = run(*line, "--repeat", "1", "-o", "day", "--json")
    assert json.loads(ran.out)["completed"] == 1  # what a series prints
    assert ran.err == (
        "camctl: warning: --repeat is now: camctl series\n"
        "camctl: warning: --size is now: -O size=9x7\n"
    )
    assert run(*line, "--preview-only", "-o", "p.png").status == 0
    assert Path("p.png").exists()
    assert "the series in day is complete" in run("shoot", "--resume", "day").err
    assert run(*line, "--desired", "x", "--response", "log").error.startswith("--desired cannot be")
