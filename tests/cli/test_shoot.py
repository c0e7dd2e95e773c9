"""`camctl shoot` on the simulated camera."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import Run

from camctl.profiles import calibrated
from camctl.sim.camera import Faults, SimulatedCamera
from camctl.sim.scenes.scene import load_scene
from camctl.sim.sensors.sensor import load_sensor

SMALL = ("-O", "size=64x48")
RESULT = {
    "sum.tiff",
    "image.tiff",
    "radiance.exr",
    "preview.png",
    "picture.jpg",
    "contact.png",
    "report.json",
    "frames",
}
if find_spec("imagecodecs"):
    RESULT.add("picture.avif")
LOCK = ".camctl.lock"


def shot(run: Run, *arguments: str | Path) -> Any:
    """Return the JSON output of a capture of small frames."""
    return run("shoot", *SMALL, *arguments, "--json").json


def test_shoot_without_options_takes_a_picture(run: Run) -> None:
    ran = run("shoot")
    assert ran.status == 0
    (folder,) = Path().iterdir()
    assert folder.name.startswith("capture-20")
    assert {path.name for path in folder.iterdir()} - {LOCK} == RESULT
    report = json.loads((folder / "report.json").read_text())
    assert report["plan"]["response"] == "log"
    assert report["request"] == {}
    light, span = report["plan"]["light"], report["plan"]["dynamic_range"]
    assert light["needed"] <= span <= 2 * light["needed"]
    count = len(report["frames"])
    assert count > 3  # more time than they take brings no more than averaging
    assert report["camera"]["id"] == "sim"
    for text in (
        f"log, 1:{span:,.0f}, in {count} exposures",
        "the scene spans",
        "effective levels",
        str(folder),
        "sum.tiff",
    ):
        assert text in ran.out
    levels = re.search(
        r"time / accuracy .* ([\d.]+) levels, .* ([\d.]+) .this., .* ([\d.]+)", ran.out
    )
    assert levels is not None
    half, this, double = map(float, levels.groups())
    assert this == pytest.approx(report["plan"]["effective_levels"], rel=0.01)
    assert 1.2 * half < this < double / 1.2
    assert ran.err == ""


def test_json_output_is_the_report(run: Run) -> None:
    report = shot(run, "-o", "here", "--range", "low", "-n", "2")
    assert report == json.loads(Path("here/report.json").read_text())
    assert {"make", "model", "serial", "driver"} <= set(report["camera"])
    plan = {"response", "dynamic_range", "ratios", "base_s", "xi", "effective_levels"}
    assert plan <= set(report["plan"])
    frame = {"file", "requested_s", "applied_s", "exposure", "black", "white"}
    frame |= {"saturated_fraction", "timestamp_s"}
    for each in report["frames"]:
        assert frame <= set(each)
    assert {"xi", "effective_levels", "levels", "levels_distinct"} <= set(report["achieved"])
    assert report["timing"]
    assert report["files"]


def test_options_reach_plan_and_request(run: Run) -> None:
    report = shot(run, "-o", "a", "--ratios", "4,1,2", "--base", "1/500", "--set", "levels=300")
    assert report["plan"]["ratios"] == [1, 2, 4]
    assert report["plan"]["base_s"] == pytest.approx(1 / 500)
    assert report["plan"]["levels_wanted"] == 300
    applied = [each["applied_s"] for each in report["frames"]]
    assert applied == pytest.approx([0.002, 0.004, 0.008])
    longer = shot(run, "-o", "b", "--ratios", "1,2", "--base", "0.002", "--compensation", "2")
    assert longer["plan"]["base_s"] == pytest.approx(0.008)
    flicker = shot(run, "-o", "c", "--ratios", "1,2", "--set", "mains=50")
    assert flicker["request"]["mains_hz"] == 50
    assert (
        shot(run, "-o", "d", "--ratios", "1,2", "--set", "aperture=yes")["request"]["use_aperture"]
        is True
    )
    assert shot(run, "-o", "e", "--ratios", "1,2", "--meter")["request"]["spend_shutter"] is True


def test_desired_response_comes_from_a_file(run: Run) -> None:
    rows = [(0.01, 0.0), (0.1, 0.7), (1.0, 1.0)]
    Path("desired.txt").write_text("\n".join(f"{E} {u}" for E, u in rows))
    arguments = ("--sensor", "ideal-4", "-n", "2", "--set", "objective=xi")
    report = shot(run, *arguments, "--response", "desired.txt", "-o", "a")
    assert report["request"]["response"] == "curve"
    assert report["request"]["desired_curve"] == [list(row) for row in rows]
    assert report["plan"]["dynamic_range"] == pytest.approx(100)
    found = run(*("solve", "--bits", "4", "--response", "desired.txt", "-n", "2", "--json")).json
    assert report["plan"]["ratios"] == pytest.approx(found["exposures"])
    again = json.loads(Path("a/report.json").read_text())
    Path("a/report.json").write_text(json.dumps({**again, "status": "incomplete"}))
    Path("a/frames/frame-02.npy").unlink()
    assert run("resume", "a", "--json").json["plan"] == report["plan"]


def test_warnings_go_to_standard_error(run: Run) -> None:
    ran = run("shoot", *SMALL, "--base", "1/500", "--ratios", "1,2", "--set", "mains=50", "--json")
    assert ran.json["warnings"]
    for warning in ran.json["warnings"]:
        assert f"camctl: warning: {warning}" in ran.err  # options that help may follow


def test_two_captures_in_one_second_get_two_folders(run: Run) -> None:
    for _ in range(2):
        assert run("shoot", *SMALL, "--ratios", "1", "--base", "0.01").status == 0
    assert len(list(Path().iterdir())) == 2


def test_earlier_capture_is_replaced_only_with_force(run: Run) -> None:
    shot(run, "--ratios", "1,4", "-o", "here", "-O", "seed=1")
    before = Path("here/sum.tiff").read_bytes()
    ran = run("shoot", *SMALL, "-o", "here", "-O", "seed=2")
    assert ran.status == 1
    assert "here is not empty" in ran.error
    assert "--force" in ran.error
    assert Path("here/sum.tiff").read_bytes() == before
    shot(run, "--ratios", "1,4", "-o", "here", "-O", "seed=2", "--force")
    assert Path("here/sum.tiff").read_bytes() != before


class FaultyBackend:
    """The simulated camera, with faults the first time it is opened."""

    local_address = ""
    faults: Faults | None = None

    def open(self, address: str, options: Mapping[str, str]) -> SimulatedCamera:
        faults, FaultyBackend.faults = FaultyBackend.faults, None
        scene = load_scene("tile-floor", (48, 64))
        seed = int(options.get("seed", "0"))
        return SimulatedCamera(scene, load_sensor("standard"), seed=seed, faults=faults)


def test_untrustworthy_capture_ends_with_status_3(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(calibrated, "load", lambda *_: FaultyBackend)
    wrong = Faults(wrong_exposure=dict.fromkeys((1, 3, 4, 5), 0.25))
    FaultyBackend.faults = wrong
    ran = run("shoot", "--ratios", "1,2,4", "-o", "here", "--json")
    assert ran.status == 3
    assert ran.json["trustworthy"] is False
    assert f"warning: not trustworthy: {ran.json['untrustworthy_because']}" in ran.err
    assert {path.name for path in Path("here").iterdir()} >= set(ran.json["files"].values())
    FaultyBackend.faults = wrong
    ran = run("shoot", "--ratios", "1,2,4", "-o", "there")
    assert ran.status == 3
    assert "\nnot trustworthy " in ran.out


def test_a_frame_shot_again_and_a_fault_that_did_not_happen_are_named(run: Run) -> None:
    ran = run(
        "shoot", "-O", "size=160x120", "-O", "faults=wrong@1=0.5,drop@19,unplug@17", "-o", "here"
    )
    assert ran.status == 0
    assert "\nshot again           frame 2: the first one did not fit" in ran.out
    assert "fewer frames were taken: unplug@17, drop@19\n" in ran.err
    ran = run("shoot", "-O", "size=160x120", "-O", "faults=drop@1,clamp=60", "-o", "there")
    assert "shot again" not in ran.out
    assert "fault" not in ran.err


def test_complete_capture_is_reported_without_its_camera(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    shot(run, "-o", "here")

    def refuse(*_: object) -> None:
        raise AssertionError("the camera must not be opened")

    monkeypatch.setattr(calibrated, "open_camera", refuse)
    assert "the capture in here is complete" in run("resume", "here").error


def test_resume_needs_the_camera_in_the_report(run: Run) -> None:
    shot(run, "-o", "here")
    report = json.loads(Path("here/report.json").read_text())
    report |= {"status": "incomplete", "source": {}}
    Path("here/report.json").write_text(json.dumps(report))
    ran = run("resume", "here")
    assert ran.error.startswith("here/report.json does not name the camera to open; ")
    assert ran.status == 1


def test_scene_name_is_kept_even_if_a_file_has_that_name(run: Run) -> None:
    Path("room").write_text("no scene")
    assert (
        shot(run, "--scene", "room", "--ratios", "1,4", "-o", "here")["source"]["options"]["scene"]
        == "room"
    )


def test_varying_control_delay_is_reported_once(run: Run) -> None:
    line = ("shoot", *SMALL, "--ratios", "1,4")
    ran = run(*line, "--sensor", "consumer", "-o", "here", "--json")
    (note,) = [warning for warning in ran.json["warnings"] if "settles" in warning]
    assert "not constant" in note
    assert ran.err.count(note) == 1
    assert "settles" not in run(*line, "-o", "steady").err


def test_report_has_the_full_path_of_a_scene_file(run: Run) -> None:
    np.save("map.npy", np.geomspace(1, 100, 48 * 64).reshape(48, 64))
    report = run("shoot", "--scene", "map.npy", "--ratios", "1,4", "-o", "here", "--json").json
    assert report["source"]["options"]["scene"] == str(Path("map.npy").resolve())


HDR = np.ones((4, 4), dtype=np.float32)


@pytest.mark.parametrize(
    ("line", "message", "status"),
    [
        ("--camera smi", "unknown camera 'smi'; did you mean sim?", 2),
        ("--camera sim:7", "no camera sim:7", 1),
        ("--scene tile-flor", "unknown scene 'tile-flor'; did you mean tile-floor", 2),
        ("--scene missing.hdr", "missing.hdr", 1),
        ("--scene nan.npy", "scene nan.npy: 1 of 16 pixels is NaN", 1),
        ("--scene negative.npy", "1 of 16 pixels is negative", 1),
        ("--scene dark.npy", "scene dark.npy: all pixels are 0; a scene needs some light", 1),
        ("--sensor fone", "unknown sensor 'fone'; did you mean phone", 2),
        ("--sensor bad.json", "bad.json: not JSON", 1),
        ("--base 100", "beyond the camera's", 2),
        ("--base 10 --ratios 1,1000", "is beyond the camera's controls", 2),
        ("-o dark.npy/x", "cannot write", 1),
    ],
)
def test_impossible_capture_is_one_line_and_leaves_nothing(
    run: Run, line: str, message: str, status: int
) -> None:
    for name, value in (("nan", np.nan), ("negative", -1.0)):
        light = HDR.copy()
        light[1, 2] = value
        np.save(f"{name}.npy", light)
    np.save("dark.npy", 0 * HDR)
    Path("bad.json").write_text("{")
    Path("damaged").mkdir()
    Path("damaged/report.json").write_text('{"status": "complete"}')
    before = {path.name for path in Path().iterdir()}
    ran = run("shoot", *line.split())
    assert message in ran.error
    assert ran.status == status
    assert {path.name for path in Path().iterdir()} == before


@pytest.mark.parametrize(
    ("ratios", "row"),
    [
        ("1", None),  # one frame is its own sum
        ("1,2", "estimated from all frames; computed from their sum, it would be as accurate"),
    ],
)
def test_the_summary_compares_the_light_with_the_light_of_a_sum(
    run: Run, ratios: str, row: str | None
) -> None:
    ran = run("shoot", *SMALL, "-O", "sensor=ideal-6", "--base", "0.02", "--ratios", ratios)
    assert re.findall(r"^radiance +(.*)$", ran.out, re.MULTILINE) == ([row] if row else [])
