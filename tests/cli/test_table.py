"""`camctl table show` and `camctl table build`."""

from __future__ import annotations

import multiprocessing
import multiprocessing.process
import time
from pathlib import Path
from typing import Any

import pytest
from command_line import Run

from camctl.cli.table.build import InterruptedBuildError, TableContent
from camctl.exposure import build
from camctl.exposure.table import default_table
from camctl.model.response.camera import linear_response

SMALL = ("--bits", "3", "--responses", "log,linear", "--ranges", "100,low", "-n", "2")
"""Options for a table of eight rows that takes little time."""


def test_show_prints_all_rows_or_some(run: Run) -> None:
    rows = run("table", "show", "--json").json["entries"]
    assert len(rows) == len(default_table().entries)
    some = run("table", "show", "--response", "log", "--range", "high", "-n", "3", "--json").json
    assert [(row["response"], row["dynamic_range"], row["n"]) for row in some["entries"]] == [
        ("log", 16000, 3)
    ]
    text = run("table", "show", "--response", "log", "-n", "3").out
    assert text.count("\nlog ") == text.count("noise unknown: quantisation only") == 3
    assert "camera: linear 8 bit" in text


def test_show_has_the_exposures_chosen_by_accuracy_for_a_sensor(run: Run) -> None:
    options = ("--sensor", "standard", "-n", "3", "--range", "medium")
    rows = run("table", "show", *options, "--json").json["entries"]
    found = {(row["response"], row["chosen_by"]): row for row in rows}
    assert len(found) == len(rows) == 6
    linear = found["linear", "accuracy"]
    assert linear["effective_levels"] > 69.5
    assert sum(linear["exposures"]) <= 3.1
    for response in ("linear", "gamma", "log"):
        by_accuracy, by_xi = found[response, "accuracy"], found[response, "xi"]
        assert by_accuracy["effective_levels"] >= 0.995 * by_xi["effective_levels"]
        assert by_accuracy["effective_levels_noise_free"] < by_xi["effective_levels_noise_free"]
    text = run("table", "show", *options).out
    assert "69.98  with noise, 255.9 without" in text
    assert "quantisation only" not in text
    # This sensor's response has no xi rows in the built-in table.
    options = ("--sensor", "consumer", "--response", "gamma", "-n", "2")
    curved = run("table", "show", *options, "--json").json["entries"]
    assert [row["chosen_by"] for row in curved] == ["accuracy"] * 3


def test_table_that_was_built_is_shown(run: Run) -> None:
    ran = run("table", "build", *SMALL, "-o", "three.json", "--workers", "1")
    assert ran.out == (
        "wrote three.json: 8 rows for linear 3 bit\n"
        "show it with: camctl table show --table three.json\n"
    )
    assert [path.name for path in Path().iterdir()] == ["three.json"]
    rows = run("table", "show", "--table", "three.json", "--bits", "3", "--json").json["entries"]
    assert len(rows) == 8
    other = run("table", "show", "--table", "three.json", "--bits", "4")
    assert other.error == (
        "table three.json has no row for linear 4 bit; build one with camctl table build"
    )


def test_a_camera_without_a_row_has_a_hint_that_can_be_followed(run: Run) -> None:
    line = ("table", "show", "--camera", "sim", "--sensor", "webcam", "--table", "three.json")
    run("table", "build", *SMALL, "-o", "three.json", "--workers", "1")
    assert "find exposures with camctl solve --camera sim" in run(*line).error


@pytest.mark.slow
def test_table_is_the_same_with_any_number_of_workers(run: Run) -> None:
    one = run("table", "build", *SMALL, "-o", "a", "--workers", "1", "--json").json
    two = run("table", "build", *SMALL, "-o", "b", "--workers", "2", "--json").json
    assert two["entries"] == one["entries"]
    assert Path("a").read_bytes() == Path("b").read_bytes()


