"""Metadata of the picture files, read back by other programs."""

from __future__ import annotations

import json
import shutil
import struct
import subprocess
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
import tifffile
from picture_parts import TAKEN_AT, details, rendered
from sampling import some

import camctl
from camctl.interface.camera import CameraInfo
from camctl.interface.controls import Layout
from camctl.pictures.files import write_picture_files
from camctl.pictures.metadata import exr_attributes, png_with_metadata
from camctl.sim.devices.still_files import RawImage, encode

SUMMARY = "sum of the exposures 1/4 s, 1 s at gain 2; desired response log, range 1:1,000"
HOSTILE = CameraInfo("x", "a\0b\n" + "ä" * 900, "m" * 900, "1\r\n" + "€" * 900, "x")


@pytest.fixture(params=some([Layout.MONO, Layout.RGGB, Layout.RGB], every=2))
def layout(request: pytest.FixtureRequest) -> Layout:
    found: Layout = request.param
    return found


@pytest.fixture
def folder(layout: Layout, tmp_path: Path) -> Path:
    total, how = rendered(layout, shape=(12, 16))
    write_picture_files(total, how, details(), tmp_path)
    return tmp_path


def test_openexr_reads_the_attributes(folder: Path, layout: Layout) -> None:
    with OpenEXR.File(str(folder / "radiance.exr"), separate_channels=True) as file:
        header = dict(file.header())
    expected = {
        "cameraMake": "Bénch",
        "cameraModel": "Camera 1",
        "cameraSerialNumber": "S/N 7",
        "software": "camctl 1.2.3",
        "irradianceUnit": "as the scene",
        "capDate": "2026:05:17 21:04:09",
    }
    assert {name: header[name] for name in expected} == expected
    assert header["utcOffset"] == -7200
    assert header["expTime"] == pytest.approx(1.25)
    assert header["aperture"] == pytest.approx(2.8)
    assert header["gain"] == 2.0
    assert header["isoSpeed"] == 200
    assert header["comments"].strip() == f"irradiance; {SUMMARY}"
    assert ("chromaticities" in header) == (layout is not Layout.MONO)
    if layout is not Layout.MONO:
        bt709 = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)
        assert header["chromaticities"] == pytest.approx(bt709)


def test_no_attribute_is_longer_than_other_programs_read(tmp_path: Path) -> None:
    """A long summary is in several; ffmpeg 5 takes files with more than 255 bytes for damaged."""
    many = replace(details(), frames=20 * details().frames)
    assert len(many.summary) > 255
    total, how = rendered(Layout.MONO, shape=(12, 16))
    write_picture_files(total, how, many, tmp_path)
    with OpenEXR.File(str(tmp_path / "radiance.exr")) as file:
        header = dict(file.header())
    texts = {name: value for name, value in header.items() if isinstance(value, str)}
    assert max(map(len, texts.values())) == 255
    comments = "".join(text for name, text in sorted(texts.items()) if name.startswith("comments"))
    assert comments.strip() == f"irradiance; {many.summary}"


@pytest.mark.parametrize("name", ["image.tiff", "sum.tiff"])
def test_tifffile_reads_the_tags(folder: Path, name: str) -> None:
    with tifffile.TiffFile(folder / name) as file:
        tags: dict[str, Any] = {tag.name: tag.value for tag in file.pages.first.tags}
    assert tags["Make"] == "B?nch"
    assert tags["Model"] == "Camera 1"
    assert tags["Software"] == "camctl 1.2.3"
    assert tags["DateTime"] == "2026:05:17 21:04:09"
    assert tags["CameraSerialNumber"] == "S/N 7"
    assert tags["ImageDescription"] == SUMMARY
    assert tags["ExposureTime"] == (5, 4)
    assert tags["FNumber"] == (14, 5)
    assert tags["ISOSpeedRatings"] == 200


def exiftool(*files: Path) -> list[dict[str, Any]]:
    program = shutil.which("exiftool")
    if program is None:
        pytest.skip("exiftool is missing: apt-get install libimage-exiftool-perl")
    command = [program, "-json", "-n", "-validate", "-warning", "-error", *map(str, files)]
    done = subprocess.run(command, capture_output=True, check=True, timeout=60)
    everything = json.loads(done.stdout)
    tags = [program, "-json", "-n", *map(str, files)]
    done = subprocess.run(tags, capture_output=True, check=True, timeout=60)
    found: list[dict[str, Any]] = json.loads(done.stdout)
    for one, checked in zip(found, everything, strict=True):
        assert "Error" not in checked
        one |= checked
    return found


