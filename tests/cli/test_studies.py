"""`camctl tradeoff solver` and `camctl tradeoff simulation`, through the command line."""

from __future__ import annotations

import json
import sys
import warnings
from pathlib import Path
from typing import Any

import pytest
from command_line import Run

QUICK_SOLVER = (
    *("tradeoff", "solver", "--responses", "log", "-n", "2", "--bits", "4", "--seeds", "1"),
    *("--evaluations", "3000", "--limit", "30"),
)
QUICK_SIMULATION = (
    *("tradeoff", "simulation", "--scenes", "tile-floor,room", "--size", "48x32"),
    *("--tolerances", "0,0.5,8", "--frames", "2"),
)


def without_times(found: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the rows without what depends on the speed of the machine."""
    return [
        {k: v for k, v in row.items() if k not in ("cpu_s", "milliseconds")}
        for row in found["rows"]
    ]


@pytest.mark.slow
def test_solver_rows_hold_the_run_and_what_it_found(run: Run) -> None:
    pytest.importorskip("scipy", reason="scipy is not installed")
    rows = run(*QUICK_SOLVER, "--json", "--workers", "1").json["rows"]
    assert {row["method"] for row in rows} == {
        "camctl",
        "differential-evolution",
        "dual-annealing",
        "grid",
    }
    best = min(row["xi"] for row in rows)
    for row in rows:
        assert row["cpu_s"] > 0
        assert row["evaluations"] <= 3000 + 5000  # a grid, or a population, is scored as a whole
        assert row["regret"] == pytest.approx(row["xi"] / best - 1, abs=1e-12)
        assert len(row["exposures"]) == row["n"] == 2
    last = {row["method"]: row["regret"] for row in rows}
    assert last["camctl"] < 0.001
    assert last["differential-evolution"] < 0.001


def test_xi_of_a_row_is_that_of_its_exposures(run: Run) -> None:
    rows = run(*QUICK_SOLVER, "--json", "--workers", "1", "--methods", "camctl,grid").json["rows"]
    for row in rows[:: max(1, len(rows) // 3)]:
        ratios = ",".join(repr(exposure) for exposure in row["exposures"])
        options = ("--response", "log", "--range", "1000", "--bits", "4")
        found = run("evaluate", "--ratios", ratios, *options, "--json").json
        assert found["xi"] == pytest.approx(row["xi"], rel=1e-9)


@pytest.mark.parametrize(
    "line", [(*QUICK_SOLVER, "--methods", "camctl,grid"), QUICK_SIMULATION], ids=" ".join
)
def test_rows_can_be_run_again(run: Run, tmp_path: Path, line: tuple[str, ...]) -> None:
    first = run(*line, "--json", "--workers", "1")
    file = tmp_path / "rows.json"
    file.write_text(first.out)
    again = run(*line[:2], "--again", file, "--json", "--workers", "1")
    assert without_times(again.json) == without_times(first.json)


def test_differences_of_the_simulation_stay_within_their_bounds(run: Run) -> None:
    found = run(*QUICK_SIMULATION, "--json", "--workers", "1").json["rows"]
    rows = [row for row in found if row["method"] == "camctl"]
    assert [row["tolerance_dn"] for row in rows] == [0, 0.5, 8] * 2
    others = [row for row in found if row["tolerance_dn"] is None]
    assert [row["method"] for row in others] == ["every effect", "no optics", "noise only"] * 2
    for complete, *partial in (others[:3], others[3:]):
        assert complete["left_out"] == []
        assert complete["largest_dn"] == complete["bound_dn"] == 0
        for row in partial:  # a fixed choice promises nothing: the lens alone changes 8 levels
            assert row["left_out"]
            assert row["largest_dn"] >= 8
    for row in rows:
        assert row["bound_dn"] <= row["tolerance_dn"]
        assert row["largest_dn"] <= row["bound_dn"] + 1
        assert abs(row["shift_dn"]) <= row["mean_dn"] <= row["largest_dn"]
        assert row["milliseconds"] > 0
        assert not set(row["effects"]) & set(row["left_out"])
    for (exact, _, rough), complete in ((rows[:3], others[0]), (rows[3:], others[3])):
        assert exact["largest_dn"] == exact["mean_dn"] == 0
        assert rough["largest_dn"] >= 1
        assert set(complete["effects"]) == {*rough["effects"], *rough["left_out"]}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "on_cluster"),
    [
        # A cluster that has not started in 10 s of real time fails.
        pytest.param(QUICK_SOLVER, True, id="solver over Dask", marks=pytest.mark.serial),
        pytest.param(QUICK_SIMULATION, False, id="simulation over processes"),
    ],
)
def test_a_study_is_the_same_over_several_processes(
    line: tuple[str, ...], on_cluster: bool, run: Run, request: pytest.FixtureRequest
) -> None:
    pytest.importorskip("scipy", reason="scipy is not installed")
    if on_cluster:
        request.getfixturevalue("dask_cluster")
    alone = run(*line, "--json", "--workers", "1").json
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # raised inside the libraries of the cluster
        spread = run(*line, "--json", "--workers", "2")
    assert without_times(spread.json) == without_times(alone)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "words"),
    [
        ((*QUICK_SOLVER, "--methods", "camctl,grid"), ("log, 1:1,000, n = 2", "0.5 % after")),
        (QUICK_SIMULATION, ("tile-floor", "noise only", "camctl, 0.5 DN: a frame takes")),
    ],
    ids=["solver", "simulation"],
)
def test_text_and_plots(line: tuple[str, ...], words: tuple[str, ...], run: Run) -> None:
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    plots = ("--plot", "plot.svg", "--plot", "plot.png", "--workers", "1")
    text = run(*line, *plots)
    assert text.status == 0
    assert all(word in text.out for word in words)
    assert Path("plot.png").read_bytes().startswith(b"\x89PNG")
    assert "CPU time" in Path("plot.svg").read_text("utf-8")
    assert (
        run(*line, *plots).error
        == "plot.svg exists; choose another file, or have it replaced (--force)"
    )


def test_without_scipy_the_error_states_the_command(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "scipy.optimize", None)
    assert run(*QUICK_SOLVER).error == (
        "differential evolution and dual annealing need scipy, which is not installed; install it "
        "with: pip install 'camctl[studies]', or use other methods (--methods camctl,grid)"
    )
    assert run(*QUICK_SOLVER, "--methods", "grid", "--workers", "1").status == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("solver", "--methods", "annealing"), "unknown method 'annealing'"),
        (("solver", "-n", "1"), "invalid value for --exposures: 1; expected a whole number"),
        (("solver", "--limit", "0"), "expected a positive time in seconds"),
        (("solver", "--plot", "x.gif"), "unknown format of the plot x.gif"),
        (("solver", "--again", "none.json"), "cannot read none.json: No such file"),
        (("solver", "--again", "a.json", "--seeds", "2"), "--again cannot be combined with"),
        (("simulation", "--scenes", "nowhere"), "unknown scene 'nowhere'"),
        (("simulation", "--sensor", "film", "--workers", "1"), "unknown sensor 'film'"),
        (("simulation", "--tolerances", "-1"), "expected tolerances of at least 0 DN"),
    ],
)
def test_bad_input(arguments: tuple[str, ...], message: str, run: Run) -> None:
    assert message in run("tradeoff", *arguments).error


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("no", "rows.json is not JSON; give a file of the JSON that the same study has written"),
        ("[]", "rows.json has no rows; give a file of the JSON that the same study has written"),
        ('[{"method": "grid", "n": "x"}]', "rows.json, row 1: n: "),
        ('{"rows": {}}', "rows.json has no rows; give a file"),
        ('{"format_version": 1, "rows": [{"n": 3}]}', "rows.json, row 1: method: "),
        ('[{"method": "sorting"}]', "unknown method 'sorting'"),
    ],
)
def test_damaged_rows(content: str, message: str, run: Run) -> None:
    Path("rows.json").write_text(content)
    assert message in run("tradeoff", "solver", "--again", "rows.json").error


def test_rows_with_the_same_run_are_run_once(run: Run) -> None:
    row = {"method": "grid", "response": "linear", "n": 2, "bits": 4, "max_evaluations": 100}
    Path("rows.json").write_text(json.dumps([row, row | {"xi": 1.0}]))
    rows = run("tradeoff", "solver", "--again", "rows.json", "--json").json["rows"]
    assert len({row["evaluations"] for row in rows}) == len(rows)
