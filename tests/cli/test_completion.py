"""What the completion of the shells offers."""

from __future__ import annotations

import pytest
from command_line import Run

from camctl.cli import parameter_types
from camctl.interface.backends import CAMERAS, PANELS
from camctl.sim.scenes.scene import scene_names
from camctl.sim.sensors.sensor import sensor_names


def complete(run: Run, monkeypatch: pytest.MonkeyPatch, line: str) -> list[str]:
    """Return what the Tab key in bash offers after `line`; a file name is offered as <file>."""
    words = line.split(" ")
    monkeypatch.setenv("_CAMCTL_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", line)
    monkeypatch.setenv("COMP_CWORD", str(len(words) - 1))
    ran = run()
    assert ran.err == ""
    offers = [offer.partition(",") for offer in ran.out.splitlines() if offer]
    return ["<file>" if kind == "file" else value for kind, _, value in offers]


@pytest.mark.parametrize(
    ("line", "offers"),
    [
        ("camctl so", ["solve"]),
        ("camctl table ", ["show", "build"]),
        ("camctl help so", ["solve"]),
        ("camctl help table b", ["build"]),
        ("camctl shoot --ra", ["--range", "--ratios"]),
        ("camctl shoot --response ", ["<file>", "linear", "gamma", "log", "auto"]),
        ("camctl solve --response ", ["<file>", "linear", "gamma", "log"]),
        ("camctl solve --response l", ["<file>", "linear", "log"]),
        ("camctl shoot --range ", ["low", "medium", "high", "auto"]),
        ("camctl shoot --scene n", ["<file>", "night-street"]),
        ("camctl shoot --sensor ideal-1", ["<file>", "ideal-12"]),
        ("camctl shoot --camera s", ["sim"]),
        ("camctl menu --panel t", ["terminal"]),
        ("camctl shoot --base ", ["auto"]),
        ("camctl menu --mains ", ["50", "60"]),
        ("camctl shoot --set ob", ["objective="]),
        ("camctl solve --noise-kind ", ["paper", "time", "aperture", "gain"]),
        ("camctl solve --curve ", ["<file>", "srgb", "rec709", "power:"]),
        ("camctl table build --responses log,l", ["log,linear", "log,log"]),
        ("camctl table build --ranges low,m", ["low,medium"]),
        ("camctl shoot --no-such-option ", []),
        ("camctl shot --range so", ["solve"]),
    ],
)
def test_completion_offers_commands_options_and_values(
    run: Run, monkeypatch: pytest.MonkeyPatch, line: str, offers: list[str]
) -> None:
    assert complete(run, monkeypatch, line) == offers


def test_completion_offers_profiles(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    assert complete(run, monkeypatch, "camctl profile show ") == []
    monkeypatch.delenv("_CAMCTL_COMPLETE")
    assert run("calibrate", "delay", "-O", "size=32x24", "--trials", "2").status == 0
    (name,) = [each["name"] for each in run("profile", "list", "--json").json["profiles"]]
    assert complete(run, monkeypatch, "camctl profile show ") == [name]


def test_names_for_completion_are_those_of_the_packages() -> None:
    assert list(parameter_types.SCENE.suggestions()) == sorted(scene_names())
    assert list(parameter_types.SENSOR.suggestions()) == sorted(sensor_names())
    assert (CAMERAS, PANELS) == ("camctl.cameras", "camctl.panels")
