"""`camctl merge`: what is found wrong with photographs."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bracketed_photographs import (
    SCENE,
    TIMES,
    Series,
    error_of,
    photograph,
    save,
)
from command_line import Run
from numpy.typing import NDArray

from camctl import PhotographOptions, read_report
from camctl.photographs.photograph_set import open_photographs
from camctl.system.number_text import time_text


def test_shutters_that_are_not_exact_are_corrected_from_the_pixels(
    run: Run, series: Series
) -> None:
    labels = [each * (1.12 if k == 5 else 1) for k, each in enumerate(TIMES)]
    found = run("merge", *series(labels=labels), "--curve", "srgb", "-o", "hall", "--json").json
    assert found["photographs"][5]["time_s"] == pytest.approx(TIMES[5], rel=0.01)
    assert any("p05.png 0.89" in fact for fact in found["facts"])


@pytest.mark.parametrize("pair", [(3, 4), (2, 6), (0, 10)])
def test_swapped_labels_are_named(run: Run, series: Series, pair: tuple[int, int]) -> None:
    labels = list(TIMES)
    one, other = pair
    labels[one], labels[other] = labels[other], labels[one]
    error = run("merge", *series(labels=labels), "-o", "hall").error
    names = sorted((f"p{one:02d}.png", f"p{other:02d}.png"))
    assert [name for name in names if name in error.split(" are swapped")[0]] == names
    assert " are swapped" in error
    assert not Path("hall").exists()


def test_reversed_labels_are_named(run: Run, series: Series) -> None:
    error = run("merge", *series(labels=TIMES[::-1]), "-o", "hall").error
    assert "are in the reverse order" in error


@pytest.mark.parametrize("place", [0, 4, 5])
def test_one_wrong_label_is_named(run: Run, series: Series, place: int) -> None:
    times = TIMES[1:7]
    labels = list(times)
    labels[place] *= 1.7
    ran = run("merge", *series(times, labels=labels), "--curve", "srgb", "-o", "hall")
    assert f"the exposure of p0{place}.png is wrong: it says {time_text(labels[place])}" in ran.err
    assert f"its pixels say {time_text(times[place])}" in ran.err
    assert ran.err.count(" is wrong: ") == 1
    assert ran.status == 0
    used = [each["time_s"] for each in read_report("hall").source["photographs"]]
    assert used[place] == pytest.approx(times[place], rel=0.05)


def test_an_exact_label_that_is_wrong_is_left_out(run: Run, series: Series) -> None:
    labels = [each * (1.7 if k == 2 else 1) for k, each in enumerate(TIMES[2:8])]
    line = series(TIMES[2:8], labels=labels)
    ran = run("merge", *line, "--curve", "srgb", "--labels", "exact", "-o", "hall", "--json")
    assert "the exposure of p02.png is wrong" in ran.err
    assert ": it is left out; " in ran.err
    assert "p02.png" not in [each["file"] for each in ran.json["photographs"]]
    assert ran.status == 0


def test_a_frame_that_contradicts_is_named_by_its_file(run: Run, series: Series) -> None:
    labels = [TIMES[5], 1.7 * TIMES[6]]
    line = series(TIMES[5:7], labels=labels)
    ran = run("merge", *line, "--curve", "srgb", "--black", "0", "-n", "2", "-o", "hall")
    assert ran.status == 3
    assert "p01.png is 2 times as bright as p00.png" in ran.err
    assert "(two photographs do not show which)" in ran.err
    assert "not trustworthy" in ran.err
    assert re.search(r"frame \d", ran.err) is None


def film(pixels: NDArray[Any]) -> NDArray[Any]:
    """Return photographs as a film would show them: the response is to be estimated."""
    x = np.arange(256) / 255
    table = np.rint(255 * (0.4 * x + 0.6 * x**2 * (3 - 2 * x))).astype(np.uint8)
    return np.asarray(table[pixels])


@pytest.mark.parametrize(("place", "factor"), [(0, 1.6), (3, 0.6), (5, 1.6)])
def test_one_wrong_label_does_not_bend_the_response(
    run: Run, series: Series, place: int, factor: float
) -> None:
    times = TIMES[1:7]
    labels = [each * (factor if k == place else 1) for k, each in enumerate(times)]
    line = series(times, labels=labels, change=lambda _, pixels: film(pixels))
    names = line[: line.index("--times")]
    found = open_photographs(list(map(Path, names)), PhotographOptions(times=tuple(labels)))
    assert found.response.startswith("estimated from the photographs")
    (note,) = found.notes
    assert note.startswith(f"the exposure of p0{place}.png is wrong: it says ")
    assert f"its pixels say {time_text(times[place])}" in note


@pytest.mark.parametrize(
    ("place", "factor", "curve"), [(0, 2.0, None), (2, 0.5, None), (0, 0.5, "srgb"), (5, 2, "srgb")]
)
def test_a_wrong_label_is_named_where_photographs_are_nearly_black(
    run: Run, series: Series, place: int, factor: float, curve: str | None
) -> None:
    times = tuple(2.0 ** (2 * k - 14) for k in range(6))
    labels = [each * (factor if k == place else 1) for k, each in enumerate(times)]
    line = series(times, labels=labels, change=lambda _, pixels: pixels if curve else film(pixels))
    names = list(map(Path, line[: line.index("--times")]))
    found = open_photographs(names, PhotographOptions(times=tuple(labels), curve=curve))
    (note,) = found.notes
    assert note.startswith(f"the exposure of p0{place}.png is wrong: ")
    used = found.camera.photographs[place].time_s
    assert used == pytest.approx(times[place], rel=0.1)


def test_a_label_that_turns_the_order_is_named(run: Run, series: Series) -> None:
    labels = list(TIMES[1:7])
    labels[1] *= 5
    line = series(TIMES[1:7], labels=labels, change=lambda _, pixels: film(pixels))
    error = run("merge", *line, "-o", "hall").error
    assert error.startswith("the exposure of p01.png is wrong: it says ")


def test_three_photographs_without_a_response_do_not_show_which_label_is_wrong(
    run: Run, series: Series
) -> None:
    labels = [TIMES[2], TIMES[3] * 1.8, TIMES[4]]
    line = series(TIMES[2:5], labels=labels, change=lambda _, pixels: film(pixels))
    ran = run("merge", *line, "-o", "hall")
    assert "three photographs do not show which while the response is estimated" in ran.err
    assert ran.status == 3


def test_a_response_that_is_assumed_makes_no_exposure_wrong(run: Run, series: Series) -> None:
    times = (TIMES[0], TIMES[2], TIMES[4])

    def flat(_: int, pixels: NDArray[Any]) -> NDArray[Any]:  # up to half of full scale
        return np.asarray(120 * np.sqrt(pixels / 255), np.uint8)

    ran = run("merge", *series(times, change=flat), "--white", "255", "--black", "0", "-o", "hall")
    assert "the response is taken for srgb" in ran.err
    assert "is wrong" not in ran.err
    assert "contradict their pixels if the response is srgb, as is assumed" in ran.err
    used = [each["time_s"] for each in read_report("hall").source["photographs"]]
    assert used == pytest.approx(times, rel=0.01)


def test_light_that_changed_is_no_wrong_label(run: Run, series: Series) -> None:
    labels = [each * (2.5 if k > 3 else 1) for k, each in enumerate(TIMES[1:7])]
    ran = run("merge", *series(TIMES[1:7], labels=labels), "--curve", "srgb", "-o", "hall")
    assert "p04.png, p05.png are all about 0.4 times as bright as their exposures say" in ran.err


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_a_shifted_photograph_is_named_and_left_out(run: Run, series: Series, suffix: str) -> None:
    def shift(k: int, pixels: NDArray[Any]) -> NDArray[Any]:
        return np.roll(pixels, (5, -7), axis=(0, 1)) if k == 4 else pixels

    ran = run("merge", *series(suffix=suffix, change=shift), "-o", "hall")
    lines = [line for line in ran.err.splitlines() if "is shifted against" in line]
    assert len(lines) == 1
    assert lines[0].startswith(f"camctl: warning: p04{suffix} is shifted against p03{suffix} by ")
    assert "about -7 columns and +5 rows" in lines[0]
    assert lines[0].endswith("and is left out: align it with the others to use it")
    report = read_report("hall")
    assert f"p04{suffix}" not in {each["file"] for each in report.source["photographs"]}
    assert report.trustworthy


def test_photographs_of_which_each_is_shifted_are_all_used(run: Run, series: Series) -> None:
    def shift(k: int, pixels: NDArray[Any]) -> NDArray[Any]:
        return np.roll(pixels, (3 * k, 2 * k), axis=(0, 1))

    ran = run("merge", *series(TIMES[2:6], change=shift), "-o", "hall")
    lines = [line for line in ran.err.splitlines() if "is shifted against p00.png by" in line]
    assert [line[:24] for line in lines] == [f"camctl: warning: p0{k}.png" for k in (1, 2, 3)]
    assert "left out" not in ran.err


def test_a_photograph_of_something_else_does_not_spoil_the_picture(
    run: Run, series: Series
) -> None:
    line = series(TIMES[1:8], change=lambda k, pixels: pixels[:, ::-1] if k == 2 else pixels)
    assert run("merge", *line, "-o", "hall").err.splitlines() == [
        "camctl: warning: p02.png does not show what the others show (another view or scene), and "
        "is left out"
    ]
    assert error_of("hall") < 0.05


def test_two_photographs_of_different_things_are_named(run: Run, series: Series) -> None:
    line = series(TIMES[4:6], change=lambda k, pixels: pixels[:, ::-1] if k else pixels)
    err = run("merge", *line, "--curve", "srgb", "-o", "hall").err
    assert "p00.png and p01.png do not show the same view or scene, and the photographs do" in err


def with_colours(times: Sequence[float], colours: Sequence[Sequence[float]]) -> list[Path]:
    """Write photographs whose red and blue are these times those of the scene."""
    return [
        save(Path(f"p{k}.png"), photograph(time_s, SCENE * np.array([red, 1.0, blue])))
        for k, (time_s, (red, blue)) in enumerate(zip(times, colours, strict=True))
    ]


@pytest.mark.parametrize("place", [1, 3])
@pytest.mark.parametrize("curve", ["srgb", None])
def test_a_photograph_of_another_white_balance_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: int, curve: str | None
) -> None:
    monkeypatch.chdir(tmp_path)
    times = TIMES[1:6]
    files = with_colours(times, [(1.15, 0.9) if k == place else (1, 1) for k in range(5)])
    found = open_photographs(files, PhotographOptions(times=times, curve=curve))
    (note,) = found.notes
    assert note == (
        f"p{place}.png has another white balance than the others, or the light had another colour "
        "(1.15 times as much red and 0.90 times as much blue), and is left out"
    )
    assert len(found.camera.photographs) == 4


def test_another_white_balance_of_the_darkest_photograph_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rounding hides small differences in it, and not this one."""
    monkeypatch.chdir(tmp_path)
    times = tuple(each / 16 for each in TIMES[:8:2])
    files = with_colours(times, [(1.4, 1), (1, 1), (1, 1), (1, 1)])
    (note,) = open_photographs(files, PhotographOptions(times=times, curve="srgb")).notes
    assert "p0.png has another white balance" in note
    assert "as much red)" in note


