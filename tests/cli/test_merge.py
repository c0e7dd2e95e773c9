"""`camctl merge`: photographs of all formats, what is chosen, and what is found wrong with them."""

from __future__ import annotations

import errno
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from command_line import Run
from numpy.typing import NDArray

from camctl import Layout, PhotographOptions, merge, read_report
from camctl.response.camera import standard_response
from sim.devices.still_files import RawImage, encode

TIMES = tuple(2.0**k for k in range(-9, 2))
"""Exposures of the series, s: its shortest is dark and its longest mostly saturated."""

Floats = NDArray[np.float64]


def light(rows: int = 240, columns: int = 320) -> Floats:
    """Return irradiance of a scene over 1:2,000 with shapes in it, (rows, columns, 3)."""
    rng = np.random.default_rng(1)
    coarse = cv2.resize(rng.uniform(0, 1, (12, 16)), (columns, rows), interpolation=cv2.INTER_CUBIC)
    fine = cv2.GaussianBlur(rng.normal(size=(rows, columns)), (0, 0), 1.5)
    ramp = np.linspace(0, 1, columns)[None, :]
    log = 7.6 * (0.6 * ramp + 0.4 * np.clip(coarse, 0, 1)) + 0.8 * fine
    scene = np.exp(np.clip(log - log.max(), -7.6, 0))
    return np.asarray(200 * scene[..., None] * np.array([1.0, 0.8, 0.6]))


SCENE = light()


def photograph(time_s: float, scene: Floats = SCENE, seed: int = 0, bits: int = 8) -> NDArray[Any]:
    """Return an sRGB photograph with a little noise, (rows, columns, 3) in R, G, B."""
    rng = np.random.default_rng((seed, int(time_s * 1e6)))
    E = scene * time_s
    E = E + np.sqrt(np.maximum(E, 0) / 8000) * rng.normal(size=E.shape)
    levels = standard_response("srgb", bits).levels
    return np.searchsorted(levels, E, side="right").astype(np.uint8 if bits == 8 else np.uint16)


def save(path: Path, pixels: NDArray[Any]) -> Path:
    """Write pixels in R, G, B, or grey ones, in the format of the suffix."""
    if path.suffix == ".tif":
        tifffile.imwrite(path, pixels, photometric="rgb" if pixels.ndim == 3 else "minisblack")
    else:
        swapped = cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR) if pixels.ndim == 3 else pixels
        assert cv2.imwrite(str(path), swapped, [cv2.IMWRITE_JPEG_QUALITY, 97])
    return path


Series = Callable[..., list[str]]


@pytest.fixture
def series(run: Run) -> Series:
    """Return a function that writes photographs, and returns arguments that name them."""

    def write(
        times: Sequence[float] = TIMES,
        suffix: str = ".png",
        change: Callable[[int, NDArray[Any]], NDArray[Any]] = lambda _, pixels: pixels,
        labels: Sequence[float] | None = None,
        **more: Any,
    ) -> list[str]:
        names = []
        for k, time_s in enumerate(times):
            pixels = change(k, photograph(time_s, **more))
            names.append(str(save(Path(f"p{k:02d}{suffix}"), pixels)))
        return [*names, "--times", ",".join(f"{each:.9g}" for each in labels or times)]

    assert run is not None  # it has changed to an empty folder
    return write


def error_of(folder: str, scene: Floats = SCENE) -> float:
    """Return the error of the radiance in a folder, see `error_between`."""
    return error_between(read_report(folder).radiance(), scene)


def error_between(radiance: NDArray[Any], scene: Floats) -> float:
    """Return the median absolute difference of the logarithms up to one scale per channel."""
    logs = np.log(np.maximum(radiance, 1e-9)) - np.log(np.maximum(scene, 1e-9))
    return float(np.median(np.abs(logs - np.median(logs, axis=(0, 1)))))


