"""Reports and frames that anybody may have written or changed."""

from __future__ import annotations

import errno
import os
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_captures import FIRST, complete, contents, edit, one_of_two, shoot

from camctl.errors import (
    DataError,
    StorageError,
)
from camctl.records.folder_store import read_report

LIGHT = {"span": 2.0, "is_open": False, "clips": 0.5, "dark": 0.1, "needed": 1.0}

# Format version


def test_report_of_another_version_is_refused_by_name_and_its_frames_stay_readable(
    tmp_path: Path,
) -> None:
    folder = tmp_path / "out"
    shoot(folder)
    edit(folder, lambda report: report.update(format_version=4))
    before = contents(folder)
    for act in (lambda: read_report(folder), lambda: complete(folder)):
        with pytest.raises(DataError) as failure:
            act()
        assert "has format version 4" in str(failure.value)
        assert "frames/*.npy can be read with numpy.load" in failure.value.hint
    with pytest.raises(StorageError, match="format version"):
        shoot(folder, overwrite=True)
    assert contents(folder) == before
    assert np.load(folder / FIRST).shape == (12, 16)


# --force trusts nothing


# A report is hostile input


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("file", "../../secret.npy"),
        ("file", "/etc/passwd"),
        ("file", "frames/frame-02.npy"),
        ("file", "frames/frame-01.npy\n"),
        ("file", None),
        ("original", "frames/../../secret.npy"),
        ("original", "frames/frame-01.npy"),
        ("original", "frames/.frame-01.raw"),
        ("sha256", "0" * 63),
        ("sha256", None),
        ("white", 1000),
        ("black", 5),
        ("applied", {"time_s": 0.0}),
        ("applied", {"time_s": 1e-300}),
        ("applied", {"time_s": 1e400}),
        ("applied", {"time_s": 0.1, "f_number": 0.0}),
        ("timestamp_s", 1e999),
    ],
)
def test_frame_of_a_report_must_be_possible(tmp_path: Path, field: str, value: object) -> None:
    folder = one_of_two(tmp_path / "out")
    (tmp_path / "secret.npy").write_bytes(b"mine")
    edit(folder, lambda report: report["frames"][0].update({field: value}))
    with pytest.raises(DataError, match=r"report\.json is damaged: frames|exposure") as failure:
        complete(folder)
    assert "\n" not in str(failure.value)
    assert (tmp_path / "secret.npy").read_bytes() == b"mine"


@pytest.mark.parametrize(
    ("field", "value", "problem"),
    [
        ("frames", [], "frames: 0 instead of 2"),
        ("frames", [None] * 3, "frames: 3 instead of 2"),
        ("rejected", ["../secret.npy"], "rejected"),
        ("rejected", ["frames/frame-01.npy"], "rejected"),
        ("discarded", ["../secret.npy"], "discarded"),
        ("discarded", ["frames/frame-01.npy"], "discarded"),
        ("discarded", ["report.json"], "discarded"),
        ("files", {"sum": "../secret.npy"}, "files"),
        ("white", 70_000, "white"),
        ("black_total", -1, "white and black_total"),
        ("timing", {"planning_s": 1e999}, "timing.planning_s: inf"),
    ],
)
def test_report_must_be_possible(tmp_path: Path, field: str, value: object, problem: str) -> None:
    folder = one_of_two(tmp_path / "out")
    (tmp_path / "secret.npy").write_bytes(b"mine")
    edit(folder, lambda report: report.update({field: value}))
    before = contents(tmp_path)
    for act in (partial(complete, folder), partial(shoot, folder, overwrite=True)):
        with pytest.raises((DataError, StorageError), match=problem) as failure:
            act()
        assert "\n" not in str(failure.value)
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    "change",
    [
        *({"response": "x"}, {"levels_wanted": -1.0}, {"levels_wanted": 1e308}, {"settings": []}),
        *({"light": {**LIGHT, "clips_stops": stops}} for stops in (-1, 9e99)),
    ],
)
def test_plan_of_a_report_must_be_possible(tmp_path: Path, change: dict[str, Any]) -> None:
    folder = one_of_two(tmp_path / "out")
    edit(folder, lambda report: report["plan"].update(change))
    with pytest.raises(DataError, match=r"report\.json is damaged"):
        complete(folder)


def test_huge_report_is_not_read(tmp_path: Path) -> None:
    folder = one_of_two(tmp_path / "out")
    os.truncate(folder / "report.json", 1 << 30)
    with pytest.raises(DataError, match=r"report\.json: it is larger than 8 MiB"):
        complete(folder)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="named pipes need a POSIX system")
