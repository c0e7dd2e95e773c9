"""`camctl merge`: photographs of all formats, and what their files state."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
import pytest
import tifffile
from bracketed_photographs import (
    SCENE,
    TIMES,
    Series,
    error_of,
    photograph,
)
from command_line import Run

from camctl import Layout, read_report
from camctl.photographs.camera import flashes
from camctl.photographs.files import PhotographFiles
from camctl.sim.devices.still_files import RawImage, encode


def test_jpeg_photographs_without_exif_data_are_merged(run: Run, series: Series) -> None:
    ran = run("merge", *series(TIMES[::2], ".jpg"), "-o", "hall")
    assert ran.status == 0, ran.err
    assert error_of("hall") < 0.04


def test_names_of_files_are_visible_in_report_and_findings(run: Run, series: Series) -> None:
    """A name that is not UTF-8 ended in an internal error once all was computed."""
    names = series(TIMES[::3])
    first, second = os.fsdecode(b"caf\xe9.png"), "two\nlines.png"
    for old, new in zip(names, (first, second), strict=False):
        Path(old).rename(new)
    ran = run("merge", first, second, *names[2:], "-o", "hall")
    assert ran.status == 0, ran.err
    details = [each.details["file"] for each in read_report("hall").frames]
    assert set(details) >= {"caf\\xe9.png", "two\\nlines.png"}
    assert "caf\\xe9.png" in ran.out


@pytest.mark.slow
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
    unit = found["facts"][0]
    assert (unit["code"], unit["remedies"]) == ("label_unit", {"labels": "exact"})
    assert found["camera"]["model"] == "X-T0"
    assert error_of("hall") < 0.03
    exact = run("merge", *names, "--labels", "exact", "-o", "exact", "--json").json
    assert exact["photographs"][0]["time_s"] == pytest.approx(1 / 60)


@pytest.mark.usefixtures("run")
def test_photographs_of_different_cameras_are_named() -> None:
    names = []
    for k, model in enumerate(("X-T0", "X-T0", "Maker Phone", "X-T0")):
        pixels = photograph(2.0 ** (2 * k - 6), SCENE / 4)
        tags = [(271, 2, 0, "Maker", True), (272, 2, 0, model, True)]
        tifffile.imwrite(f"p{k}.tif", pixels, photometric="rgb", extratags=tags)
        names.append(f"p{k}.tif")
    files = list(map(Path, names))
    (note,) = PhotographFiles(files, (1 / 64, 1 / 16, 1 / 4, 1)).notes
    assert (note.code, note.details["what"]) == ("tags_differ", "camera")
    assert note.details["whose"] == "p0.tif by Maker X-T0 and p2.tif by Maker Phone"
    assert PhotographFiles(files[:2], (1 / 64, 1 / 16)).notes == []


@pytest.mark.slow
def test_a_profile_of_the_camera_in_the_exif_data_is_used(run: Run) -> None:
    from camctl.interface.camera import CameraInfo
    from camctl.profiles.profile import Profile, change_profile
    from camctl.profiles.response import ChannelResponse, ResponseRecord

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
        profile.responses["rgb-160x120-255"] = record

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
    run("merge", *names, "-o", "two")
    (unclear,) = [each for each in read_report("two").findings if each.code == "profile_unclear"]
    assert str(unclear.details["profiles"]).count("ptp-maker-x-t0-") == 2
    assert unclear.remedies == {"curve": None}


def test_a_profile_with_another_serial_number_is_not_that_of_the_photographs() -> None:
    from camctl.interface.camera import CameraInfo
    from camctl.photographs.response import profiles_of
    from camctl.profiles.profile import change_profile

    for make, serial in (("Nikon Corporation", "0001"), ("Nikon", "2"), ("Nikon", "")):
        change_profile(CameraInfo("ptp", make, "D1", serial, "ptp"), lambda _profile: None)

    def serials(make: str, serial: str) -> list[str]:
        return sorted(each.serial for each in profiles_of((make, "D1", serial)))

    assert serials("NIKON CORPORATION", "1") == ["", "0001"]
    assert serials("NIKON CORPORATION", "") == serials("", "") == ["", "0001", "2"]
    assert serials("Canon", "1") == []


def test_jpeg_photographs_are_merged_by_their_exif_data(run: Run) -> None:
    names = []
    for label, time_s in ((250, 1 / 256), (60, 1 / 64), (15, 1 / 16), (4, 1 / 4)):
        shown = photograph(time_s)
        image = RawImage(shown, Layout.RGB, 8, 0, 255, 1 / label, 100, 8.0, "D1")
        names.append(f"p{label}.jpg")
        Path(names[-1]).write_bytes(encode("jpeg", image, grey=False))
    found = run("merge", *names, "-o", "hall", "--json").json
    assert found["camera"]["model"] == "D1"
    stated = [each["time_s"] for each in found["photographs"]]
    assert stated == pytest.approx([1 / 256, 1 / 64, 1 / 16, 1 / 4], rel=0.03)
    assert error_of("hall") < 0.04


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


def test_times_are_limited_by_what_one_picture_can_hold(run: Run, series: Series) -> None:
    error = run("merge", *series(TIMES[2:5], ".jpg", labels=(1e-20, 1, 1e20))).error
    assert error == "the exposures differ by more than a factor of 1e+12"
    ran = run("merge", *series(TIMES[2:5], ".jpg", labels=(1e15, 2e15, 4e15)), "-o", "long")
    assert ran.status == 0, ran.err  # tags of files hold less


def test_a_damaged_photograph_is_named_with_the_place(run: Run, series: Series) -> None:
    line = series(TIMES[2:6], ".jpg")
    data = Path("p03.jpg").read_bytes()
    at = len(data) // 2
    Path("p03.jpg").write_bytes(data[:at] + bytes(2000) + data[at + 2000 :])
    for command in ("merge", "calibrate response"):
        error = run(*command.split(), *line).error
        assert error.startswith("p03.jpg cannot be read: its data from row ")
        assert "copy it from the camera again, or leave it out" in error
    Path("p03.jpg").write_bytes(data[:-2] + bytes(range(1, 90)) + data[-2:])
    paths = [Path(f"p{k:02d}.jpg") for k in (2, 3)]
    (note,) = PhotographFiles(paths, (1.0, 2.0)).notes
    assert (note.code, note.frames) == ("damaged", (1,))
    assert re.match(r"\d+ bytes remain after the last row: ", str(note.details["what"]))


@pytest.mark.usefixtures("run")
def test_a_flash_in_one_photograph_is_named() -> None:
    names = []
    for k, (time_s, flash) in enumerate(((1, 16), (8, 16), (64, 9))):
        tags = [(33434, 5, 1, (time_s, 512), True), (37385, 3, 1, flash, True)]
        names.append(f"p{k}.tif")
        tifffile.imwrite(names[-1], photograph(time_s / 512), photometric="rgb", extratags=tags)
    photographs = PhotographFiles(list(map(Path, names)), None).photographs
    (note,) = flashes(photographs)
    assert (note.code, note.frames) == ("light_differs", (2,))
    assert note.details["flash_fired"] is True
    assert flashes(photographs[:2]) == []
