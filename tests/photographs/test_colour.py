"""Colours of merged photographs: the camera's matrix and white balance, profiles, the ends."""

from __future__ import annotations

import io
import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenEXR
import pytest
import tifffile
from bracketed_photographs import photograph, save
from numpy.typing import NDArray
from PIL import Image, ImageCms
from raw_photographs import NEUTRAL, camera_rgb, mosaic, raw_file

import camctl
from camctl import CaptureReport, CaptureRequest, PhotographOptions, merge
from camctl.interface.colour import BT709_PRIMARIES, D65, CameraColour, rgb_to_xyz
from camctl.model.response.camera import standard_response
from camctl.model.response.desired import desired_response
from camctl.pictures.files import read_deviation
from camctl.pictures.icc import icc_profile
from camctl.stills.decoding import read_still

TIMES = (1 / 64, 1 / 8, 1.0)
_DISPLAY_P3 = ((0.680, 0.320), (0.265, 0.690), (0.150, 0.060))


def patches(rows: int = 96, columns: int = 128) -> NDArray[np.float64]:
    """Return squares of colours of BT.709 over 1:60, smooth at their borders."""
    rng = np.random.default_rng(4)
    colours = rng.uniform(0.05, 1, (6, 8, 3)) * np.geomspace(0.1, 6, 8)[None, :, None]
    scene = cv2.resize(colours, (columns, rows), interpolation=cv2.INTER_NEAREST)
    return np.asarray(cv2.GaussianBlur(scene, (0, 0), 1.0), np.float64)


SCENE = patches()


@pytest.fixture
def raw_files(tmp_path: Path) -> list[Path]:
    pytest.importorskip("rawpy", reason="rawpy is missing: pip install 'camctl[raw]'")
    files = []
    for time_s in TIMES:
        files.append(tmp_path / f"r{round(1 / time_s)}.dng")
        files[-1].write_bytes(raw_file(mosaic(SCENE, time_s), time_s))
    return files


def merged(files: list[Path], **options: Any) -> CaptureReport:
    known = PhotographOptions(labels="exact", **options)
    return merge(files, CaptureRequest("linear"), files[0].parent / "out", options=known)


def colour_errors(found: NDArray[Any], scene: NDArray[Any]) -> NDArray[Any]:
    """Return relative differences of the channels at the centres of the squares."""
    at = np.s_[8::16, 8::16]
    found, scene = found[at], scene[at]
    return np.asarray(found / found[..., 1:2] / (scene / scene[..., 1:2]) - 1)


def test_raw_photographs_give_linear_bt709(raw_files: list[Path]) -> None:
    report = merged(raw_files)
    errors = colour_errors(report.radiance(), SCENE)
    assert np.median(np.abs(errors)) < 0.01
    assert np.percentile(np.abs(errors), 90) < 0.03
    folder = raw_files[0].parent / "out"
    with OpenEXR.File(str(folder / "radiance.exr"), header_only=True) as file:
        bt709 = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)
        assert file.header()["chromaticities"] == pytest.approx(bt709)
    assert b"cICP" in (folder / "preview.png").read_bytes()[:100]
    with tifffile.TiffFile(folder / "image.tiff") as tiff:
        assert tiff.pages.first.tags[34675].value[16:20] == b"RGB "
        code = tiff.asarray()
    bright = np.s_[:, 96:]  # codes of the darker ones are rounded
    assert np.median(np.abs(colour_errors(code[bright].astype(float), SCENE[bright]))) < 0.02
    assert np.nanmedian(report.standard_deviation()) > 0


def test_raw_files_of_a_camera_that_libraw_does_not_know_have_their_own_matrix(
    raw_files: list[Path],
) -> None:
    for file, time_s in zip(raw_files, TIMES, strict=True):
        file.write_bytes(raw_file(mosaic(SCENE, time_s), time_s, "Nobody Nothing 1"))
    errors = colour_errors(merged(raw_files).radiance(), SCENE)
    assert np.median(np.abs(errors)) < 0.01
    assert (raw_files[0].parent / "out" / "picture.dng").exists()


