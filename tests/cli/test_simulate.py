"""`camctl simulate`: frames, brackets, tolerance, explanations, and what it refuses."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from command_line import Run

from camctl.sim.effects import effect_names

SMALL = ("--size", "64x48")


def decisions(output: dict[str, Any]) -> dict[str, bool]:
    """Return for each effect whether it was simulated."""
    return {effect["name"]: effect["ran"] for effect in output["effects"]}


def test_json_output_describes_frame_and_effects(run: Run) -> None:
    output = run("simulate", *SMALL, "--json").json
    assert {"tolerance_dn", "joint_bound_dn", "effects", "seconds"} <= set(output)
    for effect in output["effects"]:
        assert set(effect) == {
            "name",
            "bound_dn",
            "own_dn",
            "ran",
            "why",
            "lacking",
            "milliseconds",
        }
    assert decisions(output)["photon noise"]
    assert not decisions(output)["colour mosaic"]
    assert (output["width"], output["height"]) == (64, 48)
    ideal = run("simulate", *SMALL, "--sensor", "ideal-6", "--json").json
    assert not decisions(ideal)["photon noise"]


@pytest.mark.parametrize("suffix", ["tiff", "png", "npy"])
@pytest.mark.parametrize(("sensor", "scene"), [("machine-vision", "ramp"), ("consumer", "colour")])
def test_file_holds_the_frame(run: Run, suffix: str, sensor: str, scene: str) -> None:
    if scene == "colour":
        scene = "colour.npy"
        np.save(scene, np.random.default_rng(1).uniform(1, 9, (48, 64, 3)))
    size = () if scene == "colour.npy" else SMALL
    arguments = ("simulate", "--sensor", sensor, "--scene", scene, *size, "--seed", "3")
    output = run(*arguments, "-o", f"frame.{suffix}", "--json").json
    readers: dict[str, Callable[[str], Any]] = {
        "tiff": tifffile.imread,
        "png": partial(cv2.imread, flags=cv2.IMREAD_UNCHANGED),
        "npy": np.load,
    }
    pixels = readers[suffix](f"frame.{suffix}")
    assert output["file"] == f"frame.{suffix}"
    assert (int(pixels.min()), int(pixels.max())) == (output["minimum"], output["maximum"])
    assert pixels.mean() == pytest.approx(output["mean"])
    run(*arguments, "-o", "same.npy")
    rgb = pixels[..., ::-1] if suffix == "png" and pixels.ndim == 3 else pixels
    assert np.array_equal(rgb, np.load("same.npy"))


def test_text_output_describes_the_frame(run: Run) -> None:
    ran = run("simulate", *SMALL, "--time", "1/50")
    for text in ("64 x 48, mono", "20 ms, gain 1", "photon noise", "none; -o FILE writes one"):
        assert text in ran.out
    plain = run("simulate", *SMALL, "--sensor", "standard")
    named = re.search("^not modelled +(.*)$", plain.out, re.MULTILINE)
    assert named is not None
    assert {"PRNU", "dark current"}.issubset(named[1].split(", "))
    assert ran.err == ""


def test_nearest_setting_is_used_with_a_warning(run: Run) -> None:
    ran = run("simulate", *SMALL, "--time", "0.0100049", "--json")
    assert ran.json["time_s"] == pytest.approx(0.01)
    assert "warning: the sensor has no shutter time of 0.0100049; 0.01 is used\n" in ran.err


def test_existing_file_is_replaced_only_with_force(run: Run) -> None:
    Path("a.npy").write_text("mine")
    ran = run("simulate", *SMALL, "-o", "a.npy")
    assert ran.status == 1
    assert ran.error == "a.npy exists; choose another file, or have it replaced (--force)"
    assert Path("a.npy").read_text() == "mine"
    assert run("simulate", *SMALL, "-o", "a.npy", "--force").status == 0
    assert "unknown file type '.jpg'" in run("simulate", "-o", "a.jpg").error
    assert "cannot write nix/a.png" in run("simulate", *SMALL, "-o", "nix/a.png").error


def test_night_street_needs_more_effects_than_a_dim_ramp(run: Run) -> None:
    night = run("simulate", "--scene", "night-street", "--time", "4", *SMALL, "--json").json
    ramp = run("simulate", "--scene", "ramp", "--time", "0.001", *SMALL, "--json").json
    assert list(decisions(night)) == list(effect_names())
    for name in ("veiling glare", "blooming", "full well", "vignetting", "photon noise"):
        assert decisions(night)[name], name
    for name in ("blooming", "full well", "crosstalk", "DSNU", "dark current"):
        assert not decisions(ramp)[name], name
    assert sum(decisions(night).values()) > sum(decisions(ramp).values())
    for output in (night, ramp):
        assert 0 < output["joint_bound_dn"] <= output["tolerance_dn"] == 0.5


def test_explain_shows_each_effect_with_bound_and_reason(run: Run) -> None:
    out = run("simulate", *SMALL, "--scene", "ramp", "--time", "0.001", "--explain").out
    for name in effect_names():
        assert name in out
    for text in ("bound, DN", "left out", "pixel values are whole numbers", "tolerance 0.5 DN"):
        assert text in out


@pytest.mark.parametrize(
    "arguments", [("night-street", "4", "0.5"), ("night-street", "4", "0"), ("room", "0.01", "0.5")]
)
def test_explain_has_one_number_in_bound_and_reason(run: Run, arguments: tuple[str, ...]) -> None:
    scene, time_s, tolerance = arguments
    out = run(
        *("simulate", "--scene", scene, "--time", time_s, "--tolerance", tolerance),
        *("--sensor", "complete", *SMALL, "--explain"),
    ).out
    rows = [re.split(r" {2,}", line) for line in out.splitlines()]
    found = [
        (row[2], number[1])
        for row in rows
        if (number := re.search(r"(?:can change|changes at most) ([\d.e-]+) DN", row[-1]))
    ]
    assert len(found) >= 6
    assert all(column == sentence for column, sentence in found), found


def test_explain_states_time_and_measured_change(run: Run) -> None:
    arguments = ("simulate", "--size", "320x240", "--scene", "ramp", "--time", "0.01", "--explain")
    out = run(*arguments).out
    for text in (
        "measured change",
        "the mean of the frame by",
        "time saved",
        "estimated",
        "saved, ms",
    ):
        assert text in out
    assert "none hits this frame" in out
    data = run(*arguments, "--json").json
    compared = data["compared_with_every_effect"]
    assert 0 < compared["largest_dn"] <= data["joint_bound_dn"]
    assert abs(compared["mean_dn"]) <= compared["largest_dn"]
    exact = run(*arguments, "--tolerance", "0", "--json").json["compared_with_every_effect"]
    assert exact["largest_dn"] == exact["mean_dn"] == 0


def test_bracket_shares_the_tolerance_and_is_planned_per_frame(run: Run) -> None:
    arguments = ("simulate", "--scene", "room", *SMALL, "--time", "0.001", "--bracket", "1,8,512")
    output = run(*arguments, "-o", "room.npy", "--json").json
    assert [frame["time_s"] for frame in output["frames"]] == pytest.approx([0.001, 0.008, 0.512])
    assert [frame["file"] for frame in output["frames"]] == [f"room-{i}.npy" for i in (1, 2, 3)]
    assert all(frame["tolerance_dn"] == pytest.approx(0.5 / 3) for frame in output["frames"])
    assert output["joint_bound_dn"] <= output["tolerance_dn"] == 0.5
    first, *_, last = (decisions(frame) for frame in output["frames"])
    assert not first["blooming"]
    assert last["blooming"]
    assert decisions(output)["blooming"]
    means = [np.load(f"room-{i}.npy").mean() for i in (1, 2, 3)]
    assert means == sorted(means)
    listed = run("simulate", *SMALL, "--times", "1/100,1/50", "--json").json
    assert [frame["time_s"] for frame in listed["frames"]] == pytest.approx([0.01, 0.02])


def test_scene_can_be_a_file(run: Run) -> None:
    scene = {"name": "mine", "picture": "wall", "luminance_cd_m2": 50, "target": {"size": 0.5}}
    Path("mine.json").write_text(json.dumps(scene))
    output = run("simulate", "--scene", "mine.json", *SMALL, "--time", "1/50", "--json").json
    assert decisions(output)["motion blur"]


@pytest.mark.parametrize(
    ("line", "message", "status"),
    [
        ("--tolerance -1", "invalid value for --tolerance: -1; expected a tolerance of at", 2),
        ("--tolerance nan", "invalid value for --tolerance: nan; expected a tolerance of at", 2),
        ("--times 1,x", "invalid value for --times: x; expected a time in seconds", 2),
        (
            "--times 1 --bracket 1,2",
            "--times cannot be combined with --bracket; leave one of them out",
            2,
        ),
        ("--bracket 1,-2", "invalid value for --bracket: -2; expected numbers from 1e-100", 2),
        ("--sensor complet", "unknown sensor 'complet'; did you mean complete", 2),
        ("--scene nightstreet", "unknown scene 'nightstreet'; did you mean night-street", 2),
        ("--scene ramp --size 999999x999999", "GiB", 1),
    ],
)
def test_invalid_simulation_is_one_line(run: Run, line: str, message: str, status: int) -> None:
    ran = run("simulate", *line.split())
    assert message in ran.error
    assert ran.status == status


@pytest.mark.slow
def test_shoot_explains_what_its_frames_lack(run: Run) -> None:
    arguments = ("shoot", "-O", "size=64x48", "--sensor", "complete", "--scene", "ramp")
    out = run(*arguments, "-O", "tolerance=0.5", "-o", "some").out
    for text in ("effect left out", "in frames", "cosmic rays", "a sample of the sum by at most"):
        assert text in out
    report = json.loads(Path("some/report.json").read_text())
    assert 0 < report["simulation"]["joint_bound_dn"] <= 0.5
    assert "cosmic rays" in report["simulation"]["left_out"]
    exact = run(*arguments, "-O", "tolerance=0", "-o", "all").out
    assert "a sample of the sum by at most 0 DN" in exact


def test_the_command_line_causes_faults(run: Run) -> None:
    small = ("-O", "size=64x48", "--ratios", "1,2,4,8", "--response", "log")
    pulled = run("shoot", *small, "-O", "faults=unplug@3", "-o", "out")
    assert pulled.status == 1
    assert "unplugged" in pulled.err
    assert run("resume", "out").status == 0
    report = json.loads(Path("out/report.json").read_text())
    assert report["status"] == "complete"
    assert "faults" not in report["source"]["options"]
    assert run("shoot", *small, "-O", "faults=bang@1").error.startswith("invalid fault 'bang@1'")
