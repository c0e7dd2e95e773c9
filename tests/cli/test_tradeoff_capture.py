"""`camctl tradeoff capture`: rows, table, plot, and what cannot be done."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import Run

ROW = ("tradeoff", "capture", "--size", "64x48", "--repeats", "1", "--workers", "1")


def test_rows_can_be_run_again(run: Run, tmp_path: Path) -> None:
    rows = run(*ROW, "--methods", "doubling,equal", "-n", "1,2", "--json").json
    names = {"n", "method", "exposures", "shutter_s", "time_s", "pareto", "spread", "seeds"}
    names |= {"effective_levels_predicted", "effective_levels_measured"}
    assert all(names <= set(row) for row in rows)
    assert [(row["method"], row["n"]) for row in rows] == [
        ("doubling", 1), ("doubling", 2), ("equal", 1), ("equal", 2),
    ]  # fmt: skip
    file = tmp_path / "rows.json"
    file.write_text(json.dumps(rows))
    assert run("tradeoff", "capture", "--again", str(file), "--workers", "1", "--json").json == rows


def test_a_camera_with_unknown_properties_is_one_with_a_profile(run: Run) -> None:
    row = (*ROW, "-O", "unknown=yes", "--methods", "xi", "-n", "2", "--json")
    (found,) = run(*row).json
    assert not found["noise_known"]
    assert found["options"] == [["unknown", "yes"]]


def test_the_table_and_the_plot(run: Run, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    plot = tmp_path / "plot.svg"
    ran = run(*ROW, "--methods", "xi,doubling", "-n", "1,2,3", "--plot", str(plot))
    assert ran.status == 0
    assert "within 0.5 %" not in ran.out
    assert "the third exposure costs" in ran.out
    assert "by decade of E" in ran.out
    assert "knee of the front" in ran.out
    assert ">doubling<" in plot.read_text()
    assert run(*ROW, "--plot", str(plot)).error == (
        f"{plot} exists; choose another file, or have it replaced (--force)"
    )


def test_the_table_says_which_methods_prefer_the_shorter_set(run: Run) -> None:
    ran = run(*ROW, "--methods", "accuracy", "-n", "1,2")
    assert "the fastest set among those within 0.5 % of the best accuracy predicted" in ran.out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("-n", "17"), "from 1 to 16"),
        (("--methods", "paper", "-n", "1"), "the paper's table has linear"),
        (("-O", "time=real"), "the simulated camera of a study has no option 'time'"),
        (("-O", "unknown=yes", "--methods", "accuracy"), "noise"),
        (("--methods", "best"), "unknown method 'best'"),
        (("--gamma", "2", "--response", "linear"), "--gamma cannot be combined"),
        (("--base", "3600"), "beyond the camera"),
        (("-n", "16", "--methods", "doubling", "--base", "1/30"), "beyond the camera"),
    ],
)
def test_impossible_studies_are_one_line(
    run: Run, arguments: tuple[str, ...], message: str
) -> None:
    ran = run(*ROW, *arguments)
    assert ran.status in (1, 2)
    assert message in ran.error
