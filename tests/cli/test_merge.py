"""`camctl merge`: the picture of photographs, what is chosen, and errors."""

from __future__ import annotations

import errno
import json
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from bracketed_photographs import (
    FEW,
    TIMES,
    Series,
    error_between,
    error_of,
    light,
)
from command_line import Run
from sampling import some

from camctl import PhotographOptions, merge, read_report

LARGE = light(240, 320)


def test_a_series_becomes_a_radiance_map_without_warnings(run: Run, series: Series) -> None:
    ran = run("merge", *series(FEW, scene=LARGE), "-o", "hall")
    assert (ran.status, ran.err) == (0, "")
    assert error_of("hall", LARGE) < 0.02
    names = {path.name for path in Path("hall").iterdir()}
    assert {"sum.tiff", "image.tiff", "radiance.exr", "preview.png", "report.json"} <= names
    assert "p05.png" in ran.out
    assert "response: srgb, which fits the photographs best" in ran.out


def test_what_longer_photographs_show_is_said_to_need_a_larger_range(
    run: Run, series: Series
) -> None:
    ran = run("merge", *series(FEW), "--curve", "srgb", "--range", "3", "-o", "hall")
    (finding,) = [x for x in read_report("hall").findings if x.code == "light_below_range"]
    assert finding.remedies == {"dynamic_range": "auto"}
    assert "of 1:3: let the light decide the range (--range auto)" in ran.err


@pytest.mark.slow
def test_the_choice_is_that_of_a_camera_with_these_settings(run: Run, series: Series) -> None:
    line = series(FEW)
    found = run("merge", *line, "-n", "3", "-o", "hall", "--json").json
    used = [each for each in found["photographs"] if each["used"]]
    assert len(used) == len(found["frames"]) == 3
    assert all(each["why_not"] for each in found["photographs"] if not each["used"])
    details = [frame["details"]["file"] for frame in found["frames"]]
    assert details == [each["file"] for each in used]
    # The shortest one used saturates hardly anything, and the next longer one does.
    assert found["frames"][0]["saturated_fraction"] < 2e-3
    every = run("merge", *line, "--range", "20", "-o", "every", "--json").json
    assert all(each["used"] for each in every["photographs"])


@pytest.mark.slow
def test_colours_of_jpeg_photographs_are_those_of_the_scene(run: Run) -> None:
    """JPEG files keep half of the colours' resolution, and mix those beside saturated samples."""
    times = [2.0**k for k in range(-10, 1, 2)]
    tints = np.random.default_rng(2).uniform(-2.0, 1.0, (48, 64, 3))
    scene = light(480, 640) * np.exp(cv2.resize(tints, (640, 480), interpolation=cv2.INTER_LINEAR))
    codes = np.arange(256) / 256
    film = (-np.log1p(codes * np.expm1(-4)) / 4) ** 2.2  # with a shoulder: few codes for highlights
    names = []
    for k, time_s in enumerate(times):
        pixels = np.searchsorted(film[1:], scene * time_s, side="right").astype(np.uint8)
        names.append(f"IMG_{k}.jpg")
        swapped = cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR)
        assert cv2.imwrite(names[-1], swapped, [cv2.IMWRITE_JPEG_QUALITY, 85])
    ran = run("merge", *names, "--times", ",".join(map(str, times)), "-o", "hall")
    assert ran.status == 0
    logs = np.log2(np.maximum(read_report("hall").radiance(), 1e-9) / scene)
    bright = scene > np.median(scene, axis=(0, 1))
    scales = [float(np.median(logs[..., c][bright[..., c]])) for c in range(3)]
    assert np.ptp(scales) < 0.03  # stops; 0.08 with a response for each channel


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("p00.png --times 1", "one photograph makes no merge"),
        ("none/*.png", "cannot read none/*.png: No such file or directory"),
        (
            "p00.png p01.png --times 1",
            "1 exposure time was given for 2 files; give one for",
        ),
        (
            "p00.png p01.png",
            "p00.png does not say its exposure time; give the exposure",
        ),
        ("missing.png p01.png --times 1,2", "cannot read missing.png"),
        ("p00.png p01.png --times 1,2 --white 10 --black 20", "invalid levels: black 20"),
        ("p00.png p01.png --times 1.234,2 --labels dial", "the times are not nominal shutter"),
        ("p00.png p01.png --times 1,2 --curve nothing", "unknown camera response 'nothing'"),
        (
            "p00.png p01.png --times 1,2 --curve srgb --ratios 1,1.1",
            "p00.png is nearest to 2 of the exposures, and can be used once; give one exposure for",
        ),
        ("--times 1,2", "argument FILES... is missing"),
    ],
)
def test_what_cannot_be_merged_is_refused(
    run: Run, series: Series, line: str, message: str
) -> None:
    series(TIMES[4:6])
    ran = run("merge", *line.split(), "-o", "hall")
    assert ran.status in (1, 2)
    assert ran.error.startswith(message)
    assert not Path("hall").exists()


