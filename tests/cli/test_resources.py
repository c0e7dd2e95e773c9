"""Every command at the corners of its numeric options: bounded in memory and time, or refused.

The command lines are made from the table of options, see `resource_contract`.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from random import Random

import click
import pytest
from command_bases import BASES, COMMANDS
from command_line import Run
from option_combinations import all_pairs, covering, pairs_of
from resource_contract import COSTLY, combined_values, largest, line_of, lines, rows_of

from camctl.cli import cli

PROGRAM = Path(__file__).parents[1] / "helpers" / "resource_contract.py"


def broken(*arguments: str) -> list[str]:
    """Return the command lines that break the contract, with what is wrong."""
    done = subprocess.run(
        [sys.executable, str(PROGRAM), *arguments],
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = [json.loads(line) for line in done.stdout.splitlines()]
    assert found
    return [f"{each['line']}: {each['wrong']}" for each in found if each["wrong"]]


def test_the_lines_come_from_the_options() -> None:
    made = [name for name, _ in lines()]
    assert len(made) > 500
    assert {name.split(" -")[0] for name in made} <= set(COMMANDS)
    assert set(COSTLY) <= {*made, "table show"}


@pytest.mark.parametrize("name", COSTLY)
def test_what_takes_longer_than_the_limit_says_so(name: str) -> None:
    command = name.split(" -")[0]
    # With the settings: click keeps the help option that the first context of a command makes.
    context = click.Context(COMMANDS[command], info_name=command, **cli.context_settings)
    assert COSTLY[name] in " ".join(COMMANDS[command].get_help(context).split())


@pytest.mark.parametrize("command", sorted({name.split(" -")[0] for name in COSTLY}))
def test_what_takes_longer_than_the_limit_shows_its_progress(
    command: str, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    line = [*command.split(), *BASES[command][0].split()]
    if command == "table show":
        line += ["--electrons", "40"]  # rows are solved
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    ran = run(*line)
    assert ran.status == 0, ran.err
    assert re.search(r"\d+%", ran.err)  # of a bar, which is blank at 0 % without colours


def test_rows_of_combinations_hold_each_pair_of_values() -> None:
    values = {"--a": ["1", "2", "3"], "--b": ["", "x"], "--c": ["0"], "--d": ["7", "8"]}
    rows = list(covering(values, Random(1)))
    assert {pair for row in rows for pair in pairs_of(row)} >= all_pairs(values)
    assert all(len(dict(row)) == len(row) for row in rows)  # no option twice
    assert len(rows) < len(all_pairs(values)) / 2


def test_combinations_come_from_the_options_of_the_command() -> None:
    values = combined_values("solve")
    assert {"1", "16", "64"} <= set(values["--exposures"])
    assert "0.2" in values["--jitter"]
    assert values["--certificate"] == [""]
    assert {"--exposures": "16", "--bits": "16"}.items() <= dict(largest("solve")).items()
    rows = list(rows_of("solve", "pairs", 0, 20))
    assert rows == list(rows_of("solve", "pairs", 0, 20))  # the same rows each time
    assert len(rows) == 20
    line = line_of("solve", BASES["solve"][0], (("--certificate", ""), ("--jitter", "0.2")))
    assert line == ["solve", "-n", "2", "--bits", "3", "--certificate", "--jitter=0.2"]


def test_a_very_narrow_range_is_no_memory_bomb() -> None:
    assert broken("--only", "evaluate --range", "--seconds", "10") == []


# All commands in one process: it imports camctl once, and each line is a fork of it.
@pytest.mark.slow
@pytest.mark.timeout(1500)
@pytest.mark.parametrize("every", ["16", pytest.param("1", marks=pytest.mark.proof)])
def test_every_corner_is_bounded_or_refused(every: str) -> None:
    """Each 16th line; all of them, as in docs/reference/measured.md, are a proof."""
    assert broken("--every", every) == []


def test_a_few_combinations_of_corners_are_bounded_or_refused() -> None:
    given = ("--combine", "pairs", "--most", "1", "--seconds", "10")
    assert broken("--only", "evaluate ", *given) == []


@pytest.mark.slow
@pytest.mark.timeout(1500)
@pytest.mark.parametrize(
    "how",
    [
        "pairs --pairs 4",
        *(
            pytest.param(how, marks=pytest.mark.proof)
            for how in ("pairs", "heavy --pairs 2", "heavy")
        ),
    ],
)
def test_combinations_of_corners_are_bounded_or_refused(how: str) -> None:
    """One row of each command; more of them are for the table in docs/reference/measured.md.

    Of a row that is refused its first option is run with four others, or with two where a line
    takes many seconds; all pairs are a proof.  That table has the limit of the contract, measured
    on cores of 2.5 GHz; a busy machine takes up to twice as long.
    """
    assert broken("--combine", *how.split(), "--most", "1", "--seconds", "120") == []
