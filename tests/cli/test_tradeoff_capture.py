"""`camctl tradeoff capture`: rows, table, plot, and what cannot be done."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from command_line import Run

ROW = ("tradeoff", "capture", "--size", "64x48", "--repeats", "1", "--workers", "1")


@pytest.mark.slow
def test_rows_can_be_run_again(run: Run, tmp_path: Path) -> None:
    found = run(*ROW, "--methods", "doubling,equal", "-n", "1,2", "--json").json
    rows = found["rows"]
    names = {"n", "method", "exposures", "shutter_s", "time_s", "spread", "seeds", "slower_by"}
    names |= {"effective_levels_predicted", "effective_levels_measured", "less_accurate_by"}
    assert all(names <= set(row) for row in rows)
    assert [(row["method"], row["n"]) for row in rows if row["method"] != "front"] == [
        ("doubling", 1), ("doubling", 2), ("equal", 1), ("equal", 2),
    ]  # fmt: skip
    front = [row for row in rows if row["method"] == "front"]
    assert sum(row["is_recommended"] for row in front) == 1
    assert max(row["n"] for row in front) > 6
    assert all(row["slower_by"] >= 0.998 for row in rows)
    file = tmp_path / "rows.json"
    for written in (found, rows):
        file.write_text(json.dumps(written))
        assert (
            run("tradeoff", "capture", "--again", str(file), "--workers", "1", "--json").json
            == found
        )


@pytest.mark.slow
def test_a_camera_with_unknown_properties_is_one_with_a_profile(run: Run) -> None:
    row = (*ROW, "-O", "unknown=yes", "--methods", "xi", "-n", "2", "--json")
    *_, found = run(*row).json["rows"]
    assert (found["method"], found["noise_known"]) == ("xi", False)
    assert found["options"] == [["unknown", "yes"]]


@pytest.mark.slow
def test_the_table_and_the_plot(run: Run, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    plot = tmp_path / "plot.svg"
    ran = run(*ROW, "--methods", "xi,doubling", "-n", "1,2", "--plot", str(plot))
    assert ran.status == 0
    assert all(each in ran.out for each in ("slower by", "less accurate by", "by decade of E"))
    assert re.search(r"effective levels take .*\.\s*Beyond .* time pays", ran.out, re.DOTALL)
    assert ">doubling: 1, 2, 4, ...; cameras: 3, 5, 7<" in plot.read_text()
    assert run(*ROW, "--plot", str(plot)).error == (
        f"{plot} exists; choose another file, or have it replaced (--force)"
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("-n", "17"), "from 1 to 16"),
        (("-O", "time=real"), "the simulated camera of a study has no option 'time'"),
        (("--methods", "best"), "unknown method 'best'"),
        (("--gamma", "2", "--response", "linear"), "--gamma cannot be combined"),
        (("--base", "3600"), "beyond the camera"),
    ],
)
def test_impossible_studies_are_one_line(
    run: Run, arguments: tuple[str, ...], message: str
) -> None:
    ran = run(*ROW, *arguments)
    assert ran.status in (1, 2)
    assert message in ran.error
