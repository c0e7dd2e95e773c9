"""solve, evaluate, table show and table build."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from camctl.cli import options
from camctl.cli import response_options as realcamera
from camctl.cli.output import share_of_time
from camctl.cli.table import InterruptedBuildError
from camctl.exposure.noise import NOISE_KINDS
from camctl.exposure.table import default_table
from camctl.response.camera import STANDARDS
from camctl.response.desired import RANGES, RESPONSES

if TYPE_CHECKING:
    from conftest import Run

CURVE = "0 0\n0.25 0.5\n1 1\n"


def test_names_on_the_command_line_are_those_of_the_mathematics() -> None:
    assert options.RESPONSES == RESPONSES
    assert options.NOISE_KINDS == NOISE_KINDS
    assert set(realcamera.STANDARDS) <= set(STANDARDS)


def test_evaluate_says_what_the_mathematics_says(run: Run) -> None:
    """The usual bracket: 254 of 765 levels coincide, 28 effective levels."""
    told = run("evaluate", "--ratios", "1,2,4", "--json").json
    assert told["levels"] == 765
    assert told["levels_distinct"] == 511
    assert told["effective_levels"] == pytest.approx(28, abs=0.5)
    assert told["total_exposure"] == 7
    assert told["levels_wanted"] == 765
    assert 0 < told["xi"] < 765


def test_evaluate_as_text(run: Run) -> None:
    ran = run("evaluate", "--ratios", "4,1,2")
    assert "exposures              1  2  4\n" in ran.out
    assert "511 different, 254 lost because levels coincide" in ran.out
    assert "shutter open           7 x the shortest exposure" in ran.out
    assert ran.err == ""


def test_ratios_need_no_order_and_no_unit(run: Run) -> None:
    one = run("evaluate", "--ratios", "1,2.5,7", "--json").json
    other = run("evaluate", "--ratios", "14, 2, 5", "--json").json
    assert other == one


def test_ranges_by_name_number_and_ratio_are_the_same(run: Run) -> None:
    told = [
        run("evaluate", "--ratios", "1,3", "--range", word, "--json").json["xi"]
        for word in ("high", "HIGH", "16000", "1:16,000", "1.6e4")
    ]
    assert len(set(told)) == 1
    for name, value in RANGES.items():
        got = run("evaluate", "--ratios", "1,3", "--range", name, "--json").json
        assert got["dynamic_range"] == value


def test_other_objectives_are_told_as_such(run: Run) -> None:
    plain = run("evaluate", "--ratios", "1,9.9", "--json").json["xi"]
    for words in (["--p", "2"], ["--jitter", "0.01"], ["--noise", "0.5"]):
        assert run("evaluate", "--ratios", "1,9.9", "--json", *words).json["xi"] != plain
        assert "wanted levels missing" not in run("evaluate", "--ratios", "1,9.9", *words).out


def solved(run: Run, *words: str | Path) -> Any:
    return run("solve", *words, "--json").json


def test_solve_gives_all_that_scripts_rely_on(run: Run) -> None:
    told = solved(run, "--response", "linear", "--range", "512", "-n", "2")
    assert told["exposures"][0] == 1
    assert len(told["exposures"]) == 2
    assert told["xi"] == pytest.approx(105.13, rel=0.03)
    assert told["levels_wanted"] == 510
    assert told["effective_levels"] > 0
    assert told["total_exposure"] == pytest.approx(sum(told["exposures"]))
    assert told["seconds"] > 0
    assert told["evaluations"] > 0


def test_solve_agrees_with_evaluate(run: Run) -> None:
    words = ("--response", "gamma", "--range", "300", "--bits", "6", "--phase", "0.5")
    found = solved(run, *words, "-n", "2")
    ratios = ",".join(map(repr, found["exposures"]))
    judged = run("evaluate", *words, "--ratios", ratios, "--json").json
    for key in ("xi", "effective_levels", "levels_wanted", "camera"):
        assert judged[key] == found[key]


def test_solve_is_repeatable(run: Run) -> None:
    first, second = (solved(run, "-n", "2", "--bits", "5", "--seed", "3") for _ in range(2))
    assert first["exposures"] == second["exposures"]


def test_solve_as_text(run: Run) -> None:
    ran = run("solve", "-n", "2", "--bits", "4")
    for words in ("log, 1:1,000, in 2 exposures", "linear 4 bit", "of 30 (xi)", "seed 0"):
        assert words in ran.out
    assert ran.err == ""


def test_fewest_exposures_for_a_tolerance(run: Run) -> None:
    told = solved(run, "--bits", "6", "--levels", "60", "--tolerance", "5")
    assert told["xi"] <= 5
    fewer = solved(run, "--bits", "6", "--levels", "60", "-n", str(len(told["exposures"]) - 1))
    assert fewer["xi"] > 5


def test_total_limit_is_kept(run: Run) -> None:
    told = solved(run, "--bits", "6", "-n", "3", "--total-limit", "12")
    assert told["total_exposure"] <= 12 * (1 + 1e-9)


def test_settings_of_a_camera(run: Run) -> None:
    Path("stops").write_text("# full stops\n1/4\n1/8\n1/16  # true time\n\n1/32\n1/2\n1\n2\n")
    told = solved(run, "-n", "3", "--settings", "stops", "--bits", "6")
    assert set(told["settings_s"]) <= {1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2, 1, 2}
    assert told["xi"] >= told["without_settings"]["xi"]
    assert told["every_set_tried"] is True
    text = run("solve", "-n", "3", "--settings", "stops", "--bits", "6").out
    assert "any times at all" in text


def test_measured_curve(run: Run) -> None:
    Path("curve").write_text(CURVE)
    told = solved(run, "-n", "2", "--bits", "4", "--curve", "curve")
    assert told["camera"].startswith("curve curve 4 bit")
    assert solved(run, "-n", "2", "--bits", "4", "--curve", "srgb")["camera"] == "srgb 4 bit"


def test_repairs_of_a_curve_are_said_on_standard_error(run: Run) -> None:
    Path("curve").write_text("1 1\n0 0\n0.25 0.5\n")
    ran = run("evaluate", "--ratios", "1,2", "--curve", "curve", "--json")
    assert ran.json["levels"] == 510
    assert "camctl: warning: rows were not in order" in ran.err


@pytest.mark.parametrize(
    ("files", "words", "message", "status"),
    [
        ({}, ["solve", "--curve", "nix"], "no curve 'nix'; give a file of two columns", 1),
        (
            {"c": "1\n2\n"},
            ["solve", "--curve", "c"],
            "curve c, line 1: expected 2 columns, found 1",
            1,
        ),
        ({"c": "a b\n"}, ["solve", "--curve", "c"], "curve c, line 1: 'a b' is not two numb", 1),
        (
            {"c": "0 0\n1 nan\n"},
            ["solve", "--curve", "c"],
            "row 2 contains a number that is not finite",
            1,
        ),
        ({"c": "0 1\n1 1\n"}, ["solve", "--curve", "c"], "the brightness is constant", 1),
        ({"c": "0 1\n1 0\n"}, ["solve", "--curve", "c"], "brightness decreases with irradiance", 1),
        ({}, ["solve", "--settings", "nix"], "settings nix: No such file", 1),
        ({"s": "# none\n"}, ["solve", "--settings", "s"], "settings s: no times in it", 1),
        ({"s": "1\n-2\n"}, ["solve", "--settings", "s"], "settings s, line 2: -2 is not a time", 2),
        (
            {"s": "1\n2\n"},
            ["solve", "--settings", "s"],
            "3 different exposures cannot be chosen from 2 settings",
            2,
        ),
        (
            {"s": "1\n2\n4\n"},
            ["solve", "--settings", "s", "--total-limit", "5"],
            "the smallest sum is 7",
            2,
        ),
        ({}, ["solve", "--total-limit", "2"], "3 exposures have at least 3 times the shortest", 2),
        ({}, ["solve", "--tolerance", "5"], "--tolerance needs --levels", 2),
        (
            {},
            ["solve", "--tolerance", "5", "--levels", "9", "--p", "2"],
            "--tolerance goes without --p",
            2,
        ),
        (
            {},
            ["solve", "--tolerance", "0", "--levels", "200", "-n", "1", "--bits", "4"],
            "no set of up to 1 exposures reduces xi to 0; the best one has",
            2,
        ),
        ({"t": "{"}, ["table", "show", "--table", "t"], "exposure table t is damaged", 1),
        ({}, ["table", "show", "--table", "nix"], "exposure table nix: No such file", 1),
        ({}, ["table", "show", "--bits", "10"], "holds no row for linear 10 bit; make one", 1),
        ({}, ["table", "show", "-n", "9"], "the table holds no such row; camctl solve", 2),
        ({"t": ""}, ["table", "build", "-o", "t"], "t exists; choose another name", 1),
        ({"d": ""}, ["table", "build", "-o", "d/t", "--bits", "1", "-n", "1"], "cannot write d", 1),
        ({}, ["table", "build", "--responses", "log,lin"], "unknown response 'lin'", 2),
        ({}, ["table", "build", "--ranges", "low,1"], "--ranges: 1 is no dynamic range", 2),
        ({}, ["table", "build", "--workers", "0"], "--workers: 0 is not a whole number", 2),
    ],
)
def test_what_cannot_be_done_gets_one_line(
    run: Run, files: dict[str, str], words: list[str], message: str, status: int
) -> None:
    for name, text in files.items():
        Path(name).write_text(text)
    ran = run(*words)
    assert message in ran.error
    assert ran.status == status
    assert all(Path(name).read_text() == text for name, text in files.items())


def test_table_show_has_every_row(run: Run) -> None:
    rows = run("table", "show", "--json").json["entries"]
    assert len(rows) == len(default_table().entries)
    some = run("table", "show", "--response", "log", "--range", "high", "-n", "3", "--json").json
    assert [(row["response"], row["dynamic_range"], row["n"]) for row in some["entries"]] == [
        ("log", 16000, 3)
    ]
    text = run("table", "show", "--response", "log", "-n", "3").out
    assert text.count("\nlog ") == 3
    assert "camera: linear 8 bit" in text


SMALL = ("--bits", "3", "--responses", "log,linear", "--ranges", "100,low", "-n", "2")


def test_table_build_and_show(run: Run) -> None:
    ran = run("table", "build", *SMALL, "-o", "three.json", "--workers", "1")
    assert ran.out.startswith("8 rows for linear 3 bit in three.json")
    assert [path.name for path in Path().iterdir()] == ["three.json"]
    rows = run("table", "show", "--table", "three.json", "--bits", "3", "--json").json["entries"]
    assert len(rows) == 8
    other = run("table", "show", "--table", "three.json", "--bits", "4")
    assert "three.json holds no row for linear 4 bit" in other.error


def test_table_is_the_same_with_any_number_of_workers(run: Run) -> None:
    alone = run("table", "build", *SMALL, "-o", "a", "--workers", "1", "--json").json
    both = run("table", "build", *SMALL, "-o", "b", "--workers", "2", "--json").json
    assert both["entries"] == alone["entries"]
    assert Path("a").read_bytes() == Path("b").read_bytes()


def test_interrupted_build_goes_on(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    from camctl.exposure import build as exposure_build

    solve_job = exposure_build.solve_job
    done: list[str] = []

    def until_interrupted(job: Any, *rest: Any) -> Any:
        if len(done) == 3:
            raise KeyboardInterrupt
        done.append(job.name)
        return solve_job(job, *rest)

    monkeypatch.setattr(exposure_build, "solve_job", until_interrupted)
    words = ("table", "build", *SMALL, "-o", "t", "--workers", "1")
    ran = run(*words)
    assert ran.status == InterruptedBuildError.exit_status == 130
    assert ran.error.startswith("interrupted with 3 of 8 rows done, which are kept in t.parts; say")
    assert not Path("t").exists()

    first = list(done)
    done.clear()

    def counted(job: Any, *rest: Any) -> Any:
        done.append(job.name)
        return solve_job(job, *rest)

    monkeypatch.setattr(exposure_build, "solve_job", counted)
    assert run(*words).status == 0
    assert len(done) == 5
    assert not set(done) & set(first)
    assert [path.name for path in Path().iterdir()] == ["t"]


def test_nothing_prints_nan(run: Run) -> None:
    """Numbers that JSON has no word for become null."""
    from camctl.cli.output import plain

    assert plain({"a": [math.nan, math.inf, 1.5], "b": (True, None, 2)}) == {
        "a": [None, None, 1.5],
        "b": [True, None, 2],
    }


def test_rows_of_another_camera_are_not_counted_as_done(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    from camctl.exposure import build as exposure_build

    def interrupted(job: Any, *rest: Any) -> Any:
        raise KeyboardInterrupt

    Path("t.parts").mkdir()
    Path("t.parts", "0123456789abcdef-0123456789abcdef.json").write_text("{}")
    monkeypatch.setattr(exposure_build, "solve_job", interrupted)
    ran = run("table", "build", *SMALL, "-o", "t", "--workers", "1")
    assert ran.error == "interrupted with 0 of 8 rows done"


def test_progress_of_a_table_goes_by_time() -> None:
    """The longest rows come first: of 3 each, n = 3 and then n = 2; n = 1 is free."""
    shares = [share_of_time(done, 3, 3) for done in range(10)]
    assert shares[0] == 0
    assert shares[3] == pytest.approx(3 * 25_000 / (3 * 25_000 + 2 * 10_000))
    assert shares[6:] == pytest.approx([1, 1, 1, 1])
    assert [share_of_time(done, 2, 1) for done in range(3)] == [0, 0.5, 1]


def test_any_gamma(run: Run) -> None:
    words = ("evaluate", "--ratios", "1,3", "--bits", "5", "--no-sensitivity", "--json")
    usual = run(*words, "--response", "gamma").json
    assert run(*words, "--response", "gamma", "--gamma", "0.5").json == usual
    darker = run(*words, "--response", "gamma", "--gamma", "0.3").json
    assert darker["response"] == "gamma 0.3"
    assert darker["xi"] != usual["xi"]
    linear = run(*words, "--response", "linear").json
    assert run(*words, "--response", "gamma", "--gamma", "1").json == linear
    found = run("solve", "--response", "gamma", "--gamma", "0.3", "-n", "2", "--bits", "4").out
    assert "gamma 0.3, 1:1,000, in 2 exposures" in found


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--gamma", "0.3"], "--gamma goes without --response log; say --response gamma"),
        (["--response", "gamma", "--gamma", "0"], "--gamma: 0 is not an exponent from 0.01"),
        (["--response", "gamma", "--gamma", "101"], "invalid gamma 101: expected 0.01 to 100"),
        (
            ["--response", "gamma", "--gamma", "2", "--certificate"],
            "no lower bound is known for the desired response gamma 2",
        ),
    ],
)
def test_a_gamma_that_cannot_be(run: Run, words: list[str], message: str) -> None:
    ran = run("solve", *words)
    assert message in ran.error
    assert ran.status == 2
