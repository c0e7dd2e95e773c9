"""shoot and menu with a camera that has no preview and a dial of third stops."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from still_fakes import StillCamera, ramp

from camctl import backends as registry

if TYPE_CHECKING:
    from conftest import Run


class StillRoad:
    """Opens `ptp` with the options a road of still cameras might have."""

    opened: StillCamera

    def open(self, address: str, options: Mapping[str, str]) -> StillCamera:
        kind = {"jpeg": ("srgb", 8, 0), "raw": ("linear", 10, 64)}[options.get("format", "jpeg")]
        camera = StillCamera(ramp(20.0), response=kind[0], bits=kind[1], black=kind[2])
        StillRoad.opened = camera.open()
        return StillRoad.opened


@pytest.fixture(autouse=True)
def road(monkeypatch: pytest.MonkeyPatch) -> type[StillRoad]:
    load = registry.load

    def with_stills(group: str, kind: str, name: str) -> object:
        return StillRoad if name == "ptp" else load(group, kind, name)

    monkeypatch.setattr(registry, "load", with_stills)
    return StillRoad


def test_metering_is_asked_for_in_words(run: Run, road: type[StillRoad]) -> None:
    ran = run("shoot", "--camera", "ptp:77", "-o", "here")
    assert ran.status == 2
    assert "has no preview" in ran.error
    assert "--meter" in ran.error
    assert "--base SECONDS" in ran.error
    assert road.opened.actuations == 0
    assert not Path("here").exists()


@pytest.mark.parametrize("how", [("--meter",), ("--base", "1/30")])
def test_shoot(run: Run, road: type[StillRoad], how: tuple[str, ...]) -> None:
    told = run("shoot", "--camera", "ptp:77", "-O", "format=raw", *how, "-o", "here", "--json").json
    assert told["source"] == {"camera": "ptp:77", "options": {"format": "raw"}}
    assert told["status"] == "complete"
    assert (told["white"], told["black_total"]) == (1023, 3 * 64)
    for frame in told["frames"]:
        assert Path("here", frame["original"]).suffix == ".png"
    metered = told["plan"]["metering"]["frames"] if how == ("--meter",) else 0
    assert road.opened.actuations == 3 + metered


def test_resume_opens_it_in_the_same_format(run: Run, road: type[StillRoad]) -> None:
    words = ("shoot", "--camera", "ptp:77", "-O", "format=raw", "--base", "1/30", "-o", "here")
    assert run(*words).status == 0
    report = json.loads(Path("here/report.json").read_text())
    report["frames"][1], report["status"] = None, "incomplete"
    Path("here/report.json").write_text(json.dumps(report))
    again = run("shoot", "--resume", "here", "--json").json
    assert again["status"] == "complete"
    assert road.opened.actuations == 1
    assert road.opened.controls.bits == 10


def test_the_menu_says_that_metering_needs_leave_or_meters(
    run: Run, road: type[StillRoad], monkeypatch: pytest.MonkeyPatch
) -> None:
    import menu.app
    from menu.ports import Choice, Job, Summary

    def picked(panel: object, job: Job) -> Summary:
        costs = list(job.predict("log", 256.0))
        assert [cost.count for cost in costs] == [1, 2, 3, 4, 5, 6]
        return job.shoot(job.plan(Choice("log", 256.0, 2)), lambda _: None, lambda: False)

    monkeypatch.setattr(menu.app, "run", picked)
    words = ("menu", "--camera", "ptp:77", "-o", "pictures")
    refused = run(*words)
    assert refused.status == 2
    assert "--meter" in refused.error
    assert run(*words, "--meter").status == 0
    (folder,) = Path("pictures").iterdir()
    assert json.loads((folder / "report.json").read_text())["request"]["spend_shutter"] is True
    assert road.opened.actuations >= 3