def test_a_white_balance_that_changes_halfway_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    times = TIMES[2:6]
    files = with_colours(times, [(1, 1), (1, 1), (1.2, 1), (1.2, 1)])
    found = open_photographs(files, PhotographOptions(times=times, curve="srgb"))
    assert found.notes == (
        "the white balance, or the colour of the light, changes between p0.png and p3.png: red "
        "against green by up to 1.20 times, and the colours of the picture are not right",
    )
    assert len(found.camera.photographs) == 4


def test_a_thing_that_is_all_that_can_be_compared_makes_no_exposure_wrong(
    run: Run, tmp_path: Path
) -> None:
    """The wall behind it is saturated in the longer photograph."""
    files = []
    y, x = np.mgrid[:240, :320]
    wall = 18 * np.exp(0.7 * (np.sin(x / 9) + np.sin(y / 7)))[..., None] * np.ones(3)
    for k, time_s in enumerate(times := (1 / 32, 1 / 2)):
        scene = wall.copy()
        scene[60:200, 20 + 80 * k : 140 + 80 * k] = 0.3
        files.append(save(tmp_path / f"p{k}.png", photograph(time_s, scene)))
    options = ("--curve", "srgb", "--times", ",".join(map(str, times)), "-o", "hall")
    assert run("merge", *files, *options).status == 0
    report = read_report("hall")
    check = report.frames[1].ratio
    assert check is not None
    assert check.contradicts
    assert report.trustworthy
    assert report.movement is not None
    assert report.movement.share > 0.1


