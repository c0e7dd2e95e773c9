"""Certificates of `camctl solve`, sensitivity of `camctl evaluate`, and progress bars."""

from __future__ import annotations

import os
import pty
import select
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import pytest
from command_line import Run
from sampling import some

from camctl.cli.sensitivity import describe_losses, format_levels
from camctl.cli.solve.output import certificate_text
from camctl.exposure.lower_bound import Certificate
from camctl.exposure.robustness import Robustness, Spread
from camctl.sim.sensors.sensor import load_sensor


@pytest.mark.parametrize("response", some(["linear", "gamma", "log"], every=3))
def test_two_exposures_are_proven_best(run: Run, response: str) -> None:
    arguments = ("solve", "-n", "2", "--bits", "6", "--response", response)
    output = run(*arguments, "--certificate", "--json").json
    certificate = output["certificate"]
    assert certificate["proven"] is True
    assert certificate["best_known_xi"] == output["xi"]
    assert output["xi"] * (1 - 1.01e-4) <= certificate["lower_bound"] <= output["xi"]
    gap = 1 - certificate["lower_bound"] / output["xi"]
    assert certificate["relative_gap"] == pytest.approx(gap)
    assert certificate["evaluations"] > 1000
    assert certificate["seconds"] > 0
    assert output["xi"] <= run(*arguments, "--json").json["xi"]


def test_text_output_of_a_proof(run: Run) -> None:
    ran = run("solve", "-n", "2", "--bits", "4", "--certificate")
    title = "certificate: proof that no other exposures are better"
    assert f"{title}\n  best known xi  10.5785" in ran.out
    assert " for any 2 exposures\n" in ran.out
    assert " sets evaluated in " in ran.out
    assert ran.err == ""


def test_where_no_level_is_missing_the_proof_needs_no_search(run: Run) -> None:
    ran = run("solve", "-n", "2", "--levels", "20", "--response", "linear", "--certificate")
    assert "exposures            1  1\n" in ran.out
    assert "  best known xi  0\n  lower bound    0 for any 2 exposures" in ran.out
    assert "  search         1 set evaluated in " in ran.out


def test_bound_is_not_called_a_proof(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("camctl.cli.solve.DEFAULT_EVALUATIONS", 2000)
    short = ("solve", "-n", "3", "--bits", "6", "--certificate", "--json")
    certificate = run(*short).json["certificate"]
    assert certificate["proven"] is False
    assert 0 <= certificate["lower_bound"] < certificate["best_known_xi"]
    loose = Certificate((1.0, 2.0, 3.0), xi=10.0, lower_bound=4.0, evaluations=9, seconds=1.0)
    assert certificate_text(loose).startswith("certificate: a lower bound, no proof; ")
    assert "60 % of the best known xi" in certificate_text(loose)
    none = Certificate((1.0, 2.0, 3.0), xi=10.0, lower_bound=0.0, evaluations=9, seconds=1.0)
    assert certificate_text(none).startswith("certificate: no bound above 0 was found")


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("--certificate --p 2", "--certificate cannot be combined with --p"),
        ("--certificate --jitter 0.1", "--certificate cannot be combined with --jitter"),
        ("--certificate --total-limit 9", "--certificate cannot be combined with --total-limit"),
    ],
)
def test_impossible_certificate_is_one_line(run: Run, line: str, message: str) -> None:
    ran = run("solve", *line.split())
    assert message in ran.error
    assert ran.status == 2


def test_json_output_of_sensitivity(run: Run) -> None:
    output = run("evaluate", "--ratios", "1,9.91,88.38", "--bits", "6", "--json").json
    sensitivity = output["sensitivity"]
    assert list(sensitivity["exposure_error"]) == ["0.0001", "0.001", "0.01"]
    assert list(sensitivity["noise"]) == ["0.1", "0.5", "2"]
    for spread in (*sensitivity["exposure_error"].values(), sensitivity["phase"]):
        assert spread["effective_levels_worst"] <= spread["effective_levels"]
        assert spread["xi_worst"] >= spread["xi"]
    noisy = [each["effective_levels"] for each in sensitivity["noise"].values()]
    assert noisy == sorted(noisy, reverse=True)
    equal = run("evaluate", "--ratios", "1,1,1", "--bits", "6", "--json").json["sensitivity"]
    for sigma, each in sensitivity["noise"].items():
        of_equal = equal["noise"][sigma]["effective_levels"]
        assert each["effective_levels_equal_exposures"] == pytest.approx(of_equal)


