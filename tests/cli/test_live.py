"""`camctl live`: results into files and pipes, and what is refused."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from command_line import Run

from camctl.cli.options import CameraOptions
from camctl.livestream.result import LiveResult
from camctl.model.response.names import RANGES

SMALL = ("--scene", "ramp", "-O", "size=64x48", "-O", "time=virtual", "--base", "0.002")


def test_results_become_files(run: Run, tmp_path: Path) -> None:
    folder = tmp_path / "some"
    ran = run(
        "live", *SMALL, "--ratios", "1,4,16", "--output", f"exr:{folder}", "--count", "9",
        "--every", "4", "--json",
    )  # fmt: skip
    assert ran.status == 0
    assert ran.json["results"] == 9
    assert ran.json["lost"] == 0
    assert ran.json["exposures_s"] == pytest.approx([0.002, 0.008, 0.032])
    assert len(list(folder.iterdir())) == 3


def test_a_camera_that_is_gone_is_waited_for_aloud(run: Run) -> None:
    ran = run(
        "live", *SMALL, "--ratios", "1,4", "--output", "exr:some", "--count", "9",
        "-O", "faults=unplug@6", "--json",
    )  # fmt: skip
    assert ran.status == 0
    assert ran.json["results"] == 9
    assert "the simulated camera was unplugged: waiting until it is back" in ran.err
    assert "camctl: the camera is back" in ran.err.splitlines()


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (("--output", "exr"), "unknown output"),
        (("--output", "v4l2:"), "unknown output"),
        (("--output", "-", "--json"), "cannot be combined"),
        (("--output", "raw:-", "--output", "-"), "would be mixed in one pipe"),
        (("--output", "-", "--output", "-"), "would be mixed in one pipe"),
        (("--output", "http:x"), "invalid address"),
        (("--output", "http:0.0.0.0:80"), "could be used by anybody"),
        (("--output", "v4l2:/dev/none", "--ratios", "1,4"), "cannot open /dev/none"),
        (("--output", "-", "--fps", "100"), "the camera sends 30"),
        (("--output", "-", "--fps", "20", "--ratios", "1,100"), "with 20 results a second"),
        (("--output", "http:0", "-n", "40", "--base", "auto"), "expected 1 to 16"),
        (("--output", "http:0", "--output", "webm:x"), "unknown output 'webm:x'"),
        (
            ("--output", "http:0", "--output", "v4l2:/dev/none", "--ratios", "1,4"),
            "cannot open /dev/none",
        ),
        (("--output", "exr:some", "-n", "40", "--base", "auto"), "expected 1 to 16"),
        (("--output", "exr:some", "--fps", "20", "--ratios", "1,100"), "with 20 results a second"),
        ((), "missing"),
    ],
)
def test_what_cannot_be_done_is_one_line(run: Run, arguments: tuple[str, ...], part: str) -> None:
    """Nothing was begun: no page is announced, and no folder made."""
    ran = run("live", *SMALL, *arguments)
    assert ran.status in (1, 2)
    assert part in ran.err.splitlines()[-1]
    assert "live at" not in ran.err
    assert not Path("some").exists()


@pytest.mark.parametrize("camera", ["sim", "effective:sim"])
def test_the_simulated_camera_is_live_in_real_time(run: Run, camera: str) -> None:
    """It sends 30 frames a second."""
    ran = run(
        "live", "--camera", camera, "--scene", "ramp", "-O", "size=64x48", "--base", "0.002",
        "-n", "1", "--range", "low", "--output", "exr:some", "--every", "20", "--count", "13",
        "--json", *(("-O", "bits=8", "-O", "range=low") if camera != "sim" else ()),
    )  # fmt: skip
    assert ran.status == 0, ran.err
    assert ran.json["seconds"] > 12 / 30


def test_what_was_live_until_ctrl_c_is_stated(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def write(_: object, result: LiveResult) -> None:
        if result.number == 4:
            raise KeyboardInterrupt

    monkeypatch.setattr("camctl.livestream.outputs.ExrOutput.write", write)
    ran = run("live", *SMALL, "--ratios", "1,4", "--output", "exr:some")
    assert ran.status == 130
    assert ran.err == "camctl: interrupted\n"
    assert ran.out.splitlines()[0].startswith("results      4, ")
    assert "2 ms, 8 ms" in ran.out


@pytest.mark.parametrize(
    ("camera", "time"),
    [("effective:effective:sim", "real"), ("sim:2", "real"), ("v4l2:/dev/video0", None)],
)
def test_only_a_simulated_camera_is_told_to_wait(camera: str, time: str | None) -> None:
    options = CameraOptions(camera, (), None, None)
    assert options.in_real_time().camera_options().get("time") == time


def test_the_range_is_one_of_three_or_by_accuracy_any_stop_as_the_help_says(run: Run) -> None:
    line = "live --scene grey-steps -O size=64x48 --output exr:{} --every 9 --count 1 --json"
    for objective, is_of_table in (("xi", True), ("accuracy", False)):
        ran = run(*line.format(objective).split(), "--set", f"objective={objective}")
        found = json.loads(ran.out)["dynamic_range"]
        assert (found in RANGES.values()) == is_of_table
        assert math.log2(found).is_integer() or is_of_table
    assert "among these three, whose exposures are in a table" in " ".join(
        run("live", "--help").out.split()
    )