def test_camera_colours_are_as_in_the_files_and_state_nothing(raw_files: list[Path]) -> None:
    report = merged(raw_files, colour="camera")
    errors = colour_errors(report.radiance(), camera_rgb(SCENE))
    assert np.median(np.abs(errors)) < 0.01
    folder = raw_files[0].parent / "out"
    with OpenEXR.File(str(folder / "radiance.exr"), header_only=True) as file:
        assert "chromaticities" not in file.header()
    assert b"cICP" not in (folder / "preview.png").read_bytes()[:100]
    with tifffile.TiffFile(folder / "image.tiff") as tiff:
        assert 34675 not in tiff.pages.first.tags


@pytest.mark.parametrize(
    ("orientation", "step", "turns"), [(6, 1, -1), (3, 1, 2), (8, 1, 1), (7, -1, -1)]
)
def test_raw_photographs_are_turned_upright(
    raw_files: list[Path], orientation: int, step: int, turns: int
) -> None:
    """Also of an odd number of columns, where the pattern of the mosaic is another one then."""
    scene = SCENE[:, :-1]
    for file, time_s in zip(raw_files, TIMES, strict=True):
        file.write_bytes(raw_file(mosaic(scene, time_s), time_s, orientation=orientation))
    report = merged(raw_files)
    turned = np.rot90(scene[:, ::step], turns)
    ratio = report.radiance() / turned
    assert np.median(np.abs(ratio / np.median(ratio) - 1)) < 0.01
    dng = read_still((raw_files[0].parent / "out" / "picture.dng").read_bytes(), "picture.dng")
    assert dng.pixels.shape[:2] == turned.shape[:2]


def test_light_that_saturates_every_photograph_is_white(raw_files: list[Path]) -> None:
    scene = SCENE.copy()
    scene[20:40, 20:40] = 400.0
    for file, time_s in zip(raw_files, TIMES, strict=True):
        file.write_bytes(raw_file(mosaic(scene, time_s), time_s))
    white = merged(raw_files).radiance()[25:35, 25:35]
    assert np.abs(white / white[..., 1:2] - 1).max() < 0.01


def profile_of(primaries: tuple[tuple[float, float], ...], monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setattr("camctl.pictures.icc.BT709_PRIMARIES", primaries)
    return icc_profile(desired_response("gamma", 256.0))


def test_photographs_with_a_profile_of_other_primaries_are_converted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    profile = profile_of(_DISPLAY_P3, monkeypatch)
    files = []
    for k, time_s in enumerate((0.01, 0.04, 0.16)):
        pixels = photograph(time_s)[::2, ::2]
        files.append(tmp_path / f"p{k}.tif")
        tifffile.imwrite(files[-1], pixels, photometric="rgb", iccprofile=profile, metadata=None)
    options = PhotographOptions(times=(0.01, 0.04, 0.16), curve="srgb")
    plain = PhotographOptions(times=(0.01, 0.04, 0.16), curve="srgb", colour="camera")
    found = merge(files, options=options).radiance()
    before = merge(files, options=plain).radiance()
    to_709 = np.linalg.solve(rgb_to_xyz(BT709_PRIMARIES, D65), rgb_to_xyz(_DISPLAY_P3, D65))
    assert found == pytest.approx(before @ to_709.T, rel=0.01)


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".tif"])
def test_files_without_a_profile_have_the_primaries_of_bt709(tmp_path: Path, suffix: str) -> None:
    file = save(tmp_path / f"a{suffix}", photograph(0.04))
    still = read_still(file.read_bytes(), file.name)
    assert still.colour is not None
    assert still.colour.is_identity


def test_colours_of_a_camera_need_a_matrix() -> None:
    with pytest.raises(ValueError, match="matrix"):
        CameraColour.of_raw(np.zeros((3, 3)), NEUTRAL)
    with pytest.raises(ValueError, match="white balance"):
        CameraColour.of_raw(np.eye(3), np.array([0.0, 1.0, 1.0]))


