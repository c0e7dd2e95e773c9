"""Radiance maps: each type of file is read, and a damaged file is one line of error."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from camctl.errors import CamctlError, DataError
from camctl.sim.scenes.scene import load_scene
from camctl.stills.radiance_map import SUFFIXES, read_map

HEADER = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n"


def colours(rows: int = 20, columns: int = 30) -> NDArray[np.float32]:
    random = np.random.default_rng(5)
    return (
        random.random((rows, columns, 3)) * 10.0 ** random.uniform(-3, 3, (rows, columns, 1))
    ).astype(np.float32)


def write_rgbe(
    path: Path, light: NDArray[np.float32], *, coded: bool = True, header: bytes = HEADER
) -> NDArray[np.float64]:
    """Write a Radiance picture as the format defines it; return what a reader must return."""
    exponent = np.frexp(light.max(axis=2))[1]
    scale = np.ldexp(1.0, 8 - exponent)[..., np.newaxis]
    rgb = np.floor(light * scale).astype(np.uint8)
    rgbe = np.dstack([rgb, (exponent + 128).astype(np.uint8)])
    rows, columns = light.shape[:2]
    data = bytearray(header + f"-Y {rows} +X {columns}\n".encode())
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


@pytest.mark.parametrize("coded", [True, False], ids=["run-length coded", "plain"])
def test_hdr(tmp_path: Path, coded: bool) -> None:
    light = colours()
    light[3:9] = light[2, 5]
    expected = write_rgbe(tmp_path / "a.hdr", light, coded=coded)
    scene = load_scene(tmp_path / "a.hdr")
    assert scene.is_coloured
    assert np.allclose(scene.irradiance, expected, rtol=1e-6)
    assert scene.notes == ()


@pytest.mark.parametrize(
    "before",
    [
        b"VIEW= -vtv -vh 90 -vv 150\n#?RADIANCE\npvalue -h -H +y 20 +x 30 -df\n",
        b"rpict -x 30 -y 20 room.oct\n#?RGBE\nEXPOSURE=2.0\n",
    ],
    ids=["RADIANCE", "RGBE"],
)
def test_hdr_with_a_line_before_the_signature(tmp_path: Path, before: bytes) -> None:
    """Ward's programs write such headers."""
    header = before + b"FORMAT=32-bit_rle_rgbe\npflip -v\n\n"
    expected = write_rgbe(tmp_path / "a.hdr", colours(), header=header)
    scene = load_scene(tmp_path / "a.hdr")
    assert scene.shape == (20, 30)
    assert np.allclose(scene.irradiance, expected, rtol=1e-6)


def test_hdr_stored_from_bottom_to_top(tmp_path: Path) -> None:
    expected = write_rgbe(tmp_path / "a.hdr", colours())
    data = (tmp_path / "a.hdr").read_bytes()
    (tmp_path / "b.hdr").write_bytes(data.replace(b"-Y 20", b"+Y 20"))
    assert np.allclose(load_scene(tmp_path / "b.hdr").irradiance, expected[::-1], rtol=1e-6)


def test_hdr_written_by_opencv(tmp_path: Path) -> None:
    cv2 = pytest.importorskip("cv2")
    light = colours(40, 50)
    assert cv2.imwrite(str(tmp_path / "a.hdr"), np.ascontiguousarray(light[..., ::-1]))
    read, _ = read_map(tmp_path / "a.hdr")
    brightest = light.max(axis=2, keepdims=True)
    assert np.all(np.abs(read - light) <= brightest / 128)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        (b"P6\n\n-Y 2 +X 2\n", "not a Radiance picture; its header lacks #[?]RADIANCE"),
        (b"#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n-Y 2 +X 2\n", "colours are XYZ"),
        (b"#?RADIANCE\n\n+X 2 -Y 2\n", "expected -Y rows [+]X columns"),
        (b"#?RADIANCE\n\n-Y 2 -X 2\n", "expected -Y rows [+]X columns"),
        (b"#?RADIANCE\n" + b"comment\n" * 300, "the Radiance header does not end"),
    ],
    ids=["no signature", "XYZ", "columns first", "mirrored", "endless"],
)
def test_hdr_with_an_unsupported_header(tmp_path: Path, header: bytes, message: str) -> None:
    (tmp_path / "a.hdr").write_bytes(header)
    with pytest.raises(DataError, match=message):
        load_scene(tmp_path / "a.hdr")


