"""Radiance maps from files of every kind, good and bad."""

from __future__ import annotations

import contextlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as st_np

from camctl.errors import CamctlError, DataError
from sim.camera import SimulatedCamera
from sim.scenes.radiance_map import SUFFIXES, read_rgbe
from sim.scenes.scene import load_scene
from sim.sensors.sensor import load_sensor


def colours(rows: int = 20, columns: int = 30) -> np.ndarray:
    random = np.random.default_rng(5)
    return (
        random.random((rows, columns, 3)) * 10.0 ** random.uniform(-3, 3, (rows, columns, 1))
    ).astype(np.float32)


def write_rgbe(path: Path, light: np.ndarray, *, coded: bool = True) -> np.ndarray:
    """Write a Radiance picture by the book; return what a reader must find in it."""
    exponent = np.frexp(light.max(axis=2))[1]
    scale = np.ldexp(1.0, 8 - exponent)[..., np.newaxis]
    rgb = np.floor(light * scale).astype(np.uint8)
    rgbe = np.dstack([rgb, (exponent + 128).astype(np.uint8)])
    rows, columns = light.shape[:2]
    data = bytearray(
        b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n" + f"-Y {rows} +X {columns}\n".encode()
    )
    for row in rgbe:
        if not coded:
            data += row.tobytes()
            continue
        data += bytes([2, 2, columns >> 8, columns & 255])
        for channel in row.T:
            place = 0
            while place < columns:
                same = 1
                while (
                    place + same < columns
                    and same < 127
                    and channel[place + same] == channel[place]
                ):
                    same += 1
                if same > 2:
                    data += bytes([128 + same, channel[place]])
                    place += same
                    continue
                literal = channel[place : place + 100]
                data += bytes([len(literal)]) + literal.tobytes()
                place += len(literal)
    path.write_bytes(bytes(data))
    return np.asarray((rgb + 0.5) * np.ldexp(1.0, exponent - 8)[..., np.newaxis])


@pytest.mark.parametrize("coded", [True, False])
def test_hdr(tmp_path: Path, coded: bool) -> None:
    light = colours()
    light[3:9] = light[2, 5]
    expected = write_rgbe(tmp_path / "a.hdr", light, coded=coded)
    scene = load_scene(tmp_path / "a.hdr")
    assert scene.is_coloured
    assert np.allclose(scene.irradiance, expected, rtol=1e-6)
    assert scene.notes == ()


def test_hdr_written_by_opencv(tmp_path: Path) -> None:
    cv2 = pytest.importorskip("cv2")
    light = colours(40, 50)
    assert cv2.imwrite(str(tmp_path / "a.hdr"), np.ascontiguousarray(light[..., ::-1]))
    read, _ = read_rgbe(tmp_path / "a.hdr")
    brightest = light.max(axis=2, keepdims=True)
    assert np.all(np.abs(read - light) <= brightest / 128)


def test_hdr_sent_as_text_is_brought_back(tmp_path: Path) -> None:
    columns = 300
    wave = 0.5 + 0.49 * np.sin(np.arange(columns) / 23)
    light = np.stack([np.full(columns, 0.9), wave, 0.03 + 0.03 * wave], axis=-1)
    light = np.broadcast_to(light, (25, columns, 3)) * np.linspace(0.6, 1, 25)[:, None, None]
    expected = write_rgbe(tmp_path / "whole.hdr", light)
    whole = (tmp_path / "whole.hdr").read_bytes()
    assert whole.count(b"\r") > 50
    damaged = whole.replace(b"\r\n", b"\n").replace(b"\r", b"\n").replace(b"\n", b"\r\n")
    (tmp_path / "sent.hdr").write_bytes(damaged)
    scene = load_scene(tmp_path / "sent.hdr")
    assert "transfer as text" in scene.notes[0]
    with SimulatedCamera(scene, load_sensor("standard")) as camera:
        assert camera.controls.notes == scene.notes
    brightest = expected.max(axis=2, keepdims=True)
    off = np.abs(scene.irradiance - expected) / brightest
    assert off.max() < 0.06
    assert np.mean(off > 0.005) < 0.05


def test_the_memorial_church(real_data: Path) -> None:
    scene = load_scene(real_data / "memorial" / "memorial.hdr")
    assert scene.shape == (768, 512)
    assert scene.is_coloured
    assert scene.dynamic_range > 1e5
    # A picture read out of step tears; in this one neighbours are alike.
    steps = np.abs(np.diff(np.log(scene.irradiance.mean(axis=2) + 1e-6), axis=1))
    assert np.median(steps) < 0.1


