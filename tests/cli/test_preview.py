"""`camctl preview`: one picture of the three responses; nothing is shot."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from command_line import Run
from sampling import some
from small_cameras import WrappedCamera, small_camera

import camctl
from camctl.captures.response_preview import preview_responses
from camctl.model.response.desired import desired_response


def test_one_picture_is_written_and_nothing_else(run: Run) -> None:
    done = run("preview", "-O", "size=32x24", "-o", "p.png", "--json")
    assert done.status == 0
    said = json.loads(done.out)
    assert [path.name for path in Path().iterdir()] == ["p.png"]
    assert said["file"] == "p.png"
    assert max(said["preview_times_s"]) <= 4
    assert said["left_out_s"] == []
    assert [each["response"] for each in said["responses"]] == ["linear", "gamma", "log"]
    picture = cv2.imread("p.png")
    assert picture is not None
    assert picture.shape[1] == 3 * 520 + 4 * 16


def test_text_says_what_it_is_computed_from(run: Run) -> None:
    done = run("preview", "-O", "size=32x24", "-o", "p.png")
    assert "computed from  preview frames of " in done.out
    assert "nothing was shot" in done.out
    assert "left out" not in done.out


@pytest.mark.slow
def test_exposures_too_long_for_a_preview_are_named(run: Run) -> None:
    done = run("preview", "--scene", "room", "-O", "size=32x24", "-o", "p.png")
    assert re.search(r"^left out +\d+.*s: too long for a preview$", done.out, re.MULTILINE)


@pytest.mark.parametrize(("scene", "unseen"), [("stars", True), ("uniform", False)])
def test_light_that_metering_does_not_see_is_named(run: Run, scene: str, unseen: bool) -> None:
    line = ("preview", "--scene", scene, "-O", "size=32x24", "--range", "high", "-n", "2")
    done = run(*line, "-o", "p.png")
    assert ("not seen" in done.out) == unseen
    said = run(*line, "-o", "q.png", "--json").json
    assert (said["unseen_fraction"] > 0.5) == unseen


def test_existing_picture_is_kept_unless_forced(run: Run) -> None:
    Path("p.png").write_bytes(b"mine")
    refused = run("preview", "-O", "size=32x24", "-o", "p.png")
    assert (refused.status, Path("p.png").read_bytes()) == (1, b"mine")
    assert "p.png exists; choose another file, or have it replaced (--force)" in refused.err
    assert run("preview", "-O", "size=32x24", "-o", "p.png", "--force").status == 0
    assert Path("p.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("-o", "folder"), "is not the name of a PNG file; name it -o folder.png"),
        (("--set", "table=x"), "a preview has no table of exposures"),
    ],
)
def test_what_cannot_be_combined(run: Run, arguments: tuple[str, ...], message: str) -> None:
    done = run("preview", *arguments)
    assert done.status == 2
    assert message in done.err
    assert done.err.count("\n") == 1


PANELS = [slice(16 + k * 536, 16 + k * 536 + 520) for k in range(3)]


@pytest.mark.slow  # each response is planned for several ranges
@pytest.mark.parametrize("scene", ["room", "night-street"])
def test_three_pictures_to_choose_from(scene: str) -> None:
    """In an automatic range each response shows the scene: no picture is black or flat."""
    with camctl.open_camera("sim", scene=scene, size="320x240") as camera:
        shown = preview_responses(camera, camctl.CaptureRequest(dynamic_range="auto"))
    assert [each.name for each in shown.responses] == ["linear", "gamma", "log"]
    for columns in PANELS:
        part = shown.picture[52:440, columns]
        assert np.median(part) > 40
        assert (part == 0).mean() < 0.02
        assert part.std() > 25


@pytest.mark.parametrize("sensor", some(["standard", "phone"], every=2, first=1))
def test_shares_are_those_that_the_capture_has(sensor: str) -> None:
    """A given range of a linear response is dark in the room; the preview predicts how much."""
    fields: dict[str, Any] = {"response": "linear", "dynamic_range": 1000.0, "count": 2}
    with camctl.open_camera("sim", scene="room", sensor=sensor, size="160x120") as camera:
        request = camctl.CaptureRequest(**fields)
        shown = preview_responses(camera, request)
        report = camctl.capture(camera, request, plan=shown.plan)
    (linear,) = [each for each in shown.responses if each.name == "linear"]
    assert linear.plan == shown.plan
    assert linear.dark > 0.5
    assert linear.dark == pytest.approx(report.achieved.dark_fraction, abs=0.03)
    assert linear.saturated == pytest.approx(report.achieved.saturated_fraction, abs=0.01)


def test_image_is_that_of_the_response() -> None:
    """The small picture has the brightness that the response gives the light of the ramp."""
    with camctl.open_camera("sim", scene="ramp", size="640x480") as camera:
        request = camctl.CaptureRequest(response="log", dynamic_range=256.0, count=2)
        shown = preview_responses(camera, request)
    top = 16 + 36 + 390 + 18 + 8
    small = [shown.picture[top + 20 : top + 130, columns][:, 5:195] for columns in PANELS]
    rows = [part.mean(axis=(0, 2)) / 255 for part in small]
    E = np.asarray(desired_response("log", 256.0).inverse(rows[2]))
    seen = (rows[2] > 0.3) & (rows[2] < 0.97)
    assert seen.any()
    assert np.abs(rows[1] - desired_response("gamma", 256.0).u(E))[seen].max() < 0.03


def test_a_camera_without_preview_needs_meter() -> None:
    with small_camera() as inner, WrappedCamera(inner) as camera:
        assert not hasattr(camera, "preview")
        request = camctl.CaptureRequest(base_s=0.01, count=2)
        with pytest.raises(camctl.UsageError, match="has no preview, and a frame would cost"):
            preview_responses(camera, request)
        allowed = camctl.CaptureRequest(base_s=0.01, count=2, spend_shutter=True)
        assert preview_responses(camera, allowed).picture.shape[2] == 3
