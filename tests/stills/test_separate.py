"""Pictures of others: decoded in another process, whatever becomes of that."""

from __future__ import annotations

import contextlib
import os
import resource
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from device_readers import still_files

from camctl.errors import CameraProtocolError, DataError
from camctl.pictures.files import read_deviation, read_mask, read_radiance, read_tiff
from camctl.sim.scenes.scene import load_scene
from camctl.stills import maps, separate
from camctl.stills.decoding import read_still
from camctl.stills.files import read_photograph
from camctl.stills.maps import exr_exposure, exr_shape, read_exr
from camctl.stills.radiance_map import read_exr_exposure, read_map, read_shape
from camctl.stills.separate import read_apart

pytest.importorskip("rawpy", reason="rawpy is not installed")


def test_a_raw_file_is_the_same_from_another_process(tmp_path: Path) -> None:
    data = still_files()["a.dng"]
    here, apart = read_still(data, "a.dng"), read_apart(data, "a.dng")
    assert np.array_equal(here.pixels, apart.pixels)
    assert apart.pixels.dtype == here.pixels.dtype
    assert {**vars(here), "pixels": 0} == {**vars(apart), "pixels": 0}
    with pytest.raises(CameraProtocolError):
        read_apart(b"no raw file at all", "a.dng")
    for name in ("a.jpg", "a.tif"):  # after an error, and of few bytes
        here, apart = read_still(still_files()[name], name), read_apart(still_files()[name], name)
        assert np.array_equal(here.pixels, apart.pixels)
    assert len(separate._free) == 1  # the same process has answered
    (tmp_path / "b.cr2").write_bytes(b"no raw file at all")
    with pytest.raises(DataError):
        read_photograph(tmp_path / "b.cr2")


@pytest.mark.parametrize(
    ("program", "why"),
    [
        ("import os; input(); os.kill(os.getpid(), 11)", "crashed .SIGSEGV"),
        ("import os; os.kill(os.getpid(), 24)", "takes more than a minute"),
        ("print(input()[:0])", "without an answer"),
        ('input(); print(\'{"shape": [1000000, 1000000], "dtype": "uint16"}\')', "cannot be read"),
    ],
)
def test_a_decoder_that_fails_is_the_error_of_its_file(
    monkeypatch: pytest.MonkeyPatch, program: str, why: str
) -> None:
    monkeypatch.setattr(separate, "_COMMAND", (sys.executable, "-c", program))
    monkeypatch.setattr(separate, "_free", [])
    with pytest.raises(CameraProtocolError, match=why):
        read_apart(bytes(100), "a.cr2")
    assert separate._free == []


def write_exr(path: Path, side: int = 64, *, tiled: bool = False, **header: Any) -> bytes:
    """Write a small file of equal colours; return its bytes."""
    import OpenEXR

    kind = OpenEXR.tiledimage if tiled else OpenEXR.scanlineimage
    header |= {"tiles": OpenEXR.TileDescription()} if tiled else {}
    header |= {"compression": OpenEXR.ZIP_COMPRESSION, "type": kind}
    channels = {name: np.full((side, side), value, np.float32) for value, name in enumerate("RGB")}
    OpenEXR.File(header, channels).write(str(path))
    return path.read_bytes()


def with_window(data: bytes, columns: int, rows: int) -> bytes:
    """Return an OpenEXR file that states another size than its chunks have."""
    for name in (b"dataWindow\0box2i\0", b"displayWindow\0box2i\0"):
        at = data.index(name) + len(name) + 4
        data = data[:at] + struct.pack("<4i", 0, 0, columns - 1, rows - 1) + data[at + 16 :]
    return data


def test_an_openexr_file_is_the_same_from_another_process(tmp_path: Path) -> None:
    path = tmp_path / "caf\u00e9 \udcff.exr"  # a name that is no UTF-8
    write_exr(tmp_path / "a.exr", expTime=0.25, isoSpeed=200.0, aperture=float("inf"))
    (tmp_path / "a.exr").rename(path)
    here, apart = read_exr(path), read_map(path)
    assert np.array_equal(here[0], apart[0])
    assert (here[0].dtype, here[1]) == (apart[0].dtype, apart[1])
    assert read_shape(path) == exr_shape(path) == (64, 64, 3)
    stated = {"expTime": 0.25, "isoSpeed": 200.0}
    assert read_exr_exposure(path) == exr_exposure(path) == stated
    assert os.fstat(separate._free[-1].shared.fileno()).st_size == 0  # no map is kept


