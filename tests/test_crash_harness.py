"""The crash harness itself: it must lose what a power cut loses, and nothing else."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from crash_points import Operation, PowerLoss, is_possible, run

from camctl.system.files import make_folder, write_array, write_bytes

pytestmark = [
    pytest.mark.skipif(not is_possible(), reason="crash points need Linux on x86-64"),
    pytest.mark.usefixtures("slow_disk"),
]


def write(path: Path, data: bytes, *, sync: bool) -> None:
    with path.open("wb", buffering=0) as file:
        file.write(data)
        if sync:
            os.fsync(file.fileno())


def sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    os.fsync(descriptor)
    os.close(descriptor)


def after_power_cut(tmp_path: Path, body: Callable[[Path], None]) -> dict[str, bytes]:
    """Return the files of a folder that held `old` after `body` ran and the power failed."""
    folder, backups = tmp_path / "folder", tmp_path / "backups"
    folder.mkdir()
    backups.mkdir()
    (folder / "old").write_bytes(b"old")

    def child() -> int:
        body(folder)
        return 0

    loss = PowerLoss(folder, backups)
    assert run(child, folder, before=loss.before).status == 0
    loss.strike()
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def test_each_operation_is_counted_and_the_process_dies_before_the_one_asked_for(
    tmp_path: Path,
) -> None:
    def child() -> int:
        write(tmp_path / "a", b"1", sync=True)
        (tmp_path / "a").rename(tmp_path / "b")
        (tmp_path / "c").mkdir()
        (tmp_path / "b").unlink()
        return 7

    whole = run(child, tmp_path)
    assert whole.status == 7
    assert [each.name for each in whole.operations] == [
        *("open", "write", "fsync", "rename", "mkdir", "unlink")
    ]
    assert whole.operations[3] == Operation("rename", str(tmp_path / "a"), str(tmp_path / "b"))
    (tmp_path / "c").rmdir()
    cut = run(child, tmp_path, die_at=3)
    assert cut.status is None
    assert cut.operations == whole.operations[:3]
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_data_that_was_not_synchronised_is_lost(tmp_path: Path) -> None:
    def body(folder: Path) -> None:
        write(folder / "new", b"data", sync=False)
        sync_folder(folder)

    assert after_power_cut(tmp_path, body) == {"old": b"old", "new": b""}


def test_a_name_that_was_not_synchronised_is_lost(tmp_path: Path) -> None:
    assert after_power_cut(tmp_path, lambda folder: write(folder / "new", b"data", sync=True)) == {
        "old": b"old"
    }


def test_a_rename_that_was_not_synchronised_is_undone(tmp_path: Path) -> None:
    def body(folder: Path) -> None:
        write(folder / "part", b"new", sync=True)
        sync_folder(folder)
        (folder / "part").replace(folder / "old")

    assert after_power_cut(tmp_path, body) == {"old": b"old", "part": b"new"}


def test_what_was_synchronised_stays(tmp_path: Path) -> None:
    def body(folder: Path) -> None:
        write(folder / "part", b"new", sync=True)
        (folder / "part").replace(folder / "old")
        sync_folder(folder)

    assert after_power_cut(tmp_path, body) == {"old": b"new"}


def test_a_removal_that_was_not_synchronised_is_undone(tmp_path: Path) -> None:
    assert after_power_cut(tmp_path, lambda folder: (folder / "old").unlink()) == {"old": b"old"}


def test_what_camctl_writes_outlives_a_power_cut(tmp_path: Path) -> None:
    def body(folder: Path) -> None:
        write_bytes(folder / "old", b"new")
        make_folder(folder / "a" / "b")
        write_array(folder / "a" / "b" / "c.npy", np.zeros(2, np.uint8))

    left = after_power_cut(tmp_path, body)
    assert left["old"] == b"new"
    assert np.array_equal(np.load(tmp_path / "folder" / "a" / "b" / "c.npy"), [0, 0])
