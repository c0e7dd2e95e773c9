"""`camctl merge`: what is found wrong with photographs."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bracketed_photographs import (
    FEW,
    SCENE,
    TIMES,
    Series,
    error_of,
    photograph,
    save,
)
from command_line import Run
from numpy.typing import NDArray

from camctl import read_report


def test_a_frame_that_contradicts_is_named_by_its_file(run: Run, series: Series) -> None:
    labels = [TIMES[5], 1.7 * TIMES[6]]
    line = series(TIMES[5:7], labels=labels)
    ran = run("merge", *line, "--curve", "srgb", "--black", "0", "-n", "2", "-o", "hall", "--json")
    assert ran.status == 3
    (finding,) = [each for each in ran.json["findings"] if each["code"] == "labels_contradict"]
    assert finding["frames"] == [1, 0]
    assert finding["value"] == pytest.approx(1 / 1.7, rel=0.05)
    assert finding["details"]["why"] == "two"
    # The words of the command line: files instead of numbers, and the option that helps.
    assert (
        "camctl: warning: p01.png is 2 times as bright as p00.png, although exposed 3.4 times as "
        "much: one of the two exposures is wrong, or the light has changed (two photographs do not "
        "show which) (--times SECONDS,...)"
    ) in ran.err.splitlines()
    assert "not trustworthy" in ran.err
    assert re.search(r"frame \d", ran.err) is None


def test_a_photograph_of_something_else_does_not_spoil_the_picture(
    run: Run, series: Series
) -> None:
    line = series(FEW, change=lambda k, pixels: pixels[:, ::-1] if k == 2 else pixels)
    ran = run("merge", *line, "--curve", "srgb", "-o", "hall")
    assert "warning: p02.png does not show what the others show" in ran.err
    finding, unknown = read_report("hall").findings
    assert unknown.code == "noise_unknown"
    assert (finding.code, finding.frames) == ("other_view", ())  # it is no frame of the picture
    assert finding.details["file"] == "p02.png"
    assert error_of("hall") < 0.05


def test_a_thing_that_is_all_that_can_be_compared_makes_no_exposure_wrong(
    run: Run, tmp_path: Path
) -> None:
    """The wall behind it is saturated in the longer photograph."""
    files = []
    y, x = np.mgrid[:180, :240]
    wall = 18 * np.exp(0.7 * (np.sin(x / 9) + np.sin(y / 7)))[..., None] * np.ones(3)
    for k, time_s in enumerate(times := (1 / 32, 1 / 2)):
        scene = wall.copy()
        scene[45:150, 15 + 60 * k : 105 + 60 * k] = 0.3
        files.append(save(tmp_path / f"p{k}.png", photograph(time_s, scene)))
    options = ("--curve", "srgb", "--times", ",".join(map(str, times)), "-o", "hall")
    assert run("merge", *files, *options).status == 0
    report = read_report("hall")
    check = report.frames[1].ratio
    assert check is not None
    assert not check.is_one_ratio
    assert report.trustworthy
    assert report.movement is not None
    assert report.movement.share > 0.1


def test_a_border_of_one_pure_colour_is_cut_off(run: Run, series: Series) -> None:
    def with_border(k: int, pixels: NDArray[Any]) -> NDArray[Any]:
        pixels[: 3 + k % 3, :] = pixels[:, -8:] = (0, 0, 255)
        return pixels

    found = run("merge", *series(FEW, change=with_border), "-o", "hall", "--json").json
    (cut,) = [each for each in found["facts"] if each["code"] == "masked"]
    assert cut["place"] == {"top": 5, "left": 0, "bottom": 120, "right": 152}
    assert cut["value"] == 0
    assert cut["text"].startswith("cut to 152 x 115 pixels from column 0, row 5: ")
    assert error_of("hall", SCENE[5:, :-8]) < 0.02


def test_a_mask_leaves_pixels_out(run: Run, series: Series) -> None:
    valid = np.full(SCENE.shape[:2], 255, np.uint8)
    valid[30:60, 40:110] = 0
    save(Path("mask.png"), valid)
    line = ("merge", *series(FEW), "--mask", "mask.png", "--curve", "srgb", "-o", "hall")
    ran = run(*line)
    assert ran.status == 0, ran.err
    mask = read_report("hall").mask()
    assert np.all(mask[30:60, 40:110] & 1)
    assert np.mean(mask[valid > 0] == 0) > 0.95
    save(Path("mask.png"), valid[:-1])
    assert "mask mask.png has 160 x 119 pixels" in run(*line, "--force").error


@pytest.mark.slow
def test_a_masked_part_is_not_taken_for_a_part_of_the_scene(run: Run, series: Series) -> None:
    """Black pixels would hide the pedestal, and be the darkest light of the picture."""
    valid = np.full(SCENE.shape[:2], 255, np.uint8)
    valid[40:100, 20:100] = 0
    save(Path("mask.png"), valid)
    files = series(FEW, change=lambda k, pixels: np.maximum(pixels, 17))
    without = run("merge", *files, "-o", "hall", "--json").json
    ran = run("merge", *files, "--mask", "mask.png", "-o", "masked", "--json")
    codes = [[each["code"] for each in found["findings"]] for found in (without, ran.json)]
    assert codes[0] == ["noise_unknown"]
    # So few patches are left that what differs at a border of the photographs counts as movement.
    assert set(codes[1]) <= {"noise_unknown", "moved"}
    assert ran.json["movement"]["share"] < 0.02
    assert "the black level is 17" in str(ran.json["facts"])
    (masked,) = [each for each in ran.json["facts"] if each["code"] == "masked"]
    assert (masked["place"], masked["value"]) == (None, pytest.approx(1 / 4))
    ranges = [found["plan"]["dynamic_range"] for found in (without, ran.json)]
    assert ranges[1] == pytest.approx(ranges[0], rel=0.05)
    used = [[each["used"] for each in found["photographs"]] for found in (without, ran.json)]
    assert used[0] == used[1]
    left = valid > 0
    light = [read_report(name).radiance()[left] for name in ("hall", "masked")]
    # Two curves that are estimated from different parts differ: they are known to 1.2 to 3.2 %.
    assert np.median(np.abs(np.log(light[1] / light[0]))) < 0.03


def test_a_mask_that_is_black_around_cuts(run: Run, series: Series) -> None:
    valid = np.zeros(SCENE.shape[:2], np.uint8)
    valid[10:110, 20:150] = 255
    save(Path("mask.png"), valid)
    found = run("merge", *series(FEW[1:4]), "--mask", "mask.png", "-o", "hall", "--json").json
    (cut,) = [each for each in found["facts"] if each["code"] == "masked"]
    assert cut["place"] == {"top": 10, "left": 20, "bottom": 110, "right": 150}
    assert error_of("hall", SCENE[10:110, 20:150]) < 0.02