def test_a_series_becomes_a_radiance_map_without_warnings(run: Run, series: Series) -> None:
    ran = run("merge", *series(), "-o", "hall")
    assert (ran.status, ran.err) == (0, "")
    assert error_of("hall") < 0.02
    names = {path.name for path in Path("hall").iterdir()}
    assert {"sum.tiff", "image.tiff", "radiance.exr", "preview.png", "report.json"} <= names
    assert "p10.png" in ran.out
    assert "not needed: " in ran.out
    assert "response: srgb, which fits the photographs" in ran.out


def test_the_choice_is_that_of_a_camera_with_these_settings(run: Run, series: Series) -> None:
    line = series()
    found = run("merge", *line, "-n", "3", "-o", "hall", "--json").json
    used = [each for each in found["photographs"] if each["used"]]
    assert len(used) == len(found["frames"]) == 3
    assert all(each["why_not"] for each in found["photographs"] if not each["used"])
    details = [frame["details"]["file"] for frame in found["frames"]]
    assert details == [each["file"] for each in used]
    # The shortest one used saturates hardly anything, and the next longer one does.
    assert found["frames"][0]["saturated_fraction"] < 2e-3
    few = run("merge", *line, "--range", "20", "-o", "few", "--json").json
    assert len(few["frames"]) < len(run("merge", *line, "-o", "more", "--json").json["frames"])


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif"])
def test_photographs_of_each_format_are_read(run: Run, series: Series, suffix: str) -> None:
    ran = run("merge", *series(TIMES[::2], suffix), "-o", "hall")
    assert ran.status == 0, ran.err
    assert error_of("hall") < 0.04


def test_linear_openexr_files_are_merged(run: Run) -> None:
    import OpenEXR

    names = []
    for k, time_s in enumerate(TIMES[::3]):
        values = np.minimum(SCENE * time_s, 1).astype(np.float32)
        iso = 200.0 if k else 100.0
        header = {"type": OpenEXR.scanlineimage, "expTime": time_s * 100 / iso, "isoSpeed": iso}
        channels = {name: values[..., c].copy() for c, name in enumerate("RGB")}
        OpenEXR.File(header, channels).write(f"p{k}.exr")
        names.append(f"p{k}.exr")
    ran = run("merge", *names, "-o", "hall", "--json")
    assert ran.status == 0, ran.out
    assert ran.json["response_from"] == "linear, as raw files are"
    assert error_of("hall") < 0.01


def test_exposures_come_from_exif_data(run: Run) -> None:
    names = []
    for k, (label, iso) in enumerate(((60, 100), (15, 100), (15, 400), (4, 400))):
        true_s = 2.0 ** -round(np.log2(label)) * iso / 100
        name = f"p{k}.tif"
        tags = [(33434, 5, 1, (1, label), True), (34855, 3, 1, iso, True)]
        tags += [(33437, 5, 1, (8, 1), True), (272, 2, 0, "X-T0", True)]
        pixels = photograph(true_s, SCENE / 4)
        tifffile.imwrite(name, pixels, photometric="rgb", extratags=tags)
        names.append(name)
    found = run("merge", *names, "-o", "hall", "--json").json
    assert [each["gain"] for each in found["photographs"]] == [1, 1, 4, 4]
    assert [each["f_number"] for each in found["photographs"]] == [8, 8, 8, 8]
    times = [each["time_s"] for each in found["photographs"]]
    assert times == pytest.approx([1 / 64, 1 / 16, 1 / 16, 1 / 4], rel=0.03)
    assert "labels of a dial" in found["facts"][0]
    assert found["camera"]["model"] == "X-T0"
    assert error_of("hall") < 0.03
    exact = run("merge", *names, "--labels", "exact", "-o", "exact", "--json").json
    assert exact["photographs"][0]["time_s"] == pytest.approx(1 / 60)


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