@pytest.mark.parametrize(
    ("gamma", "expected"),
    [(2.2, np.linspace(0, 1, 256) ** 2.2), (1.0, np.linspace(0, 1, 256)), (None, ())],
)
def test_the_curve_of_a_profile_is_the_encoding_of_its_codes(
    gamma: float | None, expected: Any, tmp_path: Path
) -> None:
    """LittleCMS writes sRGB with a parametric curve."""
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    if gamma is not None:
        start, size = curve_of(profile)
        assert profile[start : start + 4] == b"para"
        short = b"curv" + bytes(4) + struct.pack(">IH", 1, round(gamma * 256))
        profile = profile[:start] + short.ljust(size, b"\0") + profile[start + size :]
    file = tmp_path / "p.png"
    Image.new("RGB", (8, 8)).save(file, icc_profile=profile)
    colour = read_still(file.read_bytes(), file.name).colour
    assert colour is not None
    assert colour.is_identity
    assert colour.encoding == pytest.approx(tuple(expected), abs=0.004)


def curve_of(profile: bytes) -> tuple[int, int]:
    """Return the place and size of the curve of green in a profile."""
    entry = profile.index(b"gTRC")
    start, size = struct.unpack_from(">II", profile, entry + 4)
    return start, size


def test_blocks_that_are_turned_or_cut_have_no_stated_steps(tmp_path: Path) -> None:
    rng, files = np.random.default_rng(2), []
    light = cv2.GaussianBlur(rng.uniform(0.1, 1, (96, 128)), (0, 0), 3)
    for k in range(3):
        pixels = np.clip(60 * 2**k * light + rng.normal(0, 1, light.shape), 0, 255)
        data = cv2.imencode(".jpg", np.repeat(pixels[..., None], 3, axis=2).astype(np.uint8))[1]
        exif = Image.Exif()
        exif[0x0112] = 6
        files.append(tmp_path / f"{k}.jpg")
        Image.open(io.BytesIO(data.tobytes())).save(files[-1], exif=exif, quality=90)
    found = merged(files, times=(1.0, 2.0, 4.0), curve="srgb", colour="camera")
    assert found.sum().shape[:2] == (128, 96)
    assert not any("brightness_steps" in each.details for each in found.frames)


def test_a_file_that_states_few_samples_of_colours_is_believed(tmp_path: Path) -> None:
    """Of soft pictures the pixels do not show it: errors were 1.9 times their deviations."""
    rng = np.random.default_rng(2)
    coarse = rng.normal(0, 1, (40, 60, 3))
    coarse = 0.4 * coarse + 1.5 * coarse.mean(axis=2, keepdims=True)
    squares = cv2.resize(coarse, (240, 160), interpolation=cv2.INTER_NEAREST)
    light = np.exp(cv2.GaussianBlur(squares, (0, 0), 4))
    light *= 0.04 / np.percentile(light, 95)
    files, frames, times = [], [], tuple(2.0 ** (k - 10) for k in range(6))
    levels = standard_response("srgb", 8).levels
    for time_s in times:
        x = rng.poisson(time_s * 1024 * light * 51_200) / 51_200
        x += rng.normal(0, 0.3 / 256, light.shape)
        pixels = np.searchsorted(levels, x, "right").astype(np.uint8)
        files.append(tmp_path / f"{time_s}.jpg")
        data = cv2.imencode(".jpg", pixels[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 95])[1]
        files[-1].write_bytes(data.tobytes())
        frames.append(np.asarray(cv2.imdecode(data, 1), np.uint8)[..., ::-1])
    found = merged(files, times=times, curve="srgb", colour="camera")
    assert all(each.details["few_chroma_samples"] for each in found.frames)
    errors = found.radiance() / 1024 - light
    deviation = read_deviation(tmp_path / "out" / "radiance.exr")
    assert deviation is not None
    assert 0.85 < np.sqrt(np.mean(np.square(errors * 1024 / deviation))) < 1.15
    steps = found.frames[0].details["brightness_steps"]
    assert len(steps) == 64
    by_arrays = camctl.combine(
        frames, times, response="srgb", few_chroma_samples=True, brightness_steps=steps
    )
    assert np.median(by_arrays.sd / deviation) == pytest.approx(1, abs=2e-3)
