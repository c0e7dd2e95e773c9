"""`--objective accuracy` and `--accuracy` of `camctl solve` and `camctl shoot`."""

from __future__ import annotations

import pytest
from command_line import Run

SMALL = ("-O", "size=32x24", "-o", "out")


def test_solve_by_accuracy_beats_xi_with_the_noise_of_a_sensor(run: Run) -> None:
    arguments = ("solve", "--sensor", "standard", "--response", "linear", "--json")
    by_accuracy = run(*arguments, "--objective", "accuracy").json
    by_xi = run(*arguments).json
    assert (by_accuracy["objective"], by_xi["objective"]) == ("accuracy", "xi")
    assert by_accuracy["effective_levels"] > 1.1 * by_xi["effective_levels"]
    assert by_accuracy["total_exposure"] < 0.7 * by_xi["total_exposure"]
    assert by_accuracy["effective_levels_noise_free"] > by_accuracy["effective_levels"]
    assert by_accuracy["xi"] > by_xi["xi"]


def test_text_of_solve_says_how_the_exposures_were_chosen(run: Run) -> None:
    noise = ("--electrons", "40", "--read-noise", "0.1")
    ran = run("solve", *noise, "--objective", "accuracy", "-n", "2")
    assert "chosen by            accuracy with this camera's noise\n" in ran.out
    assert " with noise, " in ran.out
    by_xi = run("solve", "--sensor", "standard").out
    assert "chosen by            missing levels (xi), without noise; shoot counts it, as " in by_xi
    assert "chosen by" not in run("solve").out  # no noise is known


def test_solve_on_settings_and_gains_within_a_time(run: Run) -> None:
    arguments = ("--settings", "0.01,0.02,0.04", "--gains", "1,2,4", "--total-limit", "0.05")
    found = run(
        "solve", "--sensor", "webcam", "--objective", "accuracy", "-n", "3", *arguments, "--json"
    ).json
    assert found["shutter_s"] <= 0.05
    assert found["exhaustive"]
    assert set(found["times_s"]) <= {0.01, 0.02, 0.04}
    assert set(found["gains"]) <= {1, 2, 4}
    assert max(found["gains"]) > 1


def test_solve_reaches_an_accuracy_with_the_exposures_that_it_needs(run: Run) -> None:
    arguments = ("solve", "--sensor", "standard", "--response", "linear", "--json")
    found = run(*arguments, "--accuracy", "60").json
    assert len(found["exposures"]) == 3
    assert found["effective_levels"] >= 60


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("solve", "--objective", "accuracy"),
            "exposures cannot be chosen by accuracy: the camera's noise is not known; name a "
            "camera with --sensor or --camera, or give --electrons and --read-noise",
        ),
        (("solve", "--accuracy", "50"), "the camera's noise is not known"),
        (
            ("solve", "--sensor", "standard", "--accuracy", "1000", "-n", "2"),
            "no set of 2 exposures has 1000 effective levels with this camera's noise; the best "
            "has 62.",
        ),
        (
            ("solve", "--sensor", "standard", "--objective", "accuracy", "--total-limit", "0.5"),
            "one exposure takes 1 x the shortest at least, more than the 0.5 x",
        ),
        (("solve", "--objective", "xi", "--accuracy", "50"), "--objective xi cannot be combined"),
        (("solve", "--objective", "accuracy", "--p", "2"), "cannot be combined with --p"),
        (("solve", "--objective", "speed"), "unknown objective 'speed'"),
        (
            ("solve", "--sensor", "standard", "--accuracy", "nan"),
            "invalid value for --accuracy: nan",
        ),
        (("shoot", "--time-budget", "1us", *SMALL), "invalid value for --time-budget: 1us"),
        (("shoot", "--time-budget", "0.000001", *SMALL), "one exposure takes 0.1 s at least"),
        (("shoot", "--accuracy", "5000", "-n", "2", *SMALL), "no set of 2 exposures has 5000"),
        (("shoot", "--objective", "xi", "--accuracy", "50", *SMALL), "objective 'xi'"),
        (("shoot", "--ratios", "1,2", "--objective", "accuracy", *SMALL), "--ratios cannot be"),
        (
            ("shoot", "--objective", "accuracy", "--tolerance", "5", "--levels", "9", *SMALL),
            "a choice by accuracy cannot be combined with tolerance",
        ),
    ],
)
def test_requests_that_cannot_be_met_are_one_line(
    run: Run, arguments: tuple[str, ...], message: str
) -> None:
    ran = run(*arguments)
    assert ran.status in (1, 2)
    assert message in ran.err
    assert ran.err.startswith("camctl: ")
    assert ran.err.count("\n") == 1
    assert not ran.out


def test_shoot_chooses_by_accuracy_unless_asked_otherwise(run: Run) -> None:
    arguments = ("--response", "linear", "-n", "3", "-O", "size=64x48", "--json")
    by_accuracy = run("shoot", *arguments, "-o", "a").json
    by_xi = run("shoot", *arguments, "--set", "objective=xi", "-o", "b").json
    assert (by_accuracy["plan"]["objective"], by_xi["plan"]["objective"]) == ("accuracy", "xi")
    assert "objective" not in by_accuracy["request"]
    assert len(by_accuracy["frames"]) == len(by_xi["frames"]) == 3
    achieved = by_accuracy["achieved"]["effective_levels"]
    assert achieved > 1.1 * by_xi["achieved"]["effective_levels"]
    assert "chosen by" in run("shoot", *arguments[:-1], "-o", "c").out


def test_options_that_solve_has_work_in_shoot_where_they_are_settings(run: Run) -> None:
    given = ("--levels=300", "--objective", "xi", "--seed", "3", *SMALL, "-n", "2")
    request = run("shoot", *given, "--json").json["request"]
    assert (request["levels_wanted"], request["objective"]) == (300, "xi")
    assert run("shoot", "--objective").status == 2
    assert "the capture in out is complete" in run("shoot", "--resume", "out").err


def test_what_one_picture_needs_is_at_most_20_options() -> None:
    from camctl.cli.shoot import shoot

    assert len({each.name for each in shoot.params} - {"help", "debug"}) <= 20