def test_one_wrong_label_is_named(run: Run, series: Series) -> None:
    labels = list(TIMES)
    labels[4] *= 1.7
    ran = run("merge", *series(labels=labels), "--curve", "srgb", "-o", "hall")
    assert "p04.png is" in ran.err
    assert "one of the two exposures is wrong" in ran.err
    assert "p08.png" not in ran.err


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_a_shifted_photograph_is_named(run: Run, series: Series, suffix: str) -> None:
    def shift(k: int, pixels: NDArray[Any]) -> NDArray[Any]:
        return np.roll(pixels, (5, -7), axis=(0, 1)) if k == 4 else pixels

    ran = run("merge", *series(suffix=suffix, change=shift), "-o", "hall")
    lines = [line for line in ran.err.splitlines() if "is shifted against" in line]
    assert len(lines) == 1
    assert lines[0].startswith(f"camctl: warning: p04{suffix} is shifted against p03{suffix} by ")
    assert "about -7 columns and +5 rows" in lines[0]


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


def test_a_few_photographs_without_a_response_are_taken_for_srgb(run: Run, series: Series) -> None:
    ran = run("merge", *series((TIMES[0], TIMES[-1])), "-o", "hall")
    assert ran.status == 0
    assert "the response is taken for srgb" in ran.err


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("p00.png --times 1", "one photograph makes no merge"),
        ("p00.png p01.png --times 1", "--times has 1 values for 2 files"),
        ("p00.png p01.png", "p00.png does not say its exposure time"),
        ("missing.png p01.png --times 1,2", "cannot read missing.png"),
        ("p00.png p01.png --times 1,2 --white 10 --black 20", "invalid levels: black 20"),
        ("p00.png p01.png --times 1.234,2 --labels dial", "the times are not the labels"),
        ("p00.png p01.png --times 1,2 --curve nothing", "unknown camera response 'nothing'"),
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


def test_a_profile_of_the_camera_in_the_exif_data_is_used(run: Run) -> None:
    from camctl.camera import CameraInfo
    from camctl.profile import Profile, change_profile
    from camctl.response_record import ChannelResponse, ResponseRecord

    u = np.linspace(0, 1, 40)
    channel = ChannelResponse(
        name="G",
        black=0,
        white=255,
        saturates=True,
        irradiance=tuple((u**2).tolist()),
        brightness=tuple(u.tolist()),
        deviation=None,
        measured=(0, 1),
    )
    record = ResponseRecord(
        channels=tuple(channel.model_copy(update={"name": name}) for name in "RGB"),
        phase=0,
        frames=5,
        measured_at="2026-01-01T00:00:00",
    )

    def keep(profile: Profile) -> None:
        profile.responses["rgb-320x240-255"] = record

    # Another maker's camera has the same model name, and comes first.
    change_profile(CameraInfo("ptp", "Amaker", "X-T0", "1", "ptp"), keep)
    change_profile(CameraInfo("ptp", "Maker", "X-T0", "1", "ptp"), keep)
    names = []
    for k, time_s in enumerate((1 / 64, 1 / 8, 1)):
        E = np.clip(SCENE / 4 * time_s, 0, 1)
        tags = [(33434, 5, 1, (int(1000 * time_s * 64), 64000), True), (272, 2, 0, "X-T0", True)]
        tags.append((271, 2, 0, "MAKER CORPORATION", True))
        pixels = np.minimum(np.sqrt(E) * 256, 255).astype(np.uint8)
        tifffile.imwrite(f"p{k}.tif", pixels, photometric="rgb", extratags=tags)
        names.append(f"p{k}.tif")
    found = run("merge", *names, "-o", "hall", "--json").json
    assert "from the profile ptp-maker-" in found["response_from"]
    assert error_of("hall") < 0.02
    change_profile(CameraInfo("ptp", "Maker", "X-T0", "2", "ptp"), keep)
    ran = run("merge", *names, "-o", "two")
    assert "fit the photographs equally, and none is used: remove one" in ran.err
    assert ran.err.count("ptp-maker-x-t0-") == 2