def test_exr(tmp_path: Path) -> None:
    OpenEXR = pytest.importorskip("OpenEXR")
    light = colours()
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGB": light}).write(str(tmp_path / "a.exr"))
    assert np.array_equal(load_scene(tmp_path / "a.exr").irradiance, light)
    OpenEXR.File(header, {"Y": light[..., 0].copy()}).write(str(tmp_path / "y.exr"))
    assert np.array_equal(load_scene(tmp_path / "y.exr").irradiance, light[..., 0])
    OpenEXR.File(header, {"A": light[..., 0].copy(), "Z": light[..., 1].copy()}).write(
        str(tmp_path / "z.exr")
    )
    with pytest.raises(DataError, match="its channels are A, Z"):
        load_scene(tmp_path / "z.exr")


@pytest.mark.parametrize("suffix", [".tif", ".tiff"])
def test_tiff(tmp_path: Path, suffix: str) -> None:
    import tifffile

    light = colours()
    path = tmp_path / f"a{suffix}"
    tifffile.imwrite(path, light, photometric="rgb")
    assert np.array_equal(load_scene(path).irradiance, light)
    tifffile.imwrite(path, np.moveaxis(light, -1, 0), photometric="rgb", planarconfig="separate")
    assert np.array_equal(load_scene(path).irradiance, light)
    tifffile.imwrite(path, (light[..., 0] * 60).astype(np.uint16), photometric="minisblack")
    assert load_scene(path).irradiance.shape == light.shape[:2]


def test_npy(tmp_path: Path) -> None:
    light = colours()
    np.save(tmp_path / "a.npy", light.astype(np.float64))
    assert np.array_equal(load_scene(tmp_path / "a.npy").irradiance, light)


def test_missing_and_unknown_files(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no such file"):
        load_scene(tmp_path / "none.hdr")
    (tmp_path / "a.xyz").write_text("x")
    with pytest.raises(DataError, match="not a kind of radiance map"):
        load_scene(tmp_path / "a.xyz")


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("content", [b"", b"nonsense", b"#?RADIANCE\n\n-Y 5 +X 5\n\x01\x02"])
def test_damaged_files_are_one_line(tmp_path: Path, suffix: str, content: bytes) -> None:
    path = tmp_path / f"bad{suffix}"
    path.write_bytes(content)
    with pytest.raises(DataError) as error:
        load_scene(path)
    assert "\n" not in str(error.value)
    assert str(path) in str(error.value)


def test_a_folder_is_no_map(tmp_path: Path) -> None:
    (tmp_path / "a.npy").mkdir()
    with pytest.raises(DataError):
        load_scene(tmp_path / "a.npy")


def test_a_gigantic_map_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "big.hdr"
    path.write_bytes(b"#?RADIANCE\n\n-Y 1000000 +X 1000000\n")
    with pytest.raises(DataError, match="GiB"):
        load_scene(path)


def test_pickles_are_never_opened(tmp_path: Path) -> None:
    np.save(tmp_path / "evil.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(DataError):
        load_scene(tmp_path / "evil.npy")


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.binary(max_size=400), start=st.booleans())
def test_fuzzed_pictures_end_in_light_or_in_one_line(
    tmp_path: Path, data: bytes, start: bool
) -> None:
    path = tmp_path / "fuzz.hdr"
    head = b"#?RADIANCE\n\n-Y 3 +X 8\n\x02\x02\x00\x08" if start else b"#?RADIANCE\n"
    path.write_bytes(head + data)
    with contextlib.suppress(CamctlError):
        assert load_scene(path).shape == (3, 8)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=40)
@given(
    rgbe=st_np.arrays(
        np.uint8, (4, 12, 4), elements=st.sampled_from([9, 10, 11, 12, 13, 14, 120, 130])
    )
)
def test_fuzzed_text_transfers_never_break_out(tmp_path: Path, rgbe: np.ndarray) -> None:
    data = bytearray(b"#?RADIANCE\n\n-Y 4 +X 12\n")
    for row in rgbe:
        data += bytes([2, 2, 0, 12])
        for channel in row.T:
            data += bytes([12]) + channel.tobytes()
    sent = bytes(data).replace(b"\r\n", b"\n").replace(b"\r", b"\n").replace(b"\n", b"\r\n")
    (tmp_path / "sent.hdr").write_bytes(sent)
    with contextlib.suppress(CamctlError):
        assert load_scene(tmp_path / "sent.hdr").shape == (4, 12)


def test_no_library_is_imported_before_a_file_needs_it() -> None:
    code = (
        "import sys, sim.backend, sim.scenes.scene; sim.scenes.scene.load_scene('ramp', (4, 4));"
        "print([m for m in ('cv2', 'OpenEXR', 'tifffile', 'scipy') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