def test_sensitive_exposures_are_explained_in_sentences(run: Run) -> None:
    """With 8 bits, 1.003 puts the second frame's levels between those of the first."""
    arguments = ("evaluate", "--response", "linear")
    sensitive = run(*arguments, "--ratios", "1,1.003,2.985").out
    assert "two exposures differ by only 0.3 %; exposure errors strongly reduce" in sensitive
    assert "with noise of 0.5 levels these exposures are no better than 3 equal ones" in sensitive
    robust = run("evaluate", "--ratios", "1,9.91,88.38").out
    assert "disturbance  " in robust
    assert "3 equal exposures\n" in robust
    assert "reduce" not in robust
    assert "no better" not in robust


def test_one_exposure_has_no_exposure_errors_and_no_comparison(run: Run) -> None:
    out = run("evaluate", "--ratios", "1").out
    assert "equal exposures" not in out
    assert "exposure errors" not in out
    assert "all phases of the quantiser" in out


def test_sensitivity_is_left_out_where_it_takes_long(run: Run) -> None:
    large = ("evaluate", "--ratios", "1,30", "--bits", "16", "--json")
    assert "sensitivity" not in run(*large).json
    small = ("evaluate", "--ratios", "1,30", "--bits", "4", "--json")
    assert "sensitivity" in run(*small).json
    assert "sensitivity" not in run(*small, "--no-sensitivity").json
    assert "disturbance" not in run("evaluate", "--ratios", "1,30", "--no-sensitivity").out


def test_noise_reduces_effective_levels(run: Run) -> None:
    arguments = ("evaluate", "--ratios", "1,4", "--bits", "6", "--no-sensitivity")
    unknown = run(*arguments, "--json").json
    assert unknown["noise"] is None
    assert unknown["effective_levels"] == unknown["effective_levels_noise_free"]
    assert "noise unknown: quantisation only" in run(*arguments).out
    noisy = run(*arguments, "--electrons", "40", "--read-noise", "0.3", "--json").json
    assert noisy["effective_levels"] < noisy["effective_levels_noise_free"]
    assert noisy["effective_levels_noise_free"] == unknown["effective_levels"]
    assert noisy["noise"]["conversion_e_per_dn"] == 40
    brighter = run(*arguments, "--electrons", "4000", "--read-noise", "0.3", "--json").json
    assert brighter["effective_levels"] > noisy["effective_levels"]
    text = run(*arguments, "--electrons", "40").out
    assert "with noise, " in text
    assert "of 2 equal exposures" in text
    none = run(*arguments, "--read-noise", "0", "--json").json
    assert none["effective_levels"] == pytest.approx(unknown["effective_levels"], rel=1e-9)
    assert none["noise"]["photon_noise"] is False


@pytest.mark.parametrize("name", some(["webcam", "complete"], every=2))
def test_a_sensor_brings_its_response_and_its_noise(run: Run, name: str) -> None:
    sensor = load_sensor(name)
    noise = asdict(sensor.noise_model)
    noise["read_noise_e"] = [list(pair) for pair in noise["read_noise_e"]]
    evaluated = run("evaluate", "--ratios", "1,4", "--sensor", name, "--json").json
    solved = run("solve", "-n", "1", "--sensor", name, "--json").json
    for found in (evaluated, solved):
        assert found["noise"] == noise
        assert found["effective_levels"] < 0.9 * found["effective_levels_noise_free"]
        assert found["levels_wanted"] % (sensor.white - sensor.black) == 0
    by_camera = ("evaluate", "--ratios", "1,4", "--camera", "sim", "--json")
    assert run(*by_camera).json["noise"]["conversion_e_per_dn"] == 10000 / 256