def test_a_profile_with_another_serial_number_is_not_that_of_the_photographs() -> None:
    from camctl.camera import CameraInfo
    from camctl.merging.photograph_response import profiles_of
    from camctl.profile import change_profile

    for make, serial in (("Nikon Corporation", "0001"), ("Nikon", "2"), ("Nikon", "")):
        change_profile(CameraInfo("ptp", make, "D1", serial, "ptp"), lambda _profile: None)

    def serials(make: str, serial: str) -> list[str]:
        return sorted(each.serial for each in profiles_of((make, "D1", serial)))

    assert serials("NIKON CORPORATION", "1") == ["", "0001"]
    assert serials("NIKON CORPORATION", "") == serials("", "") == ["", "0001", "2"]
    assert serials("Canon", "1") == []


def test_json_of_the_folder_is_a_report(run: Run, series: Series) -> None:
    printed = run("merge", *series(), "--curve", "srgb", "-o", "hall", "--json").json
    kept = json.loads(Path("hall/report.json").read_text())
    assert kept.items() <= printed.items()


@pytest.mark.slow
def test_the_memorial_photographs_come_out_without_warnings(run: Run, real_data: Path) -> None:
    from sim.scenes.radiance_map import read_map

    folder = real_data / "memorial"
    lines = (folder / "image_list.txt").read_text().splitlines()
    rows = [line.split() for line in lines if line.startswith("memorial")]
    files, times = [str(folder / row[0]) for row in rows], [float(row[1]) for row in rows]
    ran = run("merge", *files, "--times", ",".join(map(str, times)), "-o", "hall", "--json")
    assert (ran.status, ran.err) == (0, "")
    assert "cut to 501 x 716 pixels from column 4, row 32" in " ".join(ran.json["facts"])
    part = (slice(32, 32 + 716), slice(4, 4 + 501))
    truth = np.asarray(read_map(folder / "memorial.hdr")[0], np.float64)[part]
    pictures = [read for each in files if (read := cv2.imread(each)) is not None]
    exposures = np.array(times, np.float32)
    curve = cv2.createCalibrateDebevec().process(pictures, exposures)
    debevec = cv2.createMergeDebevec().process(pictures, exposures, curve)[part][..., ::-1]
    # 0.26 times when this was written.
    assert error_of("hall", truth) < 1.1 * error_between(debevec, truth)


@pytest.mark.parametrize("form", ["dng", "jpeg"])
def test_files_of_still_cameras_are_merged_by_their_exif_data(run: Run, form: str) -> None:
    from camctl.controls import Layout
    from sim.devices.still_files import RawImage, encode

    rng = np.random.default_rng(3)
    names = []
    for label, time_s in ((250, 1 / 256), (60, 1 / 64), (15, 1 / 16), (4, 1 / 4)):
        if form == "dng":
            E = SCENE[..., 1] * time_s
            noisy = 600 + rng.normal(0, 3, E.shape) + np.minimum(E, 1.2) * 14400
            pixels = np.clip(np.rint(noisy), 0, 15000).astype(np.uint16)
            image = RawImage(pixels, Layout.RGGB, 14, 600, 15000, 1 / label, 100, 8.0, "D1")
        else:
            shown = photograph(time_s)
            image = RawImage(shown, Layout.RGB, 8, 0, 255, 1 / label, 100, 8.0, "D1")
        names.append(f"p{label}.{form}")
        Path(names[-1]).write_bytes(encode(form, image, grey=False))
    found = run("merge", *names, "-o", "hall", "--json").json
    assert found["camera"]["model"] == "D1"
    stated = [each["time_s"] for each in found["photographs"]]
    assert stated == pytest.approx([1 / 256, 1 / 64, 1 / 16, 1 / 4], rel=0.03)
    scene = SCENE if form == "jpeg" else np.repeat(SCENE[..., 1:2], 3, axis=2)
    assert error_of("hall", scene) < (0.01 if form == "dng" else 0.04)


def test_python_makes_what_the_command_makes(run: Run, series: Series) -> None:
    names = series(TIMES[3:8])
    ran = run("merge", *names, "--response", "log", "-o", "hall", "--json")
    report = merge(names[: names.index("--times")], path="again", options=options_of(names))
    assert report.plan.ratios == tuple(ran.json["plan"]["ratios"])
    assert report.source["photographs"] == ran.json["photographs"]
    assert np.array_equal(report.sum(), read_report("hall").sum())


