"""Options for the real camera: its response curve, its shutter times, its gains."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from command_line import Run

MODEL = """E =
0 0.25 0.5
0.75 1
f0 =
0 0.3 0.6 0.8 1
h(1) =
0 0.1 0.1 0.05 0
h(2)=
0 -0.1 0.1 0.1 0
"""

DIAL = [1 / 250, 1 / 200, 1 / 160, 1 / 125, 1 / 100, 1 / 80, 1 / 60, 1 / 50, 1 / 40, 1 / 30]


def solved(run: Run, *arguments: str | Path) -> Any:
    """Return the JSON output of `camctl solve`."""
    return run("solve", *arguments, "--json").json


def test_response_model_gives_its_mean_and_weighted_curves(run: Run) -> None:
    Path("model").write_text(MODEL)
    Path("curve").write_text("0 0\n0.25 0.3\n0.5 0.6\n0.75 0.8\n1 1\n")
    Path("other").write_text("0 0\n0.25 0.45\n0.5 0.65\n0.75 0.8\n1 1\n")
    arguments = ("evaluate", "--ratios", "1,3", "--bits", "4", "--json", "--curve")
    for curve, coefficients in (("curve", "0"), ("other", "1,-0.5")):
        plain = run(*arguments, curve).json
        output = run(*arguments, "model", "--coefficients", coefficients).json
        assert output["xi"] == pytest.approx(plain["xi"], rel=1e-9)
        assert output["camera"] == f"model {coefficients} 4 bit"


def test_empirical_model_of_response(run: Run, real_data: Path) -> None:
    emor = real_data / "emor.txt"
    for response in ("linear", "gamma", "log"):
        output = solved(
            run,
            *("--curve", emor, "--coefficients", "1.5,-0.3"),
            *("-n", "2", "--bits", "5", "--response", response),
        )
        assert output["camera"] == "emor.txt 1.5,-0.3 5 bit"
        assert 0 < output["xi"] < 62


def test_power_curve(run: Run) -> None:
    arguments = ("evaluate", "--ratios", "1,3", "--bits", "4", "--json", "--curve")
    assert run(*arguments, "power:2.2").json["camera"] == "power 1/2.2 4 bit"
    linear = run(*arguments[:-1]).json["xi"]
    assert run(*arguments, "power:1").json["xi"] == pytest.approx(linear)


@pytest.mark.parametrize(
    ("text", "arguments", "message", "status"),
    [
        (
            MODEL,
            [],
            "c is a response model, which holds many curves; choose one with --coefficients",
            1,
        ),
        (
            "0 0\n1 1\n",
            ["--coefficients", "1"],
            "c is not a response model; --coefficients needs a file",
            1,
        ),
        (MODEL, ["--coefficients", "1,2,3"], "the response model has 2 components, not 3", 2),
        (MODEL, ["--coefficients", "90"], "take --coefficients nearer to 0, the mean", 1),
        (
            MODEL,
            ["--coefficients", "nan"],
            "invalid value for --coefficients: nan; expected numbers such as",
            2,
        ),
    ],
)
def test_unusable_curve_is_one_line(
    run: Run, text: str, arguments: list[str], message: str, status: int
) -> None:
    Path("c").write_text(text)
    ran = run("evaluate", "--ratios", "1,2", "--curve", "c", *arguments)
    assert message in ran.error
    assert ran.status == status


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--coefficients", "1"], "--coefficients needs --curve; name a response model"),
        (["--curve", "power"], "--curve power needs a gamma; for example power:2.2"),
        (
            ["--curve", "power:0"],
            "invalid value for --curve power: 0; expected a gamma from 0.05 to 20",
        ),
        (
            ["--curve", "power:99"],
            "invalid value for --curve power: 99; expected a gamma from 0.05 to 20",
        ),
    ],
)
def test_invalid_curve_option(run: Run, arguments: list[str], message: str) -> None:
    ran = run("evaluate", "--ratios", "1,2", *arguments)
    assert message in ran.error
    assert ran.status == 2


def test_curve_that_is_no_text_or_does_not_exist(run: Run) -> None:
    Path("c").write_bytes(b"\xff\xfe\x00")
    assert "curve c: " in run("solve", "--curve", "c").error
    assert "curve .: " in run("solve", "--curve", ".").error
    ran = run("solve", "--curve", "nix", "--coefficients", "1")
    assert "response model nix does not exist" in ran.error


def test_curve_with_fewer_samples_than_levels_is_a_warning(run: Run) -> None:
    Path("c").write_text("0 0\n0.5 0.7\n1 1\n")
    ran = run("solve", "--curve", "c", "-n", "2", "--bits", "4", "--json")
    assert ran.status == 0
    assert "warning: 3 samples for 15 levels" in ran.err
    assert ran.err.count("\n") == 1


def test_shutter_dial_is_compared_with_any_times(run: Run) -> None:
    """A dial in thirds of a stop reaches fewer effective levels than any times would."""
    times = [2.0 ** (round(3 * math.log2(label)) / 3) for label in DIAL]  # the true times
    Path("dial").write_text("\n".join(f"{time:.9g}" for time in times))
    arguments = ("--settings", "dial", "-n", "3", "--bits", "6", "--response", "linear")
    output = solved(run, *arguments)
    assert output["exhaustive"] is True
    assert output["xi"] >= output["unrestricted"]["xi"]
    assert output["shutter_s"] == pytest.approx(sum(output["times_s"]))
    assert output["gains"] == [1, 1, 1]
    text = run("solve", *arguments).out
    share = 100 * output["effective_levels"] / output["unrestricted"]["effective_levels"]
    assert f"the camera's settings reach {share:.3g} % of these levels" in text
    assert " missing levels (xi)\n" in text


def test_even_steps_equal_a_file_of_the_same_times(run: Run) -> None:
    Path("file").write_text("\n".join(f"{k}e-2" for k in range(1, 21)))
    arguments = ("-n", "2", "--bits", "5")
    listed = solved(run, *arguments, "--settings", "file")
    stepped = solved(run, *arguments, "--settings", "0.01:1/5:0.01")
    assert stepped["times_s"] == pytest.approx(listed["times_s"])
    assert stepped["xi"] == pytest.approx(listed["xi"])
    named = solved(run, *arguments, "--settings", "1/100,1/50,0.2")
    assert set(named["times_s"]) <= {0.01, 0.02, 0.2}


def test_gains_extend_the_range_of_exposures(run: Run) -> None:
    arguments = ("-n", "2", "--bits", "5", "--range", "high", "--settings", "0.01:0.05:0.01")
    timed = solved(run, *arguments)
    gained = solved(run, *arguments, "--gains", "1,4,16")
    assert gained["xi"] < timed["xi"]
    products = [
        time_s * gain for time_s, gain in zip(gained["times_s"], gained["gains"], strict=True)
    ]
    assert [product / products[0] for product in products] == pytest.approx(gained["exposures"])
    assert set(gained["gains"]) <= {1, 4, 16}
    assert all(0.01 <= time_s <= 0.0500001 for time_s in gained["times_s"])
    assert gained["shutter_s"] < gained["total_exposure"] * gained["times_s"][0]
    assert solved(run, *arguments, "--gains", "1:16:5")["gains"][-1] in (1, 6, 11, 16)
    text = run("solve", *arguments, "--gains", "1,4,16").out
    assert f"{gained['times_s'][0] * 1e3:g} ms x 1  " in text


def test_exposure_is_made_with_the_smallest_gain(run: Run) -> None:
    """2 s x 1 rather than 1 s x 2: gain adds noise."""
    output = solved(run, "-n", "2", "--bits", "4", "--settings", "1,2", "--gains", "2,1")
    for time_s, gain in zip(output["times_s"], output["gains"], strict=True):
        if math.isclose(time_s * gain, 2):
            assert (time_s, gain) == (2, 1)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["--settings", "1:0.1:0.1"],
            "invalid settings 1 to 0.1 in steps of 0.1: expected 0 < minimum",
        ),
        (
            ["--settings", "0.1:1:-1"],
            "invalid value for --settings: -1; expected a time in seconds",
        ),
        (["--settings", "1:2"], "invalid value for --settings: 1:2; expected a file of times"),
        (["--settings", "1e-6:1:1e-6"], "too many settings (1000000): expected at most 200000"),
        (["--settings", ","], "invalid value for --settings: ,; expected a file of times"),
        (["--gains", "1,2"], "--gains needs --settings; give the shutter times"),
        (
            ["--settings", "1,2,4", "--gains", "0"],
            "invalid value for --gains: 0; expected a gain above 0",
        ),
        (
            ["--settings", "1,2,4", "--gains", ","],
            "invalid value for --gains: ,; expected gains such as 1,2,4",
        ),
        (
            ["--settings", "1,2", "--gains", "1,2", "--total-limit", "9"],
            "--gains cannot be combined with --total-limit",
        ),
    ],
)
def test_invalid_settings_are_one_line(run: Run, arguments: list[str], message: str) -> None:
    ran = run("solve", *arguments)
    assert message in ran.error
    assert ran.status == 2


def write_log_curve(path: Path, dynamic_range: float) -> None:
    """Write constant contrast in so many points that the table equals the closed form."""
    rows = [(dynamic_range ** (k / 200 - 1), k) for k in range(201)]
    path.write_text("\n".join(f"{E} {u}" for E, u in rows))


def test_desired_response_from_a_file_has_its_own_range(run: Run) -> None:
    write_log_curve(Path("desired.txt"), 100)
    arguments = ("evaluate", "--ratios", "1,9", "--no-sensitivity", "--json")
    table = run(*arguments, "--response", "desired.txt").json
    closed = run(*arguments, "--response", "log", "--range", "100").json
    assert table["dynamic_range"] == pytest.approx(100)
    assert table["xi"] == pytest.approx(closed["xi"], rel=0.01)
    assert solved(run, "--response", "desired.txt", "-n", "2", "--bits", "5")["xi"] > 0


@pytest.mark.parametrize(
    ("line", "message", "status"),
    [
        (
            "--response falling.txt",
            "invalid desired response 'falling.txt': u must not decrease",
            1,
        ),
        ("--response one.txt", "one.txt, line 1: expected 2 columns, found 1", 1),
        ("--response none.txt", "none.txt: No such file", 1),
        (
            "--response falling.txt --range 10",
            "--response FILE cannot be combined with --range; the file defines response and range",
            2,
        ),
        ("--response falling.txt --gamma 0.3", "--response FILE cannot be combined with --ga", 2),
        ("--response lug", "unknown response 'lug'; did you mean log", 2),
    ],
)
def test_invalid_desired_response_is_one_line(
    run: Run, line: str, message: str, status: int
) -> None:
    Path("falling.txt").write_text("0.1 0\n0.5 1\n1 0.5\n")
    Path("one.txt").write_text("0.1\n1\n")
    ran = run("solve", *line.split())
    assert message in ran.error
    assert ran.status == status
