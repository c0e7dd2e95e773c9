"""What `camctl shoot` does with each fault of the simulated camera, see docs/how-to/ci.md."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest
from command_line import Run

from camctl.interface.camera import Pixels
from camctl.sim.damage import DAMAGES
from camctl.sim.faults import FAULT_FORMS

QUICK = ("--sensor", "machine-vision", "--ratios", "1,3,9", "--base", "0.01")
#: By fault: exit status, numbers of the frames that may be shot again, codes of the findings.
DONE: dict[str, tuple[int, set[int], set[str]]] = {
    "busy=2": (0, set(), {"time_differs"}),
    "drop@1": (0, set(), {"time_differs"}),
    "repeat@1": (0, {2}, set()),
    "corrupt@0": (0, {1}, set()),
    "corrupt@1": (0, {2}, set()),
    "truncate@1": (0, {2}, set()),
    "shift@1": (0, {2}, set()),
    "double@1": (0, {2}, set()),
    "green@1": (0, {2}, set()),
    "jpeg@1": (0, {2}, set()),
    "wrong@1=0.97": (0, {2}, set()),
    "late@1=5": (0, set(), {"time_differs"}),
    "jump@1=-10": (0, set(), set()),
    "longer=0.001": (0, {2}, {"exposure_differs"}),
    "longer=0.003": (3, {2}, {"exposure_differs"}),
    "clamp=0.02": (3, {2}, {"exposure_differs"}),
    "stated=1": (0, set(), set()),
    "delay=1": (0, {1, 2, 3}, {"delay_settled", "time_differs"}),
}


def shot(run: Run, fault: str) -> Any:
    return run("shoot", "-O", "size=160x120", "-O", f"faults={fault}", *QUICK, "--json")


@pytest.mark.parametrize("fault", DONE)
def test_each_fault_has_its_answer(run: Run, fault: str) -> None:
    if fault.startswith("jpeg"):
        pytest.importorskip("cv2", reason="OpenCV is blocked")
    status, again, codes = DONE[fault]
    ran = shot(run, fault)
    assert ran.status == status
    frames, report = ran.json["frames"], ran.json
    assert report["trustworthy"] is (status == 0)
    assert {number for number, one in enumerate(frames, 1) if one.get("attempts", 1) > 1} == again
    found = {finding["code"] for finding in report["findings"]} - {"light_below_range"}
    assert found == codes
    lost = [number for number, one in enumerate(frames, 1) if one.get("lost")]
    assert lost == ([2] if fault in {"drop@1", "late@1=5"} else [])


@pytest.mark.parametrize(("fault", "again"), [("double@1", 2), ("double@2", 3)])
def test_a_frame_that_others_contradict_is_shot_again(run: Run, fault: str, again: int) -> None:
    """Of the lines after those that came twice, only the contours contradict."""
    exposures = ("--ratios", "1,8,64", "--base", "0.02")
    ran = run("shoot", "-O", "size=320x240", "-O", f"faults={fault}", *exposures, "--json")
    frames = ran.json["frames"]
    assert [n for n, one in enumerate(frames, 1) if one.get("attempts", 1) > 1] == [again]
    assert "places" not in ran.json["movement"]


@pytest.mark.parametrize("kind", ["jpeg", "shift"])
def test_lines_that_are_damaged_twice_make_a_capture_untrustworthy(run: Run, kind: str) -> None:
    """The tenth shot is the second one of frame 9."""
    if kind == "jpeg":
        pytest.importorskip("cv2", reason="OpenCV is blocked")
    faults = f"faults={kind}@8,{kind}@10"
    ran = run("shoot", "-O", "size=160x120", "-O", faults, "--json")
    assert ran.status == 3
    (found,) = ran.json["findings"]
    assert (found["code"], found["frames"]) == ("lines_damaged", [8])
    assert 36 <= found["place"]["top"] < 84  # it begins in 30 to 70 % of the height
    assert "of frame 9 contradict most other frames" in ran.json["warnings"][0]


def test_lines_that_came_twice_in_both_shots_make_a_capture_untrustworthy(run: Run) -> None:
    """Of frame 9 so much is saturated, and the picture so small, that few contours contradict."""
    ran = run("shoot", "-O", "size=160x120", "-O", "faults=double@8,double@10", "--json")
    assert ran.status == 3
    (found,) = ran.json["findings"]
    assert (found["code"], found["frames"]) == ("lines_repeated", [8])
    assert 36 <= found["place"]["top"] < 84  # it begins in 30 to 70 % of the height
    assert "frame 9 has lines that came before, once more" in ran.json["warnings"][0]


def test_lines_that_a_camera_repeats_in_all_frames_are_how_it_makes_them(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def enlarged(pixels: Pixels, white: int, random: np.random.Generator) -> None:
        pixels[1::2] = pixels[::2]

    monkeypatch.setitem(cast(dict[str, object], DAMAGES), "double", enlarged)
    ran = shot(run, ",".join(f"double@{number}" for number in range(20)))
    assert ran.status == 0
    assert "lines_repeated" not in {finding["code"] for finding in ran.json["findings"]}


@pytest.mark.parametrize(
    ("faults", "again"),
    [
        ("truncate@0,shift@1", [1, 2]),
        ("truncate@0,shift@1,double@2", [1, 2, 3]),
        ("truncate@2,truncate@3,truncate@4", [3, 4, 5]),
    ],
)
def test_damaged_frames_do_not_hide_each_other(run: Run, faults: str, again: list[int]) -> None:
    ran = run("shoot", "-O", "size=160x120", "-O", f"faults={faults}", "--json")
    frames = ran.json["frames"]
    assert [n for n, one in enumerate(frames, 1) if one.get("attempts", 1) > 1] == again
    assert (ran.status, ran.json["findings"]) == (0, [])


@pytest.mark.parametrize("fault", ["unplug@2", "freeze@2"])
def test_a_camera_that_is_gone_leaves_frames_that_can_be_resumed(run: Run, fault: str) -> None:
    ran = shot(run, fault)
    assert ran.status == 1
    assert "2 of 3 frames are kept" in ran.json["error"]["message"]
    assert "camctl resume" in ran.json["error"]["hint"]


def test_every_fault_is_tried() -> None:
    tried = {fault.partition("@")[0].partition("=")[0] for fault in (*DONE, "unplug", "freeze")}
    assert tried == {form.partition("@")[0].partition("=")[0] for form in FAULT_FORMS}


def test_the_summary_names_a_lost_frame_and_the_smallest_error_that_shows(run: Run) -> None:
    ran = run("shoot", "-O", "size=160x120", "-O", "faults=drop@1", *QUICK)
    assert "\nlost                 frame 2: " in ran.out
    assert "\nsmallest error       wrong exposures show from " in ran.out


def test_an_error_of_the_exposure_shows_from_the_stated_one_on(run: Run) -> None:
    least = shot(run, "drop@9").json["frames"][1]["ratio"]["tolerance"]
    assert 0.015 < least < 0.03
    again = [shot(run, f"wrong@1={1 - share * least}").json for share in (0.5, 1.5)]
    assert [report["frames"][1].get("attempts", 1) for report in again] == [1, 2]