def options_of(names: list[str]) -> PhotographOptions:
    times = names[names.index("--times") + 1].split(",")
    return PhotographOptions(times=tuple(map(float, times)))


def test_the_result_says_when_and_with_which_camera_photographs_were_taken(run: Run) -> None:
    names = []
    for label, iso in ((250, 100), (250, 400), (60, 400)):
        time_s = {250: 1 / 256, 60: 1 / 64}[label] * iso / 100
        image = RawImage(photograph(time_s), Layout.RGB, 8, 0, 255, 1 / label, iso, 8.0, "D1")
        names.append(f"p{label}-{iso}.jpg")
        Path(names[-1]).write_bytes(encode("jpeg", image, grey=False))
    ran = run("merge", *names, "--ratios", "1,4,16", "-o", "hall")
    assert ran.status == 0, ran.err
    report = read_report("hall")
    assert report.camera.model == "D1"
    # The times of the dial are 1/256 and 1/64 s; shutters are corrected by some percent at most.
    assert [f.applied_s for f in report.frames] == pytest.approx(
        [1 / 256, 1 / 256, 1 / 64], rel=0.03
    )
    assert [frame.applied.gain for frame in report.frames] == [1.0, 4.0, 4.0]
    assert {frame.applied.f_number for frame in report.frames} == {8.0}
    assert "metered" not in ran.out


def test_times_that_are_given_replace_nothing_but_the_times(run: Run) -> None:
    names = []
    for k, (time_s, iso) in enumerate(((1 / 256, 100), (1 / 256, 400), (1 / 64, 400))):
        shown = photograph(time_s * iso / 100)
        image = RawImage(shown, Layout.RGB, 8, 0, 255, 1.0, iso, 8.0, "D1")
        names.append(f"p{k}.jpg")
        Path(names[-1]).write_bytes(encode("jpeg", image, grey=False))
    line = (*names, "--times", "1/256,1/256,1/64", "--ratios", "1,4,16", "-o", "hall")
    found = run("merge", *line, "--labels", "exact", "--json").json
    assert [each["gain"] for each in found["photographs"]] == [1.0, 4.0, 4.0]
    assert {each["f_number"] for each in found["photographs"]} == {8.0}
    assert [each["time_s"] for each in found["photographs"]] == [1 / 256, 1 / 256, 1 / 64]


def test_errors_are_json_where_that_is_asked_for(run: Run, series: Series) -> None:
    names = series(TIMES[4:6])
    refused = run("merge", "p00.png", "p01.png", "-o", "hall", "--json")
    assert refused.status == 2
    assert "does not say its exposure time" in refused.json["error"]["message"]
    Path("hall").mkdir()
    Path("hall/report.json").write_text("{}")
    occupied = run("merge", *names, "-o", "hall", "--json")
    assert occupied.status != 0
    assert occupied.json["error"]["type"]


def test_photographs_of_one_colour_are_left_out(run: Run, series: Series) -> None:
    def white(k: int, pixels: NDArray[Any]) -> NDArray[Any]:
        return np.full_like(pixels, 255) if k >= 5 else pixels

    ran = run("merge", *series(TIMES[2:9], change=white), "-o", "hall")
    assert ran.status == 0, ran.err
    assert ran.err.count("is one colour everywhere, and left out") == 2


def test_a_failed_merge_says_how_to_go_on(
    run: Run, series: Series, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*arguments: Any, **named: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    line = ("merge", *series(TIMES[3:8]), "-o", "out")
    with monkeypatch.context() as patched:
        patched.setattr(tifffile, "imwrite", fail)
        ran = run(*line)
    assert ran.status == 1
    assert "the photographs are as they were; merge them again, with --force" in ran.error
    again = run(*line, "--force")
    assert again.status == 0, again.err
    assert "until the last frame" not in again.out
