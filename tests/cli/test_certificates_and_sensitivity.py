"""What solve proves, and what evaluate and table show say of wrong exposures, noise and phase."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from camctl.cli.evaluate import count, warnings_of
from camctl.cli.solve_output import USUAL_SETS, certificate_text
from camctl.exposure.effective import EffectiveCamera
from camctl.exposure.lower_bound import Certificate
from camctl.exposure.objective import xi
from camctl.exposure.robustness import Robustness, Spread
from camctl.exposure.table import default_table
from camctl.response.camera import linear_response
from camctl.response.desired import desired_response

if TYPE_CHECKING:
    from conftest import Run


@pytest.mark.parametrize("response", ["linear", "gamma", "log"])
def test_two_exposures_come_with_a_proof(run: Run, response: str) -> None:
    words = ("solve", "-n", "2", "--bits", "6", "--response", response)
    told = run(*words, "--certificate", "--json").json
    proof = told["certificate"]
    assert proof["proven"] is True
    assert proof["best_known"] == told["xi"]
    assert told["xi"] * (1 - 1.01e-4) <= proof["lower_bound"] <= told["xi"]
    assert proof["gap"] == pytest.approx(1 - proof["lower_bound"] / told["xi"])
    assert proof["sets_bounded"] > 1000
    assert proof["seconds"] > 0
    assert told["xi"] <= run(*words, "--json").json["xi"]


def test_the_bound_is_below_what_any_two_score(run: Run) -> None:
    told = run("solve", "-n", "2", "--bits", "4", "--range", "64", "--certificate", "--json").json
    response, desired = linear_response(4), desired_response("log", 64.0)
    scores = [
        xi(EffectiveCamera.of(response, (1, 1 + step / 50)), desired, 30) for step in range(4000)
    ]
    assert told["certificate"]["lower_bound"] <= min(scores)


def test_a_proof_as_text(run: Run) -> None:
    ran = run("solve", "-n", "2", "--bits", "4", "--certificate")
    assert "certificate: proven, nothing better exists\n  best known xi   10.5785" in ran.out
    assert "for any 2 exposures at all" in ran.out
    assert " in ln e, " in ran.out
    assert ran.err == ""


def test_a_bound_is_not_called_a_proof(run: Run) -> None:
    short = ("solve", "-n", "3", "--bits", "6", "--certificate", "--time-limit", "0.05", "--json")
    proof = run(*short).json["certificate"]
    assert proof["proven"] is False
    assert 0 <= proof["lower_bound"] < proof["best_known"]
    loose = Certificate((1.0, 2.0, 3.0), xi=10.0, lower_bound=4.0, evaluations=9, seconds=1.0)
    assert "a bound, no proof" in certificate_text(loose)
    assert "60 % of the best known" in certificate_text(loose)
    nothing = Certificate((1.0, 2.0, 3.0), xi=10.0, lower_bound=0.0, evaluations=9, seconds=1.0)
    assert "nothing is proven yet" in certificate_text(nothing)


def test_less_time_bounds_fewer_sets(run: Run) -> None:
    words = ("solve", "-n", "3", "--bits", "3", "--response", "linear", "--certificate", "--json")
    short = run(*words, "--time-limit", "0.01").json["certificate"]
    assert short["sets_bounded"] < USUAL_SETS / 4
    assert short["lower_bound"] <= short["best_known"]


def test_a_search_stops_in_time(run: Run) -> None:
    told = run("solve", "-n", "6", "--time-limit", "0.2", "--json").json
    assert told["seconds"] < 3
    assert told["xi"] > 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--certificate", "--p", "2"], "--certificate goes without --p"),
        (["--certificate", "--jitter", "0.1"], "--certificate goes without --jitter"),
        (["--certificate", "--total-limit", "9"], "--certificate goes without --total-limit"),
        (["--time-limit", "0"], "--time-limit: 0 is not a time in seconds above 0"),
    ],
)
def test_what_no_certificate_is_for(run: Run, words: list[str], message: str) -> None:
    ran = run("solve", *words)
    assert message in ran.error
    assert ran.status == 2


def test_evaluate_says_what_is_left(run: Run) -> None:
    told = run("evaluate", "--ratios", "1,9.91,88.38", "--bits", "6", "--json").json
    left = told["sensitivity"]
    assert list(left["exposures_off_by"]) == ["0.0001", "0.001", "0.01"]
    assert list(left["noise_levels"]) == ["0.1", "0.5", "2"]
    for spread in (*left["exposures_off_by"].values(), left["any_phase"]):
        assert spread["effective_levels_worst"] <= spread["effective_levels"]
        assert spread["xi_worst"] >= spread["xi"]
    noisy = [each["effective_levels"] for each in left["noise_levels"].values()]
    assert noisy == sorted(noisy, reverse=True)
    equal = run("evaluate", "--ratios", "1,1,1", "--bits", "6", "--json").json["sensitivity"]
    for sigma, each in left["noise_levels"].items():
        of_equal = equal["noise_levels"][sigma]["effective_levels"]
        assert each["effective_levels_of_equal_exposures"] == pytest.approx(of_equal)


def test_an_interleave_that_does_not_survive_is_named(run: Run) -> None:
    """8 bits: 1.003 puts the second frame's levels between the first one's."""
    words = ("evaluate", "--response", "linear")
    told = run(*words, "--ratios", "1,1.003,2.985").out
    assert "the 0.3 % interleave does not survive wrong exposures" in told
    assert "with noise of 0.5 levels this gives no more than 3 equal exposures" in told
    told = run("evaluate", "--ratios", "1,9.91,88.38").out
    assert "what is left" in told
    assert "survive" not in told
    assert "equal exposures\n" in told
    assert "gives no more" not in told


def test_one_exposure_is_compared_to_nothing(run: Run) -> None:
    told = run("evaluate", "--ratios", "1").out
    assert "equal exposures" not in told
    assert "exposures off" not in told
    assert "any phase of the quantiser" in told


def test_sensitivity_is_left_out_where_it_takes_long(run: Run) -> None:
    big = ("evaluate", "--ratios", "1,30", "--bits", "16", "--json")
    assert "sensitivity" not in run(*big).json
    small = ("evaluate", "--ratios", "1,30", "--bits", "4", "--json")
    assert "sensitivity" in run(*small).json
    assert "sensitivity" not in run(*small, "--no-sensitivity").json
    assert "what is left" not in run("evaluate", "--ratios", "1,30", "--no-sensitivity").out


def test_noise_of_a_sensor_is_counted_in(run: Run) -> None:
    words = ("evaluate", "--ratios", "1,4", "--bits", "6", "--no-sensitivity")
    quiet = run(*words, "--json").json
    assert "with_noise" not in quiet
    noisy = run(*words, "--electrons", "40", "--read-noise", "0.3", "--json").json["with_noise"]
    assert noisy["effective_levels"] < quiet["effective_levels"]
    brighter = run(*words, "--electrons", "4000", "--read-noise", "0.3", "--json").json
    assert brighter["with_noise"]["effective_levels"] > noisy["effective_levels"]
    assert "with that noise" in run(*words, "--electrons", "40").out
    none = run(*words, "--read-noise", "0", "--json").json["with_noise"]
    assert none["effective_levels"] == pytest.approx(quiet["effective_levels"], rel=0.01)
    assert none["electrons_per_level"] is None


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--electrons", "0"], "--electrons: 0 is not a number of electrons above 0"),
        (["--read-noise", "-1"], "--read-noise: -1 is not a noise from 0"),
        (["--read-noise", "65"], "invalid read noise of 65 levels: expected 0 to 64"),
    ],
)
def test_noise_that_cannot_be(run: Run, words: list[str], message: str) -> None:
    ran = run("evaluate", "--ratios", "1,2", "--bits", "4", *words)
    assert message in ran.error
    assert ran.status == 2


def spread(levels: float, worst: float) -> Spread:
    return Spread(1.0, 2.0, levels, worst)


def test_sentences_come_where_they_matter() -> None:
    steady = Robustness(
        xi=1.0,
        effective_levels=100.0,
        exposure_errors={0.001: spread(99, 96), 0.01: spread(96, 90)},
        noise={0.5: 80.0},
        noise_of_equal={0.5: 20.0},
        phase=spread(99, 97),
    )
    assert warnings_of(steady, (1, 5)) == []
    shaky = Robustness(
        xi=1.0,
        effective_levels=100.0,
        exposure_errors={0.001: spread(99, 96), 0.01: spread(94, 90)},
        noise={0.5: 20.0},
        noise_of_equal={0.5: 20.0},
        phase=spread(99, 80),
    )
    said = warnings_of(shaky, (1, 5))
    assert said == [
        "this set suffers from wrong exposures: effective levels lost are 6 % at 1 % off",
        "with noise of 0.5 levels this gives no more than 2 equal exposures",
        "much depends on where the quantiser's steps lie: the worst phase loses 20 % of the "
        "effective levels",
    ]


@pytest.mark.parametrize(
    ("levels", "told"),
    [
        (1234.5, "1234"),
        (100.0, "100"),
        (99.96, "100"),
        (99.94, "99.9"),
        (9.996, "10.0"),
        (3, "3.00"),
    ],
)
def test_levels_in_columns(levels: float, told: str) -> None:
    assert count(levels) == told


def test_table_shows_what_is_left_of_each_row(run: Run) -> None:
    words = ("table", "show", "-n", "2", "--range", "low", "--sensitivity")
    rows = run(*words, "--json").json["entries"]
    assert [row["response"] for row in rows] == ["linear", "gamma", "log"]
    ratios = ",".join(map(repr, rows[2]["exposures"]))
    judged = run("evaluate", "--range", "low", "--ratios", ratios, "--json").json
    assert rows[2]["sensitivity"] == judged["sensitivity"]
    text = run(*words).out
    heads = text.splitlines()[2].split("  ")
    for head in ("off 0.01 %", "off 0.1 %", "off 1 %", "noise 0.1", "noise 2", "any phase"):
        assert head in heads
    assert text.count("\nlog ") == 1
    plain = run("table", "show", "-n", "2", "--json").json["entries"]
    assert all("sensitivity" not in row for row in plain)


def test_table_of_another_camera_tells_its_own_levels(run: Run) -> None:
    built = ("table", "build", "--bits", "3", "-n", "2", "--ranges", "low", "--workers", "1")
    assert run(*built, "-o", "t").status == 0
    shown = ("table", "show", "--sensitivity", "--json")
    known = run(*shown, "--table", "t").json["entries"]
    assert known == run(*shown, "--table", "t", "--bits", "3").json["entries"]
    assert run(*built, "--curve", "srgb", "-o", "s").status == 0
    ran = run(*shown, "--table", "s")
    assert "--sensitivity needs the camera, srgb 3 bit; name it with --bits" in ran.error
    assert ran.status == 2
    assert run(*shown, "--table", "s", "--bits", "3", "--curve", "srgb").status == 0


def on_a_terminal(folder: Path, *words: str) -> tuple[str, str]:
    """Return standard output and what a terminal at standard error got."""
    reader, writer = pty.openpty()
    code = f"import sys; from camctl.cli import main; sys.exit(main({list(words)!r}))"
    done = subprocess.run(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=writer, cwd=folder, check=True
    )
    os.close(writer)
    shown = os.read(reader, 100_000).decode(errors="replace")
    os.close(reader)
    return done.stdout.decode(), shown


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (("solve", "-n", "2", "--bits", "4", "--certificate", "--json"), "proving"),
        (("table", "show", "-n", "1", "--range", "low", "--sensitivity"), "disturbing 3 rows"),
    ],
)
def test_progress_is_shown_on_a_terminal(tmp_path: Path, words: Any, what: str) -> None:
    out, shown = on_a_terminal(tmp_path, *words)
    assert what in shown
    assert what not in out


def test_every_shipped_row_can_be_judged() -> None:
    """The rows name a camera that `table show --sensitivity` finds by itself."""
    assert {entry.camera for entry in default_table().entries} == {linear_response(8).fingerprint}
