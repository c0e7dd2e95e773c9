"""`camctl solve` and `camctl evaluate`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from command_line import Run

from camctl.cli import real_camera, search_options
from camctl.cli.output import to_json
from camctl.exposure.noise import NOISE_KINDS
from camctl.model.response.camera import STANDARDS
from camctl.model.response.names import RANGES

CURVE = "0 0\n0.25 0.5\n1 1\n"


def test_names_on_the_command_line_are_those_of_the_library() -> None:
    assert search_options.NOISE_KINDS == NOISE_KINDS
    assert set(real_camera.STANDARDS) <= set(STANDARDS)


def test_evaluate_gives_known_numbers_for_the_usual_bracket(run: Run) -> None:
    """254 of 765 levels coincide, 28 effective levels."""
    output = run("evaluate", "--ratios", "1,2,4", "--json").json
    assert output["levels"] == 765
    assert output["levels_distinct"] == 511
    assert output["effective_levels"] == pytest.approx(28, abs=0.5)
    assert output["total_exposure"] == 7
    assert output["levels_wanted"] == 765
    assert 0 < output["xi"] < 765


def test_text_output_of_evaluate(run: Run) -> None:
    ran = run("evaluate", "--ratios", "4,1,2")
    assert "exposures            1  2  4\n" in ran.out
    assert "levels               511 distinct, 254 coincide with others\n" in ran.out
    assert "total exposure time  7 x the shortest exposure\n" in ran.out
    assert ran.err == ""


def test_ratios_are_sorted_and_relative(run: Run) -> None:
    one = run("evaluate", "--ratios", "1,2.5,7", "--json").json
    other = run("evaluate", "--ratios", "14, 2, 5", "--json").json
    assert other == one


def test_range_can_be_a_name_a_number_or_a_ratio(run: Run) -> None:
    values = [
        run("evaluate", "--ratios", "1,3", "--range", text, "--json").json["xi"]
        for text in ("high", "HIGH", "16000", "1:16,000", "1.6e4")
    ]
    assert len(set(values)) == 1
    for name, value in RANGES.items():
        got = run("evaluate", "--ratios", "1,3", "--range", name, "--json").json
        assert got["dynamic_range"] == value


def test_other_objectives_are_not_called_missing_levels(run: Run) -> None:
    plain = run("evaluate", "--ratios", "1,9.9", "--json").json["xi"]
    assert "missing levels (xi)" in run("evaluate", "--ratios", "1,9.9").out
    for option in (["--p", "2"], ["--jitter", "0.01"], ["--noise", "0.5"]):
        assert run("evaluate", "--ratios", "1,9.9", "--json", *option).json["xi"] != plain
        assert "missing levels (xi)" not in run("evaluate", "--ratios", "1,9.9", *option).out


def solved(run: Run, *arguments: str | Path) -> Any:
    """Return the JSON output of `camctl solve`."""
    return run("solve", *arguments, "--json").json


def test_json_output_of_solve(run: Run) -> None:
    output = solved(run, "--response", "linear", "--range", "512", "-n", "2")
    assert output["exposures"][0] == 1
    assert len(output["exposures"]) == 2
    assert output["xi"] == pytest.approx(105.13, rel=0.03)
    assert output["levels_wanted"] == 510
    assert output["effective_levels"] > 0
    assert output["total_exposure"] == pytest.approx(sum(output["exposures"]))
    assert output["seconds"] > 0
    assert output["evaluations"] > 0


def test_solve_agrees_with_evaluate(run: Run) -> None:
    arguments = ("--response", "gamma", "--range", "300", "--bits", "6", "--phase", "0.5")
    found = solved(run, *arguments, "-n", "2")
    ratios = ",".join(map(repr, found["exposures"]))
    rated = run("evaluate", *arguments, "--ratios", ratios, "--json").json
    for key in ("xi", "effective_levels", "levels_wanted", "camera"):
        assert rated[key] == found[key]


def test_solve_is_repeatable(run: Run) -> None:
    first, second = (solved(run, "-n", "2", "--bits", "5", "--seed", "3") for _ in range(2))
    assert first["exposures"] == second["exposures"]


def test_text_output_of_solve(run: Run) -> None:
    ran = run("solve", "-n", "2", "--bits", "4")
    assert "desired              log, 1:1,000, in 2 exposures\n" in ran.out
    assert "camera               linear 4 bit\n" in ran.out
    assert "missing levels (xi)  10.579 of 30\n" in ran.out
    assert " sets of exposures, seed 0\n" in ran.out
    assert ran.err == ""


def test_fewest_exposures_for_a_tolerance(run: Run) -> None:
    output = solved(run, "--bits", "6", "--levels", "60", "--tolerance", "5")
    assert output["xi"] <= 5
    fewer = solved(run, "--bits", "6", "--levels", "60", "-n", str(len(output["exposures"]) - 1))
    assert fewer["xi"] > 5


def test_total_limit_is_kept(run: Run) -> None:
    output = solved(run, "--bits", "6", "-n", "3", "--total-limit", "12")
    assert output["total_exposure"] <= 12 * (1 + 1e-9)


def test_settings_of_a_camera(run: Run) -> None:
    Path("stops").write_text("# full stops\n1/4\n1/8\n1/16  # true time\n\n1/32\n1/2\n1\n2\n")
    output = solved(run, "-n", "3", "--settings", "stops", "--bits", "6")
    assert set(output["times_s"]) <= {1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2, 1, 2}
    assert output["xi"] >= output["unrestricted"]["xi"]
    assert output["exhaustive"] is True
    text = run("solve", "-n", "3", "--settings", "stops", "--bits", "6").out
    assert "sets of exposures, all there are, seed 0" in text
    assert "with any times       1  " in text


def test_measured_curve(run: Run) -> None:
    Path("curve").write_text(CURVE)
    output = solved(run, "-n", "2", "--bits", "4", "--curve", "curve")
    assert output["camera"].startswith("curve curve 4 bit")
    assert solved(run, "-n", "2", "--bits", "4", "--curve", "srgb")["camera"] == "srgb 4 bit"


def test_repairs_of_a_curve_are_warnings(run: Run) -> None:
    Path("curve").write_text("1 1\n0 0\n0.25 0.5\n")
    ran = run("evaluate", "--ratios", "1,2", "--curve", "curve", "--json")
    assert ran.json["levels"] == 510
    assert "camctl: warning: rows were not in order" in ran.err


@pytest.mark.parametrize(
    ("files", "line", "message", "status"),
    [
        ({}, "--curve nix", "unknown curve 'nix'; give an existing file of two columns", 2),
        ({"c": "1\n2\n"}, "--curve c", "curve c, line 1: expected 2 columns, found 1", 1),
        ({}, "--settings nix", "cannot read settings file nix: No such file", 1),
        (
            {"s": "# none\n"},
            "--settings s",
            "settings file s is empty; write one value per line",
            1,
        ),
        (
            {"s": "1\n-2\n"},
            "--settings s",
            "invalid value for line 2 of settings file s: -2; expected a time in seconds",
            1,
        ),
        (
            {"s": "1\n2\n"},
            "--settings s",
            "3 different exposures cannot be chosen from 2 settings",
            2,
        ),
        ({"s": "1\n2\n4\n"}, "--settings s --total-limit 5", "the smallest sum is 7", 2),
        ({}, "--total-limit 2", "3 exposures have at least 3 times the shortest", 2),
        ({}, "--tolerance 5", "--tolerance needs --levels; give the desired number of levels", 2),
        (
            {},
            "--tolerance 5 --levels 9 --p 2",
            "--tolerance cannot be combined with --p",
            2,
        ),
        (
            {},
            "--tolerance 0 --levels 200 -n 1 --bits 4",
            "no set of up to 1 exposures reduces xi to 0; the best one has",
            2,
        ),
    ],
)
def test_impossible_solve_is_one_line(
    run: Run, files: dict[str, str], line: str, message: str, status: int
) -> None:
    for name, text in files.items():
        Path(name).write_text(text)
    ran = run("solve", *line.split())
    assert message in ran.error
    assert ran.status == status


def test_numbers_that_json_does_not_have_become_null() -> None:
    assert to_json({"a": [math.nan, math.inf, 1.5], "b": (True, None, 2)}) == {
        "a": [None, None, 1.5],
        "b": [True, None, 2],
    }


def test_any_gamma(run: Run) -> None:
    arguments = ("evaluate", "--ratios", "1,3", "--bits", "5", "--no-sensitivity", "--json")
    usual = run(*arguments, "--response", "gamma").json
    assert run(*arguments, "--response", "gamma", "--gamma", "0.5").json == usual
    assert run(*arguments, "--gamma", "0.5").json == usual
    darker = run(*arguments, "--gamma", "0.3").json
    assert darker["response"] == "gamma 0.3"
    assert darker["xi"] != usual["xi"]
    linear = run(*arguments, "--response", "linear").json
    assert run(*arguments, "--gamma", "1").json == linear
    found = run("solve", "--gamma", "0.3", "-n", "2", "--bits", "4").out
    assert "gamma 0.3, 1:1,000, in 2 exposures" in found


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (
            "--response log --gamma 0.3",
            "--gamma cannot be combined with --response log; leave one of them out",
        ),
        ("--gamma 0", "invalid value for --gamma: 0; expected an exponent from 0.01 to 100"),
        ("--gamma 2 --certificate", "no lower bound is known for the desired response gamma 2"),
    ],
)
def test_invalid_gamma_is_one_line(run: Run, line: str, message: str) -> None:
    ran = run("solve", *line.split())
    assert message in ran.error
    assert ran.status == 2