def test_exiftool_reads_every_file(folder: Path, layout: Layout) -> None:
    names = ["radiance.exr", "image.tiff", "sum.tiff", "preview.png", "contact.png", "picture.jpg"]
    exr, image, total, preview, contact, picture = exiftool(*(folder / name for name in names))
    assert (picture["Make"], picture["Model"]) == ("B?nch", "Camera 1")
    assert picture["DateTimeOriginal"] == "2026:05:17 21:04:09"
    assert picture["ExifVersion"] == "0232"
    assert picture["NumberOfImages"] == 2
    assert picture["MPImageLength"] == picture["DirectoryItemLength"]
    assert exr["CameraMake"] == "Bénch"
    assert exr["CameraSerialNumber"] == "S/N 7"
    assert exr["ExposureTime"] == pytest.approx(1.25)
    assert exr["Aperture"] == pytest.approx(2.8)
    assert exr["ISO"] == 200
    assert exr["DateTimeOriginal"] == "2026:05:17 21:04:09"
    if layout is not Layout.MONO:
        assert [float(x) for x in exr["Chromaticities"].split()][:2] == pytest.approx([0.64, 0.33])
    for tiff in (image, total):
        assert (tiff["Make"], tiff["Model"]) == ("B?nch", "Camera 1")
        assert (tiff["Software"], tiff["ModifyDate"]) == ("camctl 1.2.3", "2026:05:17 21:04:09")
        assert tiff["ExposureTime"] == pytest.approx(1.25)
        assert tiff["FNumber"] == pytest.approx(2.8)
        assert tiff["ISO"] == 200
        assert tiff["ImageDescription"] == SUMMARY
        assert "SRGBRendering" not in tiff
    for png in (preview, contact):
        assert png["SRGBRendering"] == 0
        assert png["Software"] == "camctl 1.2.3"
        assert png["Source"] == "B?nch Camera 1"
        assert png["CreationTime"] == f"{TAKEN_AT:%Y:%m:%d %H:%M:%S}+02:00"
        assert "Warning" not in png


def test_exiftool_reads_what_merged_photographs_stated(tmp_path: Path) -> None:
    names = []
    for k, time_s in enumerate((1 / 250, 1 / 60, 1 / 15)):
        light = np.geomspace(0.01, 4, 64) * 0.3 * 4**k
        pixels = np.minimum(np.sqrt(light) * 255, 255).astype(np.uint8)
        rows = np.repeat(np.repeat(pixels[None, :, None], 48, axis=0), 3, axis=2)
        image = RawImage(rows, Layout.RGB, 8, 0, 255, time_s, 400, 8.0, "D1")
        (tmp_path / f"{k}.jpg").write_bytes(encode("jpeg", image, grey=False))
        names.append(tmp_path / f"{k}.jpg")
    options = camctl.PhotographOptions(times=(1 / 256, 1 / 64, 1 / 16), curve="power:2")
    camctl.merge(names, path=tmp_path / "out", options=options)
    exr, image_tiff = exiftool(
        *(tmp_path / "out" / name for name in ("radiance.exr", "image.tiff"))
    )
    assert exr["ISO"] == image_tiff["ISO"] == 400
    assert exr["Aperture"] == image_tiff["FNumber"] == 8
    assert exr["CameraModel"] == image_tiff["Model"] == "D1"


def test_png_chunks_are_whole_and_pixels_stay(cv2: Any) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (7, 9, 3), dtype=np.uint8)
    png = png_with_metadata(cv2.imencode(".png", pixels)[1].tobytes(), details())
    place, kinds = 8, []
    while place < len(png):
        size, kind = struct.unpack_from(">I4s", png, place)
        data = png[place + 4 : place + 8 + size]
        assert struct.unpack_from(">I", png, place + 8 + size)[0] == zlib.crc32(data)
        kinds.append(kind)
        place += 12 + size
    assert kinds[:3] == [b"IHDR", b"cICP", b"sRGB"]
    assert kinds[-1] == b"IEND"
    decoded = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED)
    assert decoded is not None
    assert np.array_equal(decoded, pixels)


def test_hostile_names_of_a_camera_leave_the_files_readable(tmp_path: Path, cv2: Any) -> None:
    total, how = rendered(Layout.MONO, shape=(4, 5))
    write_picture_files(total, how, replace(details(), camera=HOSTILE), tmp_path)
    with OpenEXR.File(str(tmp_path / "radiance.exr"), separate_channels=True) as file:
        assert file.header()["cameraMake"] == "ab" + "ä" * 98
        assert file.channels()["Y"].pixels.shape == (4, 5)
    with tifffile.TiffFile(tmp_path / "image.tiff") as tiff:
        assert tiff.pages.first.tags["Make"].value == "ab" + "?" * 98
    assert cv2.imread(str(tmp_path / "preview.png")) is not None


def test_what_is_unknown_is_left_out() -> None:
    unknown = replace(
        details(f_number=None, iso=None), taken_at=None, camera=CameraInfo("x", "", "m", "", "x")
    )
    names = exr_attributes(unknown, "Y").keys()
    assert names == {"cameraModel", "software", "expTime", "irradianceUnit", "gain"}


def test_a_capture_says_camera_and_date(tmp_path: Path) -> None:
    with camctl.open_camera("sim", size="32x24") as camera:
        report = camctl.capture(camera, camctl.CaptureRequest(), tmp_path / "out")
    assert report.files["contact"] == "contact.png"
    assert report.taken_at is not None
    with OpenEXR.File(str(tmp_path / "out" / "radiance.exr")) as file:
        header = dict(file.header())
    assert header["capDate"] == f"{report.taken_at:%Y:%m:%d %H:%M:%S}"
    assert header["cameraModel"] == report.camera.model
    times = sum(frame.applied_s for frame in report.frames)
    assert header["expTime"] == pytest.approx(times, rel=1e-6)
