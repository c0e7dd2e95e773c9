"""Files are complete or missing, and a full disk is an error of one line."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

from camctl import CaptureRequest, capture
from camctl.errors import StorageError
from camctl.sim.camera import SimulatedCamera
from camctl.sim.scenes.scene import load_scene
from camctl.sim.sensors.sensor import load_sensor
from camctl.system.files import atomic_file, remove_leftovers, write_array, write_bytes


def test_failed_write_keeps_the_earlier_file(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")

    def fail() -> None:
        with atomic_file(path) as part:
            part.write_bytes(b"half of the ne")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_written_arrays_are_read_by_numpy(tmp_path: Path) -> None:
    array = np.arange(12, dtype=np.uint16).reshape(3, 4)[:, ::2]
    write_array(tmp_path / "a.npy", array)
    assert np.array_equal(np.load(tmp_path / "a.npy"), array)


def test_file_in_place_of_a_folder_is_an_error_that_names_it(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(StorageError, match=r"cannot write .*file/a: a part of the path is a file"):
        write_bytes(tmp_path / "file" / "a", b"x")


def test_array_that_does_not_fit_is_an_error_of_one_line_and_leaves_no_file(
    tmp_path: Path,
) -> None:
    # A limit on file size fails exactly where a full disk does: in the middle of a write.
    script = f"""
        import resource, signal
        from pathlib import Path
        import numpy as np
        from camctl.system.files import write_array
        from camctl.errors import StorageError
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
        try:
            write_array(Path({str(tmp_path)!r}) / "a.npy", np.zeros(1_000_000, np.uint8))
        except StorageError as error:
            print(error)
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script)], capture_output=True, text=True, check=True
    )
    assert done.stdout.count("\n") == 1
    assert "grows beyond the limit" in done.stdout
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("sensor", "limit", "failing", "complete"),
    [
        ("standard", 60_000, "frames/frame-01.npy", {"frames", "report.json"}),
        ("standard", 100_000, "sum.tiff", {"frames", "report.json"}),
        # Light of 12 bits has more digits than float16.
        ("machine-vision", 160_000, "radiance.exr", {"frames", "report.json", "sum.tiff"}),
    ],
)
def test_picture_file_that_does_not_fit_is_missing_and_the_frames_are_kept(
    tmp_path: Path, sensor: str, limit: int, failing: str, complete: set[str]
) -> None:
    camera = SimulatedCamera(load_scene("tile-floor", (240, 320)), load_sensor(sensor))
    request = CaptureRequest(ratios=(1.0, 2.0))
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    try:
        with pytest.raises(StorageError) as raised:
            capture(camera, request, tmp_path / "out")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert str(raised.value).startswith(f"cannot write {tmp_path}/out/{failing}: ")
    assert "\n" not in str(raised.value)
    assert {path.name for path in (tmp_path / "out").iterdir()} == complete | {".camctl.lock"}
    assert not list((tmp_path / "out" / "frames").glob(".*"))


def test_a_file_never_replaces_a_pipe_or_a_folder(tmp_path: Path) -> None:
    """Root could rename a file over a device such as /dev/null."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    with pytest.raises(StorageError, match=r"cannot write .*pipe: it is no regular file"):
        write_bytes(tmp_path / "pipe", b"x")
    with pytest.raises(StorageError, match=r"cannot write .*folder: it is a folder"):
        write_bytes(tmp_path / "folder", b"x")
    assert (tmp_path / "pipe").is_fifo()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder", "pipe"]


def test_a_name_that_no_file_can_have_is_an_error_of_one_line(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match=r"cannot write .*: its name is too long"):
        write_bytes(tmp_path / ("x" * 300), b"x")


def test_only_what_an_ended_process_left_is_removed(tmp_path: Path) -> None:
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    numbers = {ended.pid: True, os.getppid(): False, os.getpid(): True, 9_999_999_999: True}
    for number in numbers:
        (tmp_path / f".a.json.{number}.part").write_text("{")
    others = {".b.json.1.part", ".a.json.1.part.x", "a.json"}
    for name in others:
        (tmp_path / name).touch()
    remove_leftovers(tmp_path / "a.json")
    kept = {f".a.json.{number}.part" for number, is_removed in numbers.items() if not is_removed}
    assert {path.name for path in tmp_path.iterdir()} == others | kept
    remove_leftovers(tmp_path / "missing" / "a.json")