def test_table_rows_count_noise_where_it_is_known(run: Run) -> None:
    arguments = ("table", "show", "--response", "log", "--range", "medium", "-n", "3")
    (unknown,) = run(*arguments, "--json").json["entries"]
    rows = run(*arguments, "--sensor", "standard", "--json").json["entries"]
    assert [row["chosen_by"] for row in rows] == ["xi", "accuracy"]
    known = rows[0]
    assert unknown["effective_levels"] == unknown["effective_levels_noise_free"]
    assert known["effective_levels_noise_free"] == unknown["effective_levels"]
    assert known["effective_levels"] < 0.3 * unknown["effective_levels"]
    assert "noise unknown: quantisation only" in run(*arguments).out
    assert " with noise, " in run(*arguments, "--electrons", "40").out


def test_a_sensor_excludes_the_options_that_describe_another_camera(run: Run) -> None:
    ran = run(
        "evaluate", "--ratios", "1,2", "--sensor", "webcam", "--bits", "8", "--electrons", "9"
    )
    assert ran.status == 2
    assert "--sensor cannot be combined with --bits, --electrons" in ran.error


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (
            "--electrons 0",
            "invalid value for --electrons: 0; expected a number of electrons of at least 0.001",
        ),
        ("--read-noise -1", "invalid value for --read-noise: -1; expected a noise of at least 0"),
        ("--read-noise 65", "invalid read noise of 65 levels: expected 0 to 64"),
    ],
)
def test_invalid_noise_is_one_line(run: Run, line: str, message: str) -> None:
    ran = run("evaluate", "--ratios", "1,2", "--bits", "4", *line.split())
    assert message in ran.error
    assert ran.status == 2


def spread(levels: float, worst: float) -> Spread:
    return Spread(1.0, 2.0, levels, worst)


def test_losses_are_described_only_where_they_are_notable() -> None:
    robust = Robustness(
        xi=1.0,
        effective_levels=100.0,
        exposure_errors={0.001: spread(99, 96), 0.01: spread(96, 90)},
        noise={0.5: 80.0},
        noise_of_equal={0.5: 20.0},
        phase=spread(99, 97),
    )
    assert describe_losses(robust, (1, 5)) == []
    sensitive = Robustness(
        xi=1.0,
        effective_levels=100.0,
        exposure_errors={0.001: spread(99, 96), 0.01: spread(94, 90)},
        noise={0.5: 20.0},
        noise_of_equal={0.5: 20.0},
        phase=spread(99, 80),
    )
    assert describe_losses(sensitive, (1, 5)) == [
        "exposure errors reduce the effective levels: by 6 % at errors of 1 %",
        "with noise of 0.5 levels these exposures are no better than 2 equal ones",
        "the result depends on the phase of the quantiser: the worst phase loses 20 % of the "
        "effective levels",
    ]


@pytest.mark.parametrize(
    ("levels", "expected"),
    [
        (1234.5, "1234"),
        (100.0, "100"),
        (99.96, "100"),
        (99.94, "99.9"),
        (9.996, "10.0"),
        (3, "3.00"),
    ],
)
def test_levels_have_three_digits(levels: float, expected: str) -> None:
    assert format_levels(levels) == expected


def run_on_terminal(folder: Path, *arguments: str) -> tuple[str, str]:
    """Return standard output, and what a terminal on standard error received."""
    reader, writer = pty.openpty()
    code = f"import sys; from camctl.cli import main; sys.exit(main({list(arguments)!r}))"
    with (folder / "out").open("wb") as out:
        process = subprocess.Popen(
            [sys.executable, "-c", code], stdout=out, stderr=writer, cwd=folder
        )
        os.close(writer)
        shown = b""
        while True:  # until the program has ended and its side of the terminal is closed
            select.select([reader], [], [])
            try:
                data = os.read(reader, 65536)
            except OSError:
                break
            if not data:
                break
            shown += data
        os.close(reader)
        assert process.wait() == 0
    return (folder / "out").read_text(), shown.decode(errors="replace")


@pytest.mark.parametrize(
    ("line", "label"),
    [
        ("solve -n 2 --bits 4 --certificate --json", "proving"),
        pytest.param(
            "table show -n 1 --range low --sensitivity", "computing 3 rows", marks=pytest.mark.slow
        ),
    ],
)
def test_progress_is_shown_on_a_terminal_only(tmp_path: Path, line: str, label: str) -> None:
    out, shown = run_on_terminal(tmp_path, *line.split())
    assert label in shown
    assert label not in out
