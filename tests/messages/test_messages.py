"""The words of findings and errors: one snapshot for each front end.

    python tests/messages/test_messages.py

writes the snapshot, words.txt, again.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))

from finding_examples import EXAMPLES

from camctl.errors import CamctlError
from camctl.findings import CODES, Finding
from camctl.messages import menu
from camctl.messages.command_line import (
    COMMANDS,
    OPTIONS,
    error_hint,
    finding_line,
    finding_lines,
    with_remedies,
)
from camctl.messages.plain import SENTENCES, sentence

SNAPSHOT = Path(__file__).with_name("words.txt")

_COMMAND_LINE = re.compile(r"(?<!\w)-{1,2}[a-zA-Z][\w-]*\b|\bcamctl [a-z]+")


def words() -> str:
    """Return the words of an example of each code, in the order of the codes.

    Those of the command line and the menu where they are not the library's.
    """
    parts = []
    for code in CODES:
        plain = sentence(EXAMPLES[code])
        lines = [code, f"  plain:        {plain}"]
        fronts = {"command line": finding_line, "menu": menu.finding_text}
        for name, words_of in fronts.items():
            if (text := words_of(EXAMPLES[code])) != plain:
                lines.append(f"  {f'{name}:':13} {text}")
        parts.append("\n".join(lines) + "\n")
    return "\n".join(parts)


def test_every_code_has_a_sentence_and_an_example() -> None:
    assert set(SENTENCES) == set(CODES)
    assert set(EXAMPLES) == set(CODES)


def test_the_words_of_each_front_end_are_those_of_the_snapshot() -> None:
    assert words() == SNAPSHOT.read_text("utf-8")


@pytest.mark.parametrize("finding", EXAMPLES.values(), ids=lambda each: each.code)
def test_python_and_the_menu_name_no_option_and_no_command(finding: Finding) -> None:
    for text in (sentence(finding), menu.finding_text(finding)):
        assert not _COMMAND_LINE.search(text)
        assert "\n" not in text
        assert not text.endswith(".")


def of_file(code: str, name: str, **details: str | float | bool) -> Finding:
    example = EXAMPLES[code]
    found = {**example.details, "file": name, **details}
    return example.model_copy(update={"details": found})


def test_findings_that_say_the_same_of_several_photographs_are_one_line() -> None:
    wrong = [of_file("label_wrong", name, left_out=True) for name in ("c.jpg", "b.jpg", "d.jpg")]
    other = of_file("label_wrong", "e.jpg", left_out=False)
    apart = [of_file("labels_contradict", name, why="tie") for name in ("b.jpg", "f.jpg")]
    unlike = EXAMPLES["highlights_cut"]
    lines = finding_lines([wrong[0], unlike, *wrong[1:], *apart, other, unlike])
    assert lines == [
        "the exposures of 3 photographs are wrong, beside the 5 that agree: b.jpg says 4 s, and "
        "its pixels 0.8 s; c.jpg says 4 s, and its pixels 0.8 s; d.jpg says 4 s, and its pixels "
        "0.8 s: they are left out; correct them (or the light was different in them) "
        "(--times SECONDS,...)",
        finding_line(unlike),
        "b.jpg is 2 times as bright as a.jpg, although exposed 4 times as much; f.jpg is 2 times "
        "as bright as a.jpg, although exposed 4 times as much: one of each two exposures is wrong, "
        "or the light has changed (the photographs do not show which of the two is wrong: the "
        "picture takes their ratio from the pixels) (--times SECONDS,...)",
        finding_line(other),
        finding_line(unlike),
    ]


def test_runs_of_photographs_that_contradict_an_assumed_response_are_one_line() -> None:
    runs = [
        Finding(code="labels_contradict", details={"file": files[0], "files": files})
        for files in ("a.jpg, b.jpg", "c.jpg, d.jpg")
    ]
    (line,) = finding_lines(runs)
    assert line.startswith("the exposures of a.jpg, b.jpg, c.jpg, d.jpg contradict their pixels")


def test_a_small_place_that_moved_is_not_said_to_be_none() -> None:
    small = of_file("moved", "", area=2e-5, single=3e-4)
    assert "in < 0.01 % of the picture" in sentence(small)
    assert "0.03 % of the picture is from" in sentence(small)


def test_every_remedy_is_named_on_the_command_line() -> None:
    for finding in EXAMPLES.values():
        finding_line(finding)
    for name in (*OPTIONS, *COMMANDS, *menu.ENTRIES):
        assert with_remedies("do it", {name: None}).startswith("do it (")


@pytest.mark.parametrize(
    ("remedies", "options"),
    [
        ({}, ""),
        ({"base_s": None}, "--base SECONDS"),
        ({"base_s": False, "table": False}, "without --base, without --set table"),
        ({"table": None}, "--set table=FILE"),
        ({"base_s": 0.004, "count": 4}, "--base 0.004, -n 4"),
        ({"dynamic_range": "auto"}, "--range auto"),
        ({"ratios": (1, 2.5)}, "--ratios 1,2.5"),
        ({"estimate_ratios": True}, "--estimate-ratios"),
        ({"mains_hz": 50}, "--set mains=50"),
        ({"option:format": None, "option:size": "640x480"}, "-O format=..., -O size=640x480"),
        ({"calibrate_delay": None}, "camctl calibrate delay"),
        ({"calibrate_delay": "ptp:1"}, "camctl calibrate delay --camera ptp:1"),
        ({"resume": Path("red hall")}, "camctl resume 'red hall'"),
    ],
)
def test_remedies_are_what_is_typed(remedies: dict[str, object], options: str) -> None:
    error = CamctlError("it failed", hint="help it", remedies=remedies)
    assert error_hint(error) == (f"help it ({options})" if options else "help it")


@pytest.mark.parametrize(
    ("remedies", "text"),
    [
        ({}, "it failed; help it"),
        ({"base_s": None, "option:format": "raw", "calibrate_delay": None}, "it failed; help it"),
        ({"dynamic_range": "auto"}, "it failed; help it (menu: Dynamic range, Auto)"),
        ({"dynamic_range": 256.0}, "it failed; help it (menu: Dynamic range)"),
        ({"resume": "hall"}, "it failed; help it (menu: Captures)"),
        ({"count": 4, "cameras": None}, "it failed; help it (menu: Exposures; Camera)"),
    ],
)
def test_the_menu_names_its_entries(remedies: dict[str, object], text: str) -> None:
    assert menu.error_text(CamctlError("it failed", hint="help it", remedies=remedies)) == text


def test_the_entries_are_those_of_the_menu() -> None:
    from camctl.menu import entries
    from camctl.menu.tables import STATES

    labels = {label for each in entries.MAIN_MENU for label in each.labels}
    titles = {title for spec in STATES.values() for title in spec.title}
    assert {entry.partition(",")[0] for entry in menu.ENTRIES.values()} <= labels | titles
    lists = {"response": entries.RESPONSES, "dynamic_range": entries.RANGES}
    for (name, _), label in menu.VALUES.items():
        assert label in {text for each in lists[name] for text in each.labels}


if __name__ == "__main__":
    SNAPSHOT.write_text(words(), "utf-8")
