"""`camctl shoot` and `menu` with a camera without preview, with a dial in thirds of a stop."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest
from command_line import Run
from still_fakes import StillCamera, ramp

from camctl.interface import backends
from camctl.profiles import calibrated


class StillBackend:
    """Opens a still camera with an option as backends of still cameras have."""

    opened: StillCamera

    local_address = r"\d+"

    def open(self, address: str, options: Mapping[str, str]) -> StillCamera:
        kind = {"jpeg": ("srgb", 8, 0), "raw": ("linear", 10, 64)}[options.get("format", "jpeg")]
        camera = StillCamera(ramp(20.0), response=kind[0], bits=kind[1], black=kind[2])
        StillBackend.opened = camera.open()
        return StillBackend.opened


@pytest.fixture(autouse=True)
def still_backend(monkeypatch: pytest.MonkeyPatch) -> type[StillBackend]:
    load = backends.load

    def with_stills(group: str, kind: str, name: str) -> object:
        return StillBackend if name == "ptp" else load(group, kind, name)

    monkeypatch.setattr(calibrated, "load", with_stills)
    return StillBackend


def test_metering_needs_an_option(run: Run, still_backend: type[StillBackend]) -> None:
    ran = run("shoot", "--camera", "ptp:77", "-o", "here")
    assert ran.status == 2
    assert "has no preview" in ran.error
    assert "--meter" in ran.error
    assert "--base" in ran.error
    assert still_backend.opened.actuations == 0
    assert not Path("here").exists()


@pytest.mark.parametrize("how", [("--meter",), ("--base", "1/30")])
def test_shoot_with_metering_or_given_base(
    run: Run, still_backend: type[StillBackend], how: tuple[str, ...]
) -> None:
    report = run(
        "shoot",
        "--camera",
        "ptp:77",
        "-O",
        "format=raw",
        "--ratios",
        "1,4,16",
        *how,
        "-o",
        "here",
        "--json",
    ).json
    assert report["source"] == {"camera": "ptp:77", "options": {"format": "raw"}}
    assert report["status"] == "complete"
    assert (report["frames"][0]["white"], report["black_total"]) == (1023, 3 * 64)
    for frame in report["frames"]:
        assert Path("here", frame["original"]).suffix == ".png"
    metered = report["plan"]["metering"]["frames"] if how == ("--meter",) else 0
    assert still_backend.opened.actuations == 3 + metered


def test_resume_opens_the_camera_with_the_same_format(
    run: Run, still_backend: type[StillBackend]
) -> None:
    arguments = (
        "shoot",
        "--camera",
        "ptp:77",
        "-O",
        "format=raw",
        "--base",
        "1/30",
        "--ratios",
        "1,4,16",
        "-o",
        "here",
    )
    assert run(*arguments).status == 0
    report = json.loads(Path("here/report.json").read_text())
    report["status"] = "incomplete"
    Path("here/frames/frame-02.npy").unlink()
    Path("here/report.json").write_text(json.dumps(report))
    again = run("resume", "here", "--json").json
    assert again["status"] == "complete"
    assert still_backend.opened.actuations == 1
    assert still_backend.opened.controls.bits == 10


def test_menu_meters_only_with_the_option(
    run: Run, still_backend: type[StillBackend], monkeypatch: pytest.MonkeyPatch
) -> None:
    from camctl.menu import app
    from camctl.menu.data import Choice, Summary
    from camctl.menu.ports import Job

    def shoot_at_once(panel: object, make_job: Callable[[], Job]) -> Summary:
        job = make_job()
        job.open("ptp:77")
        try:
            plan = job.plan(Choice("log", 256.0, 2), lambda: False)
            return job.shoot(plan, lambda _: None, lambda: False)
        finally:
            job.close()

    monkeypatch.setattr(app, "run", shoot_at_once)
    arguments = ("menu", "--camera", "ptp:77", "-o", "pictures")
    refused = run(*arguments)
    assert refused.status == 2
    assert "--meter" in refused.error
    assert run(*arguments, "--meter").status == 0
    (folder,) = Path("pictures").iterdir()
    assert json.loads((folder / "report.json").read_text())["request"]["spend_shutter"] is True
    assert still_backend.opened.actuations >= 3
