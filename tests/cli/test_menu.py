"""`camctl menu`: what it refuses, and the job that it gives to the menu."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from command_line import Run

from camctl.menu import app
from camctl.menu.data import Choice, Summary
from camctl.menu.ports import Job

SMALL = ("-O", "size=64x48")


def test_menu_needs_a_terminal(run: Run) -> None:
    ran = run("menu", *SMALL)
    assert ran.status == 2
    assert ran.error == ("the terminal panel needs a terminal; run it without pipes or redirection")


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("--panel", "termnal", "unknown panel 'termnal'; did you mean terminal?"),
        ("--panel", "terminal:7", "panel 'terminal' takes no address; use --panel terminal"),
        ("--camera", "smi", "unknown camera 'smi'"),
    ],
)
def test_usage_error_of_menu_is_one_line(run: Run, option: str, value: str, message: str) -> None:
    ran = run("menu", option, value)
    assert message in ran.error
    assert ran.status == 2


@pytest.mark.parametrize("folder", ["picture.png", "picture.png/in"])
def test_a_file_in_place_of_the_folder_is_refused_before_anything_is_shot(
    run: Run, folder: str
) -> None:
    Path("picture.png").touch()
    ran = run("menu", *SMALL, "-o", folder)
    advice = "a part of the path is a file; choose another folder (-o PATH)"
    assert (ran.status, ran.error) == (1, f"cannot write {folder}: {advice}")


def test_menu_shoots_into_the_given_folder(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def shoot_at_once(panel: object, make_job: Callable[[], Job]) -> Summary:
        job = make_job()
        plan = job.plan(Choice("log", 256.0, 2), lambda: False)
        return job.shoot(plan, lambda _: None, lambda: False)

    monkeypatch.setattr(app, "run", shoot_at_once)
    ran = run("menu", *SMALL, "-o", "pictures", "--mains", "50")
    assert ran.status == 0, ran.err
    (folder,) = Path("pictures").iterdir()
    assert ran.out == f"the last picture is in {folder}\n"
    report = json.loads((folder / "report.json").read_text())
    assert report["source"] == {"camera": "sim", "options": {"size": "64x48"}}
    assert report["request"]["mains_hz"] == 50
    assert len(report["frames"]) == 2
