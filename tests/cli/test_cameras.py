"""The real camera as options describe it: its curve, the times it has, its gains."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from conftest import Run

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


def solved(run: Run, *words: str | Path) -> Any:
    return run("solve", *words, "--json").json


def test_a_response_model_gives_its_mean_and_more(run: Run) -> None:
    Path("model").write_text(MODEL)
    Path("curve").write_text("0 0\n0.25 0.3\n0.5 0.6\n0.75 0.8\n1 1\n")
    Path("other").write_text("0 0\n0.25 0.45\n0.5 0.65\n0.75 0.8\n1 1\n")
    words = ("evaluate", "--ratios", "1,3", "--bits", "4", "--json", "--curve")
    for curve, coefficients in (("curve", "0"), ("other", "1,-0.5")):
        plain = run(*words, curve).json
        told = run(*words, "model", "--coefficients", coefficients).json
        assert told["xi"] == pytest.approx(plain["xi"], rel=1e-9)
        assert told["camera"] == f"model {coefficients} 4 bit"


def test_the_empirical_model_itself(run: Run, real_data: Path) -> None:
    emor = real_data / "emor.txt"
    for response in ("linear", "gamma", "log"):
        told = solved(
            run,
            *("--curve", emor, "--coefficients", "1.5,-0.3"),
            *("-n", "2", "--bits", "5", "--response", response),
        )
        assert told["camera"] == "emor.txt 1.5,-0.3 5 bit"
        assert 0 < told["xi"] < 62


def test_power_curves(run: Run) -> None:
    words = ("evaluate", "--ratios", "1,3", "--bits", "4", "--json", "--curve")
    assert run(*words, "power:2.2").json["camera"] == "power 1/2.2 4 bit"
    linear = run(*words[:-1]).json["xi"]
    assert run(*words, "power:1").json["xi"] == pytest.approx(linear)


@pytest.mark.parametrize(
    ("text", "words", "message", "status"),
    [
        (MODEL, [], "curve c is a response model, not one curve; say --coefficients", 1),
        ("0 0\n1 1\n", ["--coefficients", "1"], "curve c is no response model; --coeffici", 1),
        (MODEL, ["--coefficients", "1,2,3"], "the response model has 2 components, not 3", 2),
        (MODEL, ["--coefficients", "90"], "take --coefficients nearer to 0, the mean", 1),
        (MODEL, ["--coefficients", "nan"], "--coefficients: nan is not finite", 2),
        (MODEL, ["--coefficients", "a"], "--coefficients: 'a' is not a number", 2),
        (MODEL, ["--coefficients", ","], "--coefficients: no numbers; for example", 2),
        (
            "E =\n0 1\nf0 =\n0 x\n",
            ["--coefficients", "0"],
            "line 4: '0 x' is not a row of numbers",
            1,
        ),
        ("E =\n0 1\nf0 =\n0\n", ["--coefficients", "0"], "block 'f0' has 1 numbers, expected 2", 1),
        ("E =\n0 1\n", ["--coefficients", "0"], "response model c: the block 'f0 =' is missing", 1),
        ("0 0\n1 inf\n", [], "row 2 contains a number that is not finite", 1),
        ("0 0\nnan 1\n", [], "row 2 contains a number that is not finite", 1),
        ("-1 0\n1 1\n", [], "irradiance -1 is negative", 1),
        ("0 0 0\n1 1 1\n", [], "curve c, line 1: expected 2 columns, found 3", 1),
        ("0 0\n", [], "expected two or more rows of irradiance and brightness", 1),
        ("", [], "curve c: the file contains no numbers", 1),
        ("0 0\n1 1", ["--bits", "17"], "--bits: 17 is not a whole number of bits", 2),
    ],
)
def test_a_curve_that_cannot_be_gets_one_line(
    run: Run, text: str, words: list[str], message: str, status: int
) -> None:
    Path("c").write_text(text)
    ran = run("evaluate", "--ratios", "1,2", "--curve", "c", *words)
    assert message in ran.error
    assert ran.status == status


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--coefficients", "1"], "--coefficients needs --curve; name the response model"),
        (["--curve", "power"], "--curve power lacks its gamma; for example power:2.2"),
        (["--curve", "power:0"], "--curve power: 0 is not a gamma from 0.05 to 20"),
        (["--curve", "power:99"], "invalid gamma 99 of a power response: expected 0.05 to 20"),
    ],
)
def test_a_curve_named_wrongly(run: Run, words: list[str], message: str) -> None:
    ran = run("evaluate", "--ratios", "1,2", *words)
    assert message in ran.error
    assert ran.status == 2


def test_a_curve_that_is_no_text_or_not_there(run: Run) -> None:
    Path("c").write_bytes(b"\xff\xfe\x00")
    assert "curve c: " in run("solve", "--curve", "c").error
    assert "curve .: " in run("solve", "--curve", ".").error
    ran = run("solve", "--curve", "nix", "--coefficients", "1")
    assert "no response model 'nix'" in ran.error


def test_fewer_samples_than_levels_is_said(run: Run) -> None:
    Path("c").write_text("0 0\n0.5 0.7\n1 1\n")
    ran = run("solve", "--curve", "c", "-n", "2", "--bits", "4", "--json")
    assert ran.status == 0
    assert "warning: 3 samples for 15 levels" in ran.err
    assert ran.err.count("\n") == 1


def test_a_dial_against_the_ideal(run: Run) -> None:
    """A third-stop dial: what it can do in effective levels, beside what any times could."""
    times = [2.0 ** (round(3 * math.log2(label)) / 3) for label in DIAL]  # the true times
    Path("dial").write_text("\n".join(f"{time:.9g}" for time in times))
    words = ("--settings", "dial", "-n", "3", "--bits", "6", "--response", "linear")
    told = solved(run, *words)
    assert told["every_set_tried"] is True
    assert told["xi"] >= told["without_settings"]["xi"]
    assert told["shutter_s"] == pytest.approx(sum(told["settings_s"]))
    assert told["gains"] == [1, 1, 1]
    text = run("solve", *words).out
    share = 100 * told["effective_levels"] / told["without_settings"]["effective_levels"]
    assert f"the camera's own settings keep {share:.3g} % of these levels" in text
    assert "(xi), " in text


def test_even_steps_are_the_same_as_a_file_of_them(run: Run) -> None:
    Path("file").write_text("\n".join(f"{k}e-2" for k in range(1, 21)))
    words = ("-n", "2", "--bits", "5")
    listed = solved(run, *words, "--settings", "file")
    stepped = solved(run, *words, "--settings", "0.01:1/5:0.01")
    assert stepped["settings_s"] == pytest.approx(listed["settings_s"])
    assert stepped["xi"] == pytest.approx(listed["xi"])
    named = solved(run, *words, "--settings", "1/100,1/50,0.2")
    assert set(named["settings_s"]) <= {0.01, 0.02, 0.2}


def test_gains_reach_beyond_the_times(run: Run) -> None:
    words = ("-n", "2", "--bits", "5", "--range", "high", "--settings", "0.01:0.05:0.01")
    timed = solved(run, *words)
    gained = solved(run, *words, "--gains", "1,4,16")
    assert gained["xi"] < timed["xi"]
    products = [
        time_s * gain for time_s, gain in zip(gained["settings_s"], gained["gains"], strict=True)
    ]
    assert [product / products[0] for product in products] == pytest.approx(gained["exposures"])
    assert set(gained["gains"]) <= {1, 4, 16}
    assert all(0.01 <= time_s <= 0.0500001 for time_s in gained["settings_s"])
    assert gained["shutter_s"] < gained["total_exposure"] * gained["settings_s"][0]
    assert solved(run, *words, "--gains", "1:16:5")["gains"][-1] in (1, 6, 11, 16)
    text = run("solve", *words, "--gains", "1,4,16").out
    assert f"{gained['settings_s'][0] * 1e3:g} ms x 1  " in text


def test_the_least_gain_makes_an_exposure(run: Run) -> None:
    """2 s x 1 rather than 1 s x 2: gain adds noise."""
    told = solved(run, "-n", "2", "--bits", "4", "--settings", "1,2", "--gains", "2,1")
    for time_s, gain in zip(told["settings_s"], told["gains"], strict=True):
        if math.isclose(time_s * gain, 2):
            assert (time_s, gain) == (2, 1)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["--settings", "1:0.1:0.1"],
            "invalid settings 1 to 0.1 in steps of 0.1: expected 0 < minimum",
        ),
        (["--settings", "0.1:1:0"], "--settings: 0 is not a time in seconds"),
        (["--settings", "0.1:1:-1"], "--settings: -1 is not a time in seconds"),
        (["--settings", "1:2"], "--settings: '1:2' is not a file of times"),
        (["--settings", "1:2:x"], "--settings: 'x' is not a time in seconds"),
        (["--settings", "1e-6:1:1e-6"], "too many settings (1000000): expected at most 200000"),
        (["--settings", ","], "--settings: ',' is not a file of times"),
        (["--gains", "1,2"], "--gains needs --settings; say which shutter times"),
        (["--settings", "1,2,4", "--gains", "0"], "--gains: 0 is not a gain above 0"),
        (["--settings", "1,2,4", "--gains", ","], "--gains: ',' is not gains such as 1,2,4"),
        (["--settings", "1,2", "--gains", "1,2", "--total-limit", "9"], "--gains goes without"),
        (
            ["--settings", "1,2", "-n", "3"],
            "3 different exposures cannot be chosen from 2 settings",
        ),
    ],
)
def test_settings_that_cannot_be(run: Run, words: list[str], message: str) -> None:
    ran = run("solve", *words)
    assert message in ran.error
    assert ran.status == 2


def test_a_wish_from_a_file_brings_its_own_range(run: Run) -> None:
    # Constant contrast over 1:100 in so many points that it is the closed form.
    rows = [(10 ** (k / 100 - 2), k) for k in range(201)]
    Path("wish.txt").write_text("\n".join(f"{E} {u}" for E, u in rows))
    words = ("evaluate", "--ratios", "1,9", "--no-sensitivity", "--json")
    told = run(*words, "--response", "wish.txt").json
    closed = run(*words, "--response", "log", "--range", "100").json
    assert told["dynamic_range"] == pytest.approx(100)
    assert told["xi"] == pytest.approx(closed["xi"], rel=0.01)
    assert solved(run, "--response", "wish.txt", "-n", "2", "--bits", "5")["xi"] > 0


def test_bad_wishes_are_told_in_one_line(run: Run) -> None:
    Path("falling.txt").write_text("0.1 0\n0.5 1\n1 0.5\n")
    Path("one.txt").write_text("0.1\n1\n")
    for words, said in (
        (("falling.txt",), "u must not decrease"),
        (("one.txt",), "line 1: expected 2 columns, found 1"),
        (("none.txt",), "No such file"),
        (("falling.txt", "--range", "10"), "brings its own range"),
        (("lug",), "did you mean log"),
    ):
        done = run("solve", "--response", *words)
        assert done.status in (1, 2)
        assert said in done.err
        assert done.err.count("\n") == 1
