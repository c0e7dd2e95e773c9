"""Pictures from the sum: strips leave no seam, and every file says the same."""

import cv2
import numpy as np
import OpenEXR
import pytest
import tifffile

from camctl.captures import outputs as pictures
from camctl.captures.outputs import DARK, GOOD, SATURATED, Tables, encode, shares, write_pictures
from camctl.controls import Layout
from camctl.exposure.effective import EffectiveCamera
from camctl.response.camera import linear_response
from camctl.response.desired import desired_response

BLACK = 5


def tables_for(desired):
    effective = EffectiveCamera.of(linear_response(6), [1.0, 4.0])
    return Tables.of(effective, desired, BLACK, 2.0), effective


def written(directory):
    with OpenEXR.File(str(directory / "radiance.exr"), separate_channels=True) as file:
        channels = {name: channel.pixels.copy() for name, channel in file.channels().items()}
    return channels, tifffile.imread(directory / "image.tiff")


def test_tables_are_the_inverse_with_black_taken_off_once():
    desired = desired_response("log", 100.0)
    tables, effective = tables_for(desired)
    inverse = effective.irradiance_table()
    top = inverse.size - 1
    assert tables.irradiance.size == top + BLACK + 1
    assert np.array_equal(tables.irradiance[BLACK:], (inverse / 2).astype(np.float32))
    assert np.array_equal(tables.code[BLACK:], encode(desired, inverse))
    assert (tables.mask[: BLACK + 1] == DARK).all()
    assert (tables.mask[BLACK + 1 : -1] == GOOD).all()
    assert tables.mask[-1] == SATURATED
    assert not tables.irradiance[: BLACK + 1].any()


def test_shares_count_samples():
    tables, effective = tables_for(desired_response("log", 100.0))
    total = np.full((10, 10), BLACK + 20, np.uint16)
    total[0], total[1, :5] = BLACK + effective.levels_total, BLACK - 2
    outside = shares(total, tables)
    assert (outside.saturated, outside.dark) == (0.1, 0.05)


@pytest.mark.parametrize("layout", list(Layout))
@pytest.mark.parametrize("response", ["linear", "gamma", "log"])
def test_strips_leave_no_seam(layout, response, tmp_path, monkeypatch):
    desired = desired_response(response, 100.0)
    tables, effective = tables_for(desired)
    shape = (37, 22, 3) if layout is Layout.RGB else (37, 22)
    rng = np.random.default_rng(0)
    total = rng.integers(0, effective.levels_total + BLACK + 1, shape).astype(np.uint16)
    results = []
    for samples in (1 << 20, 150):
        monkeypatch.setattr(pictures, "_STRIP_SAMPLES", samples)
        folder = tmp_path / str(samples)
        folder.mkdir()
        write_pictures(total, layout, tables, desired, 2.0, folder)
        results.append(written(folder))
    (channels, image), (strip_channels, strip_image) = results
    assert np.array_equal(image, strip_image)
    assert channels.keys() == strip_channels.keys()
    for name, values in channels.items():
        assert np.array_equal(values, strip_channels[name])
    names = "Y" if layout is Layout.MONO else "RGB"
    assert set(channels) == {prefix + name for prefix in ("", "mask.") for name in names}
    if not layout.is_mosaic:
        assert np.array_equal(image, tables.code[total])


def test_preview_is_small_and_looks_like_the_image(tmp_path, monkeypatch):
    monkeypatch.setattr(pictures, "_PREVIEW_SIDE", 10)
    monkeypatch.setattr(pictures, "_STRIP_SAMPLES", 100)
    desired = desired_response("log", 100.0)
    tables, effective = tables_for(desired)
    total = np.linspace(BLACK, effective.levels_total, 23 * 37 * 3).astype(np.uint16)
    write_pictures(total.reshape(23, 37, 3), Layout.RGB, tables, desired, 2.0, tmp_path)
    preview = cv2.imread(str(tmp_path / "preview.png"), cv2.IMREAD_UNCHANGED)
    image = tifffile.imread(tmp_path / "image.tiff")
    assert preview.shape == (6, 10, 3)
    assert np.array_equal(preview[..., ::-1], np.rint(image[::4, ::4] / 257).astype(np.uint8))