def test_report_that_is_a_pipe_or_a_link_is_refused_at_once(tmp_path: Path) -> None:
    folder = one_of_two(tmp_path / "out")
    (folder / "report.json").rename(tmp_path / "elsewhere.json")
    os.mkfifo(folder / "report.json")
    with pytest.raises(DataError, match=r"report\.json: it is a named pipe"):
        complete(folder)
    (folder / "report.json").unlink()
    (folder / "report.json").symlink_to(tmp_path / "elsewhere.json")
    with pytest.raises(DataError, match=r"report\.json: it is a symbolic link"):
        complete(folder)


def npy(shape: tuple[int, ...], kind: str, data: bytes = b"") -> bytes:
    """Return a .npy file with this header and these data."""
    header = f"{{'descr': {kind!r}, 'fortran_order': False, 'shape': {shape!r}, }}"
    text = header.ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode() + data


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (npy((1_000_000, 1_000_000), "|u1"), "has not the size of uint8"),
        (npy((12, 16), "<f8", bytes(12 * 16 * 8)), "holds float64"),
        (npy((12, 16), "|O", bytes(12 * 16 * 8)), "holds object"),
        (npy((192,), "|u1", bytes(192)), r"holds uint8 \(192,\)"),
        (npy((-12, -16), "|u1", bytes(192)), "has not the size|invalid"),
        (npy((0, 16), "|u1"), "has not the size of uint8"),
        (npy((24, 8), "|u1", bytes(192)), r"frame 1 holds \(24, 8\) uint8, and the camera makes"),
        (npy((12, 16), "<u2", bytes(384)), r"frame 1 holds \(12, 16\) uint16"),
        (b"", "magic|checksum"),
    ],
)
def test_frame_of_another_size_or_type_is_refused(
    tmp_path: Path, content: bytes, problem: str
) -> None:
    from hashlib import sha256

    folder = one_of_two(tmp_path / "out")
    (folder / FIRST).write_bytes(content)
    checksum = sha256(content).hexdigest()
    edit(folder, lambda report: report["frames"][0].update(sha256=checksum))
    with pytest.raises(DataError, match=problem) as failure:
        complete(folder)
    assert "frame-01.npy" in str(failure.value) or "frame 1" in str(failure.value)
    assert "\n" not in str(failure.value)


@pytest.mark.parametrize(
    ("number", "remedy"),
    [(errno.EACCES, "check its permissions"), (errno.EIO, "check the disk or the device")],
)
def test_frame_that_the_system_does_not_read_is_not_called_damaged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, remedy: str
) -> None:
    folder = one_of_two(tmp_path / "out")
    opened = os.open

    def refuse(path: str | Path, *rest: Any, **options: Any) -> int:
        if str(path).endswith("frame-01.npy"):
            raise OSError(number, os.strerror(number), str(path))
        return opened(path, *rest, **options)

    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(DataError) as failure:
        complete(folder)
    assert f"{os.strerror(number)}; {remedy}; 1 of 2 frames are kept" in str(failure.value)


@pytest.mark.parametrize("position", [0, 100, 200])
def test_changed_frame_is_named_and_shot_again_once_it_is_moved_away(
    tmp_path: Path, position: int
) -> None:
    folder = one_of_two(tmp_path / "out")
    data = bytearray((folder / FIRST).read_bytes())
    data[position] ^= 1
    (folder / FIRST).write_bytes(data)
    with pytest.raises(DataError) as failure:
        complete(folder)
    assert str(failure.value).startswith(
        f"{folder / FIRST} cannot be read: its content has changed"
    )
    assert "move it away, and resume: it is shot again" in str(failure.value)
    (folder / FIRST).rename(tmp_path / "damaged.npy")
    complete(folder)


def test_changed_frame_of_a_complete_capture_is_named(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    shoot(folder)
    data = bytearray((folder / FIRST).read_bytes())
    data[-1] ^= 1
    (folder / FIRST).write_bytes(data)
    report = read_report(folder)
    assert report.frame(1).shape == (12, 16)
    with pytest.raises(DataError, match=r"frame-01.npy cannot be read.*; shoot the capture again"):
        report.frame(0)


def test_frame_that_is_a_link_is_refused(tmp_path: Path) -> None:
    folder = one_of_two(tmp_path / "out")
    (folder / FIRST).rename(tmp_path / "elsewhere.npy")
    (folder / FIRST).symlink_to(tmp_path / "elsewhere.npy")
    for act in (partial(complete, folder), partial(shoot, folder, overwrite=True)):
        with pytest.raises(StorageError, match=r"frame-01.npy is not a plain file; move it away"):
            act()
    assert np.load(tmp_path / "elsewhere.npy").shape == (12, 16)