def test_hdr_of_the_memorial_scene(real_data: Path) -> None:
    scene = load_scene(real_data / "memorial" / "memorial.hdr")
    assert scene.shape == (768, 512)
    assert scene.is_coloured
    assert scene.notes == ()
    positive = scene.irradiance[scene.irradiance > 0]
    assert positive.max() / positive.min() > 1e5
    # Neighbours are alike, which they are not if scan lines are decoded out of step.
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
    with pytest.raises(DataError, match="no colour or luminance among channels A, Z"):
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


def test_missing_files_and_unknown_types_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="No such file"):
        load_scene(tmp_path / "none.hdr")
    (tmp_path / "a.xyz").write_text("x")
    with pytest.raises(DataError, match=r"unknown file type \.xyz; known: \.hdr"):
        load_scene(tmp_path / "a.xyz")


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize(
    "content",
    [b"", b"random text", b"#?RADIANCE\n\n-Y 5 +X 5\n\x01\x02"],
    ids=["empty", "text", "cut short"],
)
def test_a_damaged_file_is_one_line_of_error(tmp_path: Path, suffix: str, content: bytes) -> None:
    path = tmp_path / f"bad{suffix}"
    path.write_bytes(content)
    with pytest.raises(DataError) as error:
        load_scene(path)
    assert "\n" not in str(error.value)
    assert str(path) in str(error.value)


def test_a_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.npy").mkdir()
    with pytest.raises(DataError):
        load_scene(tmp_path / "a.npy")


def test_a_map_larger_than_memory_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "big.hdr"
    path.write_bytes(b"#?RADIANCE\n\n-Y 1000000 +X 1000000\n")
    with pytest.raises(DataError, match=r"need about [0-9.]+ GiB of memory, but [0-9.]+ GiB are"):
        load_scene(path)


@pytest.mark.parametrize("size", [b"9" * 4000, b"0", b"1" + b"0" * 9])
def test_an_impossible_size_in_a_radiance_header_is_refused(tmp_path: Path, size: bytes) -> None:
    path = tmp_path / "a.hdr"
    path.write_bytes(b"#?RADIANCE\n\n-Y " + size + b" +X " + size + b"\n")
    with pytest.raises(DataError, match=r"a.hdr: .*(invalid Radiance size|no pixels)"):
        load_scene(path)


def test_a_short_file_that_promises_many_rows_is_refused_before_memory_is_used(
    tmp_path: Path,
) -> None:
    path = tmp_path / "a.hdr"
    path.write_bytes(b"#?RADIANCE\n\n-Y 5000 +X 5000\n" + bytes(1000))
    tracemalloc.start()
    with pytest.raises(DataError, match="the data ends before the last row"):
        load_scene(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 10_000_000


def test_pickled_objects_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "evil.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(DataError):
        load_scene(tmp_path / "evil.npy")


# The folder of the test may be shared by its examples: each writes the file anew.
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(data=st.binary(max_size=400), start=st.booleans())
def test_any_bytes_are_read_or_refused(tmp_path: Path, data: bytes, start: bool) -> None:
    path = tmp_path / "fuzz.hdr"
    head = b"#?RADIANCE\n\n-Y 3 +X 8\n\x02\x02\x00\x08" if start else b"#?RADIANCE\n"
    path.write_bytes(head + data)
    with contextlib.suppress(CamctlError):
        assert load_scene(path).shape == (3, 8)


def test_no_library_is_imported_before_a_file_needs_it() -> None:
    code = (
        "import sys, sim.backend, sim.scenes.scene; sim.scenes.scene.load_scene('ramp', (4, 4));"
        "print([m for m in ('cv2', 'OpenEXR', 'tifffile', 'scipy') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_tiff_that_lacks_millions_of_strips_is_refused_before_they_are_looked_for(
    tmp_path: Path,
) -> None:
    """Such a file of 437 bytes took half a minute of processor time."""
    import tifffile

    path = tmp_path / "a.tiff"
    tifffile.imwrite(path, np.ones((6, 6), np.float32), compression="zlib", rowsperstrip=2)
    with tifffile.TiffFile(path, mode="r+") as file:
        file.pages.first.tags["ImageLength"].overwrite(1 << 24)
    with pytest.raises(DataError, match="most of its samples are missing"):
        read_map(path)