def test_a_thing_that_moved_in_one_photograph_is_no_wrong_exposure(
    run: Run, series: Series
) -> None:
    def moved(k: int, pixels: NDArray[Any]) -> NDArray[Any]:
        changed = pixels.copy()
        if k == 3:
            changed[80:160, 200:280] = (90, 60, 40)
        return changed

    line = series(TIMES[2:9], change=moved)
    ran = run("merge", *line, "--ratios", "1,2,4,8,16", "-o", "hall")
    assert ran.status == 0
    assert "wrong" not in ran.err
    assert "trustworthy" not in ran.err
    movement = read_report("hall").movement
    assert movement is not None
    place = movement.places[0]
    assert (place.top, place.left) == pytest.approx((80, 200), abs=10)
    assert (place.bottom, place.right) == pytest.approx((160, 280), abs=10)


def test_duplicates_are_left_out_or_refused(run: Run, series: Series) -> None:
    line = series(TIMES[2:9])
    names, times = line[: line.index("--times")], line[-1]
    Path("copy.png").write_bytes(Path(names[2]).read_bytes())
    ran = run("merge", *names, "copy.png", "--times", f"{times},{TIMES[4]:g}", "-o", "a")
    assert ran.status == 0
    assert "copy.png is the same photograph as p02.png, and left out" in ran.err
    error = run("merge", *names, "copy.png", "--times", f"{times},2", "-o", "b").error
    assert error.startswith("p02.png and copy.png are the same photograph, but their exposures")