def test_interrupted_build_continues(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    solve_job = build.solve_job
    done: list[str] = []

    def interrupt_after_three(job: Any, *rest: Any) -> Any:
        if len(done) == 3:
            raise KeyboardInterrupt
        done.append(job.name)
        return solve_job(job, *rest)

    monkeypatch.setattr(build, "solve_job", interrupt_after_three)
    arguments = ("table", "build", *SMALL, "-o", "t", "--workers", "1")
    ran = run(*arguments)
    assert ran.status == InterruptedBuildError.exit_status == 130
    assert ran.error == (
        "interrupted after 3 of 8 rows; the same command continues, with the rows kept in t.parts"
    )
    assert not Path("t").exists()

    first = list(done)
    done.clear()

    def record(job: Any, *rest: Any) -> Any:
        done.append(job.name)
        return solve_job(job, *rest)

    monkeypatch.setattr(build, "solve_job", record)
    assert run(*arguments).status == 0
    assert len(done) == 5
    assert not set(done) & set(first)
    assert [path.name for path in Path().iterdir()] == ["t"]


def test_processes_of_a_failed_build_end_quietly(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """However fast they end, the pool's thread raises nothing, which pytest would report."""
    terminate = multiprocessing.process.BaseProcess.terminate

    def terminate_and_wait(process: multiprocessing.process.BaseProcess) -> None:
        terminate(process)
        process.join()
        time.sleep(0.1)  # for the pool's thread to notice

    monkeypatch.setattr(multiprocessing.process.BaseProcess, "terminate", terminate_and_wait)
    Path("d").touch()
    arguments = ("--bits", "3", "-n", "2", "--workers", "2")
    assert "cannot write d" in run("table", "build", "-o", "d/t", *arguments).error


def test_rows_of_another_camera_are_not_counted_as_done(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(job: Any, *rest: Any) -> Any:
        raise KeyboardInterrupt

    Path("t.parts").mkdir()
    Path("t.parts", "0123456789abcdef-0123456789abcdef.json").write_text("{}")
    monkeypatch.setattr(build, "solve_job", interrupt)
    ran = run("table", "build", *SMALL, "-o", "t", "--workers", "1")
    assert ran.error == "interrupted after 0 of 8 rows"


def test_progress_of_a_build_follows_the_work() -> None:
    """Of three rows each, n = 3 comes first, then n = 2; n = 1 takes no time."""
    content = TableContent(("linear", "gamma", "log"), (100.0,), 3)
    fractions = [content.work_done(rows) for rows in range(10)]
    assert fractions[0] == 0
    assert fractions[3] == pytest.approx(3 * 25_000 / (3 * 25_000 + 2 * 10_000))
    assert fractions[6:] == pytest.approx([1, 1, 1, 1])
    single = TableContent(("log",), (100.0, 256.0), 1)
    assert [single.work_done(rows) for rows in range(3)] == [0, 0.5, 1]


@pytest.mark.parametrize(
    ("files", "line", "message", "status"),
    [
        ({"t": "{"}, "show --table t", "exposure table t is damaged", 1),
        ({}, "show --table nix", "exposure table nix: No such file", 1),
        ({}, "show --bits 10", "the built-in table has no row for linear 10 bit; build one", 1),
        ({}, "show -n 9", "the table has no such row; camctl solve", 2),
        ({"t": ""}, "build -o t", "t exists; choose another file, or have it replaced", 1),
        ({"d": ""}, "build -o d/t --bits 1 -n 1", "cannot write d", 1),
        ({}, "build --responses log,lin", "unknown response 'lin'", 2),
        (
            {},
            "build --ranges low,1",
            "invalid value for --ranges: 1; the range must be above 1",
            2,
        ),
        ({}, "build --workers 0", "invalid value for --workers: 0; expected a whole number", 2),
    ],
)
def test_impossible_table_command_is_one_line(
    run: Run, files: dict[str, str], line: str, message: str, status: int
) -> None:
    for name, text in files.items():
        Path(name).write_text(text)
    ran = run("table", *line.split())
    assert message in ran.error
    assert ran.status == status
    assert all(Path(name).read_text() == text for name, text in files.items())


def test_sensitivity_of_each_row_is_that_of_evaluate(run: Run) -> None:
    arguments = ("table", "show", "-n", "2", "--range", "low", "--sensitivity")
    rows = run(*arguments, "--json").json["entries"]
    assert [row["response"] for row in rows] == ["linear", "gamma", "log"]
    ratios = ",".join(map(repr, rows[2]["exposures"]))
    rated = run("evaluate", "--range", "low", "--ratios", ratios, "--json").json
    assert rows[2]["sensitivity"] == rated["sensitivity"]
    text = run(*arguments).out
    headings = text.splitlines()[2].split("  ")
    for heading in ("error 0.01 %", "error 0.1 %", "error 1 %", "noise 0.1", "noise 2"):
        assert heading in headings
    assert "all phases" in headings
    assert text.count("\nlog ") == 1
    plain = run("table", "show", "-n", "2", "--json").json["entries"]
    assert all("sensitivity" not in row for row in plain)


def test_sensitivity_finds_linear_cameras_by_their_levels(run: Run) -> None:
    arguments = ("table", "build", "--bits", "3", "-n", "2", "--ranges", "low", "--workers", "1")
    assert run(*arguments, "-o", "t").status == 0
    shown = ("table", "show", "--sensitivity", "--json")
    found = run(*shown, "--table", "t").json["entries"]
    assert found == run(*shown, "--table", "t", "--bits", "3").json["entries"]
    assert run(*arguments, "--curve", "srgb", "-o", "s").status == 0
    ran = run("table", "show", "--sensitivity", "--table", "s")
    assert ran.error == (
        "the response of the camera srgb 3 bit is unknown; "
        "give --bits, --phase and --curve as when the table was built"
    )
    assert ran.status == 2
    assert run(*shown, "--table", "s", "--bits", "3", "--curve", "srgb").status == 0


def test_built_in_rows_are_for_a_camera_that_sensitivity_finds() -> None:
    assert {entry.camera for entry in default_table().entries} == {linear_response(8).fingerprint}