def peak_memory() -> int:
    """Return the largest memory of this process so far, kB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


@pytest.mark.parametrize("tiled", [False, True])
def test_hostile_openexr_files_are_refused_at_once(tmp_path: Path, *, tiled: bool) -> None:
    path = tmp_path / "a.exr"
    whole = write_exr(path, tiled=tiled)
    sizes = [(1 << 30, 1 << 30), (1 << 20, 1 << 12), (1, 1 << 30), (100_000, 100_000), (-5, -5)]
    hostile = [with_window(whole, *size) for size in sizes]
    hostile += [whole[:length] for length in (0, 8, 100, len(whole) // 2, len(whole) - 1)]
    hostile += [whole[:8] + bytes(4000), whole[:400] + b"\xff" * 4000]
    before = peak_memory()
    for data in hostile:
        path.write_bytes(data)
        with pytest.raises(DataError):
            read_map(path)
        for read in (read_exr_exposure, read_shape):
            with contextlib.suppress(DataError):  # the head of some can be read
                read(path)
    assert peak_memory() - before < 64 << 10


def test_an_openexr_file_that_becomes_large_ends_no_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """150 kB become 48 MB; the process may have 16 MiB here, instead of 4 GiB."""
    program = (
        "import sys, os; from camctl.stills import worker; worker._MOST_BYTES = 16 << 20; "
        "worker.serve(sys.stdin.buffer, sys.stdout.buffer, int(sys.argv[1]))"
    )
    monkeypatch.setattr(separate, "_COMMAND", (sys.executable, "-c", program))
    monkeypatch.setattr(separate, "_free", [])
    write_exr(tmp_path / "a.exr", 2000)
    with pytest.raises(DataError, match=r"a\.exr.*cannot be read"):
        read_map(tmp_path / "a.exr")


@pytest.mark.parametrize("signal", [11, 24])
@pytest.mark.parametrize("name", ["a.exr", "a.tiff", "radiance.exr", "sum.tiff"])
def test_a_map_that_ends_its_decoder_is_one_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, signal: int
) -> None:
    """Scenes, photographs and the files of a capture folder, which may be somebody else's."""
    program = f"import os; input(); os.kill(os.getpid(), {signal})"
    monkeypatch.setattr(separate, "_COMMAND", (sys.executable, "-c", program))
    monkeypatch.setattr(separate, "_free", [])
    (tmp_path / name).write_bytes(b"what a decoder cannot stand")
    reads: dict[str, list[Callable[[Path], object]]] = {
        "radiance.exr": [read_radiance, read_mask, read_deviation],
        "sum.tiff": [read_tiff],
    }
    for read in reads.get(name, [read_map, read_shape]):
        with pytest.raises(DataError, match="SIGSEGV" if signal == 11 else "more than a minute"):
            read(tmp_path / name)
    assert separate._free == []


def test_hostile_tiff_maps_are_refused_at_once(tmp_path: Path) -> None:
    import tifffile

    path = tmp_path / "a.tiff"
    tifffile.imwrite(path, np.ones((60, 70, 3), np.float32), photometric="rgb", compression="zlib")
    whole = path.read_bytes()
    assert np.array_equal(read_map(path)[0], maps.read_tiff(path)[0])
    columns = whole.index(struct.pack("<HHI", 256, 4, 1)) + 8
    rows = whole.index(struct.pack("<HHI", 257, 4, 1)) + 8
    sizes = [(0, 0), (1 << 20, 1 << 20), (1, 1 << 31), (1 << 31, 60)]
    hostile = [whole[:length] for length in (0, 8, 100, len(whole) // 2)]
    for size in sizes:
        changed = bytearray(whole)
        changed[columns : columns + 4] = struct.pack("<I", size[0])
        changed[rows : rows + 4] = struct.pack("<I", size[1])
        hostile.append(bytes(changed))
    before = peak_memory()
    for data in hostile:
        path.write_bytes(data)
        with pytest.raises(DataError):
            load_scene(path)
        with pytest.raises(DataError):
            read_tiff(path)
    assert peak_memory() - before < 64 << 10


_ENDLESS_PAGES = bytes.fromhex(
    "49492a0008000000130000010400010000000800000001010400010000000600000002010300010000001000"
    "00000301030001000000010000000601030001000000010000000e01020054000000f20000000f0102000700"
    "00004601000010010200130000004e0100001101040001000000b00100001501030001000000010000001601"
    "040001000000060000001701040001000000600000001a01050001000000620100001b010500010000006a01"
    "0000280103000100000001000000310102000d0049492a000800000013000001040001000000080000000101"
    "0400010000000600000002010300010000001000000003010000720100003201020014000000800300010000"
    "01"
)
"""265 bytes that atheris found: tifffile makes pages of them for more than a minute."""


def test_a_short_tiff_file_of_endless_pages_takes_no_time(tmp_path: Path) -> None:
    path = tmp_path / "sum.tiff"
    path.write_bytes(_ENDLESS_PAGES)
    began = time.process_time()
    with pytest.raises(ValueError, match="failed to read 96 bytes"):
        maps.read_tiff(path)
    assert maps.tiff_shape(path) == (6, 8)
    assert time.process_time() - began < 5
    with pytest.raises(DataError, match="failed to read 96 bytes"):
        read_tiff(path)


def test_of_several_pictures_in_a_tiff_file_the_first_one_is_read(tmp_path: Path) -> None:
    import tifffile

    with tifffile.TiffWriter(tmp_path / "a.tiff") as file:
        for light in (1, 2):
            file.write(np.full((4, 6), light, np.float32), contiguous=False, metadata=None)
    values, notes = read_map(tmp_path / "a.tiff")
    assert values.tolist() == np.ones((4, 6)).tolist()
    assert notes == ("only the first of several pictures was read",)


def test_a_copy_of_the_process_asks_decoders_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    write_exr(path)
    read_map(path)
    (own,) = {each.process.pid for each in separate._free}
    child = os.fork()
    if child == 0:
        status = 1
        with contextlib.suppress(BaseException):
            started = not separate._free
            read_map(path)
            status = 0 if started and separate._free[0].process.pid != own else 2
            separate._end_all()
        os._exit(status)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    assert [each.process.pid for each in separate._free] == [own]


def test_the_process_that_decodes_starts_without_the_models_of_records() -> None:
    """They take as long to be imported as all that it needs."""
    code = "import sys, camctl.stills.worker; print('pydantic' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