def test_different_sizes_and_formats_are_named(run: Run, series: Series) -> None:
    line = series(TIMES[:3])
    save(Path("p01.png"), photograph(TIMES[1])[:-10])
    assert run("merge", *line).error.startswith("p01.png has 320 x 230 pixels and p00.png has 320")
    save(Path("p01.png"), photograph(TIMES[1])[..., 1])
    assert "p01.png is mono, 8 bits" in run("merge", *line).error


def test_a_border_of_one_pure_colour_is_cut_off(run: Run, series: Series) -> None:
    def with_border(k: int, pixels: NDArray[Any]) -> NDArray[Any]:
        pixels[: 3 + k % 3, :] = pixels[:, -8:] = (0, 0, 255)
        return pixels

    found = run("merge", *series(change=with_border), "-o", "hall", "--json").json
    assert "cut to 312 x 235 pixels from column 0, row 5: " in " ".join(found["facts"])
    assert error_of("hall", SCENE[5:, :-8]) < 0.02


def test_a_mask_leaves_pixels_out(run: Run, series: Series) -> None:
    valid = np.full(SCENE.shape[:2], 255, np.uint8)
    valid[50:100, 60:160] = 0
    save(Path("mask.png"), valid)
    ran = run("merge", *series(), "--mask", "mask.png", "--curve", "srgb", "-o", "hall")
    assert ran.status == 0, ran.err
    mask = read_report("hall").mask()
    assert np.all(mask[50:100, 60:160] & 1)
    assert np.mean(mask[valid > 0] == 0) > 0.95
    save(Path("mask.png"), valid[:-1])
    assert (
        "mask mask.png has 320 x 239 pixels" in run("merge", *series(), "--mask", "mask.png").error
    )


def test_a_masked_part_is_not_taken_for_a_part_of_the_scene(run: Run, series: Series) -> None:
    """Black pixels would hide the pedestal, and be the darkest light of the picture."""
    valid = np.full(SCENE.shape[:2], 255, np.uint8)
    valid[80:200, 40:200] = 0
    save(Path("mask.png"), valid)
    files = series(change=lambda k, pixels: np.maximum(pixels, 17))
    without = run("merge", *files, "-o", "hall", "--json").json
    ran = run("merge", *files, "--mask", "mask.png", "-o", "masked", "--json")
    assert ran.err == ""
    assert "the black level is 17" in str(ran.json["facts"])
    assert ran.json["request"]["dynamic_range"] == without["request"]["dynamic_range"]
    used = [[each["used"] for each in found["photographs"]] for found in (without, ran.json)]
    assert used[0] == used[1]
    left = valid > 0
    light = [read_report(name).radiance()[left] for name in ("hall", "masked")]
    assert np.median(np.abs(np.log(light[1] / light[0]))) < 0.01


def test_a_mask_that_is_black_around_cuts(run: Run, series: Series) -> None:
    valid = np.zeros(SCENE.shape[:2], np.uint8)
    valid[20:230, 30:310] = 255
    save(Path("mask.png"), valid)
    found = run("merge", *series(), "--mask", "mask.png", "-o", "hall", "--json").json
    assert "cut to 280 x 210 pixels from column 30, row 20: the mask is black around" in str(
        found["facts"]
    )
    assert error_of("hall", SCENE[20:230, 30:310]) < 0.02


def test_photographs_of_one_colour_are_left_out(run: Run, series: Series) -> None:
    def white(k: int, pixels: NDArray[Any]) -> NDArray[Any]:
        return np.full_like(pixels, 255) if k >= 5 else pixels

    ran = run("merge", *series(TIMES[2:9], change=white), "-o", "hall")
    assert ran.status == 0, ran.err
    assert ran.err.count("is one colour everywhere, and left out") == 2


def test_a_few_photographs_without_a_response_are_taken_for_srgb(run: Run, series: Series) -> None:
    ran = run("merge", *series((TIMES[0], TIMES[-1])), "-o", "hall")
    assert ran.status == 0
    assert "the response is taken for srgb" in ran.err
