"""The picture files: strips leave no seam, and files and memory hold the same arrays."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from numpy.typing import NDArray
from picture_parts import details

from camctl.errors import DataError
from camctl.interface.controls import Layout
from camctl.model.effective import EffectiveCamera
from camctl.model.inverse import Posterior
from camctl.model.noise import FrameNoise
from camctl.model.response.camera import linear_response
from camctl.model.response.desired import desired_response
from camctl.pictures import render as pictures
from camctl.pictures.files import PICTURE_FILES, write_picture_files
from camctl.pictures.render import Rendering, Tables
from camctl.records.folder_store import FolderStore
from camctl.records.frame_store import MemoryStore

BLACK = 5
EFFECTIVE = EffectiveCamera.of(linear_response(6), [1.0, 4.0])
NOISE = [FrameNoise(50.0, 0.2, black=2), FrameNoise(50.0, 0.2, black=3)]


def rendering(layout: Layout, response: str = "log") -> Rendering:
    desired = desired_response(response, 100.0)
    tables = Tables.of(Posterior(EFFECTIVE, desired, NOISE), 2.0)
    return Rendering(layout, (tables,), desired, 2.0)


def random_sum(layout: Layout) -> NDArray[np.uint16]:
    shape = (37, 22, 3) if layout is Layout.RGB else (37, 22)
    top = EFFECTIVE.levels_total + BLACK
    return np.random.default_rng(0).integers(0, top + 1, shape).astype(np.uint16)


@pytest.mark.parametrize("layout", list(Layout))
@pytest.mark.parametrize("response", ["linear", "gamma", "log"])
def test_strips_leave_no_seam(
    layout: Layout, response: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    total, how = random_sum(layout), rendering(layout, response)
    stores = []
    for samples in (1 << 20, 150):
        monkeypatch.setattr(pictures, "STRIP_SAMPLES", samples)
        folder = tmp_path / str(samples)
        folder.mkdir()
        stores.append(FolderStore(folder))
        write_picture_files(total, how, details(), folder)
    whole, strips = stores
    for kind in ("image", "radiance", "deviation", "mask"):
        assert np.array_equal(whole.picture(kind), strips.picture(kind))
    if not layout.is_mosaic:
        assert np.array_equal(whole.picture("image"), how.tables[0].code[total])


@pytest.mark.parametrize("layout", list(Layout))
def test_files_and_memory_hold_the_same_arrays(layout: Layout, tmp_path: Path) -> None:
    total, how = random_sum(layout), rendering(layout)
    folder, memory = FolderStore(tmp_path), MemoryStore()
    write_picture_files(total, how, details(), tmp_path)
    assert memory.keep_pictures(total, how, details()) == {}
    assert {path.name for path in tmp_path.iterdir()} == set(PICTURE_FILES.values())
    shape = (37, 22) if layout is Layout.MONO else (37, 22, 3)
    for name, dtype in {"image": np.uint16, "radiance": np.float32, "mask": np.uint8}.items():
        from_file, from_memory = folder.picture(name), memory.picture(name)
        assert np.array_equal(from_file, from_memory)
        assert from_file.dtype == from_memory.dtype == dtype
        assert from_file.shape == shape
    assert np.array_equal(folder.picture("sum"), total)
    assert np.array_equal(memory.picture("sum"), total)


@pytest.mark.parametrize(("full_scale", "halves"), [(2.0, True), (2e7, False), (2e-7, False)])
@pytest.mark.parametrize("layout", list(Layout))
def test_channels_of_radiance_exr(
    layout: Layout, full_scale: float, halves: bool, tmp_path: Path
) -> None:
    """Deviations are float16 where that has them: neither tiny nor huge."""
    how = rendering(layout)
    desired, posterior = how.desired, Posterior(EFFECTIVE, how.desired, NOISE)
    how = Rendering(layout, (Tables.of(posterior, full_scale),), desired, full_scale)
    total = random_sum(layout)
    write_picture_files(total, how, details(), tmp_path)
    with OpenEXR.File(str(tmp_path / "radiance.exr"), separate_channels=True) as file:
        types = {name: channel.pixels.dtype for name, channel in file.channels().items()}
    names = "Y" if layout is Layout.MONO else "RGB"
    expected: dict[str, type[np.generic]] = {f"mask.{name}": np.float16 for name in names}
    deviation = np.float16 if halves else np.float32
    for name in names:
        expected |= {name: np.float32, f"sd.{name}": deviation}
    assert types == expected
    found = FolderStore(tmp_path).picture("deviation")
    memory = MemoryStore()
    memory.keep_pictures(total, how, details())
    assert found.dtype == np.float32
    assert np.array_equal(found, memory.picture("deviation"))
    if not layout.is_mosaic:
        assert np.array_equal(found, how.tables[0].deviation[total])


def test_preview_is_made_from_reduced_light(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cv2: Any
) -> None:
    monkeypatch.setattr("camctl.pictures.preview_light.PREVIEW_SIDE", 10)
    monkeypatch.setattr(pictures, "STRIP_SAMPLES", 100)
    total = np.linspace(BLACK, EFFECTIVE.levels_total, 23 * 37 * 3).astype(np.uint16)
    write_picture_files(total.reshape(23, 37, 3), rendering(Layout.RGB), details(), tmp_path)
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