def test_a_photograph_is_not_said_to_show_what_is_too_dark(run: Run, series: Series) -> None:
    line = series(TIMES[::2])
    ran = run("merge", *line, "--curve", "srgb", "--ratios", "1,4", "-o", "hall")
    assert ran.status == 0, ran.err
    assert re.search(r"not used: longer than p\d+.png, the longest one chosen", ran.out)
    assert "shows the darkest" not in ran.out


@pytest.mark.parametrize("suffix", some([".png", ".jpg"], every=2))
def test_the_share_that_is_too_dark_is_predicted(run: Run, series: Series, suffix: str) -> None:
    line = (*series(TIMES[:4:3], suffix, scene=LARGE), "--curve", "srgb")
    for options in ("--range 100", "-n 2"):  # about 30 %, and what is black in both
        found = run("merge", *line, *options.split(), "-o", "hall", "--json", "--force").json
        dark = found["achieved"]["dark_fraction"]
        assert dark > 0.004
        assert found["plan"]["light"]["dark"] == pytest.approx(dark, rel=0.02)


@pytest.mark.slow
def test_the_memorial_photographs_come_out_with_one_warning(run: Run, real_data: Path) -> None:
    """The scans differ along their lower edge, as memorial0073.png does from the others."""
    from camctl.stills.radiance_map import read_map

    folder = real_data / "memorial"
    lines = (folder / "image_list.txt").read_text().splitlines()
    rows = [line.split() for line in lines if line.startswith("memorial")]
    files, times = [str(folder / row[0]) for row in rows], [float(row[1]) for row in rows]
    ran = run("merge", *files, "--times", ",".join(map(str, times)), "-o", "hall", "--json")
    assert ran.status == 0
    (moved,) = ran.json["findings"]
    assert (moved["code"], moved["place"]["bottom"]) == ("moved", 716)
    (cut,) = [each for each in ran.json["facts"] if each["code"] == "masked"]
    assert cut["place"] == {"top": 32, "left": 4, "bottom": 32 + 716, "right": 4 + 501}
    part = (slice(32, 32 + 716), slice(4, 4 + 501))
    truth = np.asarray(read_map(folder / "memorial.hdr")[0], np.float64)[part]
    pictures = [read for each in files if (read := cv2.imread(each)) is not None]
    exposures = np.array(times, np.float32)
    curve = cv2.createCalibrateDebevec().process(pictures, exposures)
    debevec = cv2.createMergeDebevec().process(pictures, exposures, curve)[part][..., ::-1]
    # 0.26 times when this was written.
    assert error_of("hall", truth) < 1.1 * error_between(debevec, truth)


def test_python_makes_what_the_command_makes(run: Run, series: Series) -> None:
    names = series(TIMES[3:6])
    curve = ("--curve", "srgb")
    ran = run("merge", *names, *curve, "--response", "log", "-o", "hall", "--json")
    kept = json.loads(Path("hall/report.json").read_text())
    assert kept.items() <= ran.json.items()
    report = merge(names[: names.index("--times")], path="again", options=options_of(names))
    assert report.plan.ratios == tuple(ran.json["plan"]["ratios"])
    assert report.source["photographs"] == ran.json["photographs"]
    assert np.array_equal(report.sum(), read_report("hall").sum())


def options_of(names: list[str]) -> PhotographOptions:
    times = names[names.index("--times") + 1].split(",")
    return PhotographOptions(times=tuple(map(float, times)), curve="srgb")


def test_a_failed_merge_says_how_to_go_on(
    run: Run, series: Series, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*arguments: Any, **named: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    line = ("merge", *series(TIMES[3:6]), "--curve", "srgb", "-o", "out")
    with monkeypatch.context() as patched:
        patched.setattr(tifffile, "imwrite", fail)
        ran = run(*line)
    assert ran.status == 1
    assert "the photographs are as they were; merge them again (--force)" in ran.error
    resumed = run("resume", "out")
    assert "was begun by camctl merge; merge the photographs again, with --force" in resumed.error
    assert "out is not empty" in run(*line).error
    again = run(*line, "--force")
    assert again.status == 0, again.err
    assert "until the last frame" not in again.out
