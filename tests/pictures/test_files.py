"""The picture files: strips leave no seam, and files and memory hold the same arrays."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from picture_parts import NOISE, details, rendered
from sampling import some

from camctl.errors import DataError
from camctl.interface.colour import CameraColour
from camctl.interface.controls import Layout
from camctl.model.response.camera import linear_response
from camctl.pictures import render as pictures
from camctl.pictures.combine import combine
from camctl.pictures.files import picture_files, write_picture_files
from camctl.records.folder_store import FolderStore
from camctl.records.frame_store import MemoryStore


@pytest.mark.parametrize(
    ("layout", "response"), some(product(Layout, ("linear", "gamma", "log")), every=5)
)
def test_strips_leave_no_seam(
    layout: Layout, response: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    total, how = rendered(layout, response)
    stores = []
    for samples in (1 << 20, 150):
        monkeypatch.setattr(pictures, "STRIP_SAMPLES", samples)
        folder = tmp_path / str(samples)
        folder.mkdir()
        stores.append(FolderStore(folder))
        write_picture_files(total, how, details(), folder)
    whole, strips = stores
    for kind in ("image", "radiance", "deviation", "mask"):
        assert np.array_equal(whole.picture(kind), strips.picture(kind), equal_nan=True)
    if not layout.is_mosaic:
        assert np.array_equal(whole.picture("image"), how.tables[0].code[total])


@pytest.mark.parametrize("layout", list(Layout))
def test_files_and_memory_hold_the_same_arrays(layout: Layout, tmp_path: Path) -> None:
    total, how = rendered(layout)
    folder, memory = FolderStore(tmp_path), MemoryStore()
    write_picture_files(total, how, details(), tmp_path)
    assert memory.keep_pictures(total, how, details()) == {}
    assert {path.name for path in tmp_path.iterdir()} == set(picture_files(how).values())
    shape = (37, 22) if layout is Layout.MONO else (37, 22, 3)
    for name, dtype in {"image": np.uint16, "radiance": np.float32, "mask": np.uint8}.items():
        from_file, from_memory = folder.picture(name), memory.picture(name)
        assert np.array_equal(from_file, from_memory)
        assert from_file.dtype == from_memory.dtype == dtype
        assert from_file.shape == shape
    assert np.array_equal(folder.picture("sum"), total)
    assert np.array_equal(memory.picture("sum"), total)


@pytest.mark.parametrize(("full_scale", "halves"), [(2.0, True), (2e7, False), (2e-7, False)])
@pytest.mark.parametrize("layout", some(Layout, every=2))
def test_channels_of_radiance_exr(
    layout: Layout, full_scale: float, halves: bool, tmp_path: Path
) -> None:
    """Light and deviations are float16 where that has them: neither tiny nor huge."""
    total, how = rendered(layout, unit=full_scale)
    write_picture_files(total, how, details(), tmp_path)
    with OpenEXR.File(str(tmp_path / "radiance.exr"), separate_channels=True) as file:
        types = {name: channel.pixels.dtype for name, channel in file.channels().items()}
    names = "Y" if layout is Layout.MONO else "RGB"
    expected: dict[str, type[np.generic]] = {f"mask.{name}": np.float16 for name in names}
    kind = np.float16 if halves else np.float32
    for name in names:
        expected |= {name: kind, f"sd.{name}": kind}
    assert types == expected
    memory = MemoryStore()
    memory.keep_pictures(total, how, details())
    for each in ("radiance", "deviation"):
        found = FolderStore(tmp_path).picture(each)
        assert found.dtype == np.float32
        assert np.array_equal(found, memory.picture(each))


def test_small_deviations_are_halves_within_a_32nd(tmp_path: Path) -> None:
    """Those of 2^-20 to 2^-15 of the unit, which float16 has with fewer bits; in run lengths."""
    total, how = rendered(Layout.RGB)
    how = replace(
        how, light=replace(how.light, unit=how.light.deviations[0] * how.light.unit * 2**19)
    )
    write_picture_files(total, how, details(), tmp_path)
    with OpenEXR.File(str(tmp_path / "radiance.exr"), separate_channels=True) as file:
        assert {channel.pixels.dtype for channel in file.channels().values()} == {np.dtype("f2")}
        assert file.header()["compression"] == OpenEXR.RLE_COMPRESSION
    memory = MemoryStore()
    memory.keep_pictures(total, how, details())
    exact = memory.picture("deviation")
    assert 2.0**-20 < exact.min() < 2.0**-18
    found = FolderStore(tmp_path).picture("deviation")
    np.testing.assert_allclose(found, exact, rtol=1 / 32)
    light = FolderStore(tmp_path).picture("radiance") - memory.picture("radiance")
    known = np.isfinite(exact)
    assert (np.abs(light)[known] <= exact[known] / 16).all()


@pytest.mark.parametrize("exactness", [1, 16])
def test_light_of_many_digits_or_negative_is_kept(exactness: int, tmp_path: Path) -> None:
    """Colours outside of BT.709 are negative; light with little noise needs float32."""
    total, how = rendered(Layout.RGB)
    matrix = (1.8, -0.6, -0.2), (-0.3, 1.6, -0.3), (0.0, -0.7, 1.7)
    parts = tuple(
        (part, replace(each, deviation=each.deviation / exactness))
        for part, each in how.light.parts
    )
    how = replace(how, colour=CameraColour(matrix), light=replace(how.light, parts=parts))
    write_picture_files(total, how, details(), tmp_path)
    with OpenEXR.File(str(tmp_path / "radiance.exr"), separate_channels=True) as file:
        assert file.channels()["R"].pixels.dtype == (np.float16 if exactness == 1 else np.float32)
    memory = MemoryStore()
    memory.keep_pictures(total, how, details())
    light = FolderStore(tmp_path).picture("radiance")
    assert light.min() < 0
    assert np.array_equal(light, memory.picture("radiance"))


@pytest.mark.parametrize("layout", list(Layout))
def test_radiance_is_the_estimate_from_all_frames(layout: Layout, tmp_path: Path) -> None:
    """It is rounded by a 10th of its deviation; the pixels of a mosaic are interpolated."""
    total, how = rendered(layout)
    write_picture_files(total, how, details(), tmp_path)
    frames = [how.frames(place, slice(None)) for place in range(how.count)]
    found = combine(frames, [2.0, 8.0], black=2, noise=NOISE, white=65, response=linear_response(6))
    store = FolderStore(tmp_path)
    radiance, deviation = store.picture("radiance"), store.picture("deviation")
    if layout.is_mosaic:
        letters = layout.value.upper()
        for place, letter in enumerate(letters):
            own = (slice(place // 2, None, 2), slice(place % 2, None, 2))
            channel = "RGB".index(letter)
            close = np.abs(radiance[own][..., channel] - found.irradiance[own])
            assert (close <= found.sd[own] / 10).all()
        return
    known = np.isfinite(found.sd)
    assert (np.abs(radiance - found.irradiance)[known] <= found.sd[known] / 10).all()
    assert np.array_equal(known, np.isfinite(deviation))
    np.testing.assert_allclose(deviation, found.sd, rtol=1e-3)


@pytest.mark.parametrize("layout", list(Layout))
def test_noise_that_is_not_known_has_no_deviation(layout: Layout, tmp_path: Path) -> None:
    total, how = rendered(layout, noise=None)
    write_picture_files(total, how, details(), tmp_path)
    store = FolderStore(tmp_path)
    light, deviation = store.picture("radiance"), store.picture("deviation")
    assert np.isfinite(light).all()
    within = store.picture("mask") & 2 == 0
    assert np.isnan(deviation[within]).all()
    assert (tmp_path / "preview.png").exists()


def test_preview_is_made_from_reduced_light(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cv2: Any
) -> None:
    monkeypatch.setattr("camctl.pictures.preview_light.PREVIEW_SIDE", 10)
    monkeypatch.setattr(pictures, "STRIP_SAMPLES", 100)
    light = np.linspace(0, 0.99, 23 * 37 * 3).reshape(23, 37, 3)
    total, how = rendered(Layout.RGB, light=light)
    write_picture_files(total, how, details(), tmp_path)
    preview = cv2.imread(str(tmp_path / "preview.png"), cv2.IMREAD_UNCHANGED)
    assert preview is not None
    assert preview.shape == (5, 9, 3)
    rows = preview.mean(axis=(1, 2))
    assert (np.diff(rows) > 0).all()


@pytest.mark.parametrize(
    ("file", "kind"),
    [
        ("sum.tiff", "sum"),
        ("image.tiff", "image"),
        ("radiance.exr", "radiance"),
        ("radiance.exr", "mask"),
        ("radiance.exr", "deviation"),
        ("frames/frame-01.npy", "frame"),
    ],
)
@pytest.mark.parametrize("content", [None, b"", b"II*\0 and no more", b"v/1\x01 and no more"])
def test_missing_or_damaged_file_is_a_data_error_that_names_it(
    file: str, kind: str, content: bytes | None, tmp_path: Path
) -> None:
    store = FolderStore(tmp_path / "here")
    (tmp_path / "here" / "frames").mkdir(parents=True)
    if content is not None:
        (tmp_path / "here" / file).write_bytes(content)
    with pytest.raises(DataError, match=file) as failure:
        store.frame(0) if kind == "frame" else store.picture(kind)
    assert "\n" not in str(failure.value)
