"""What a capture's folder withstands: a second process, leftovers, and foreign files."""

from __future__ import annotations

import subprocess
import sys
import textwrap
from collections.abc import Generator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from small_cameras import WrappedCamera, small_camera, sum_of_frames
from small_captures import FIRST, LIGHT, REQUEST, complete, contents, one_of_two, shoot

import camctl
from camctl.captures.sequence import Progress
from camctl.captures.sequencer import capture
from camctl.errors import (
    CaptureError,
    DataError,
    InterruptedCaptureError,
    StorageError,
    UsageError,
)
from camctl.interface.camera import Frame, FrameStream, OriginalFile
from camctl.interface.controls import ExposureSetting
from camctl.records.folder_store import read_capture, read_report
from camctl.records.report_file import LOCK, clean_suffix
from camctl.sim.camera import SimulatedCamera
from camctl.system.files import file_lock

# One owner


@pytest.mark.parametrize("other", ["force", "resume", "anew"])
def test_folder_that_a_capture_is_writing_is_refused(tmp_path: Path, other: str) -> None:
    folder, refused = tmp_path / "out", []

    def interfere(progress: Progress) -> None:
        if progress.stage == "shooting" and progress.done == 1:
            with pytest.raises(StorageError) as failure:
                complete(folder) if other == "resume" else shoot(
                    folder, seed=5, overwrite=other == "force"
                )
            refused.append(str(failure.value))

    with small_camera(light=LIGHT) as camera:
        report = capture(camera, REQUEST, folder, progress=interfere)
    expected = (
        f"{folder} is not empty; choose another folder, or replace this capture"
        if other == "anew"
        else f"another process is writing {folder}; wait until it ends, or choose another folder"
    )
    assert set(refused) == {expected}
    assert np.array_equal(tifffile.imread(folder / "sum.tiff"), sum_of_frames(folder, report))


def test_lock_of_another_process_is_respected_and_ends_with_it(tmp_path: Path) -> None:
    folder = one_of_two(tmp_path / "out")
    script = f"""
        import camctl, sys
        from camctl.system.files import file_lock
        with file_lock({str(folder / ".camctl.lock")!r}):
            print("held", flush=True)
            sys.stdin.read()
    """
    with subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(script)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"held\n"
        with pytest.raises(StorageError, match="another process is writing"):
            complete(folder)
        holder.kill()
        holder.wait()
    complete(folder)


@pytest.mark.parametrize("is_complete", [False, True])
def test_a_merge_into_a_folder_in_use_ends_before_a_file_is_read(
    tmp_path: Path, *, is_complete: bool
) -> None:
    folder = tmp_path / "out"
    if is_complete:
        complete(one_of_two(folder))
    else:
        folder.mkdir()
    with (
        file_lock(folder / LOCK),
        pytest.raises(StorageError, match="another process is writing"),
    ):
        camctl.merge([tmp_path / "missing.jpg"], path=folder, overwrite=True)
    with pytest.raises(DataError, match=r"missing\.jpg"):
        camctl.merge([tmp_path / "missing.jpg"], path=folder, overwrite=True)


def test_refused_plan_leaves_no_folder(tmp_path: Path) -> None:
    folder = tmp_path / "a" / "b"
    with small_camera(light=LIGHT) as camera, pytest.raises(CaptureError, match="beyond"):
        capture(camera, replace(REQUEST, base_s=1e6), folder)
    assert list(tmp_path.iterdir()) == []
    with small_camera(light=LIGHT) as camera, pytest.raises(UsageError):
        capture(camera, replace(REQUEST, time_budget_s=1e-9, ratios=None), folder)
    assert list(tmp_path.iterdir()) == []


# What a kill leaves


@pytest.mark.parametrize(
    "made", [(), ("frames",), ("frames", ".camctl.lock", ".report.json.7.part")]
)
@pytest.mark.parametrize("overwrite", [False, True])
def test_folder_without_report_is_used_again(
    tmp_path: Path, made: tuple[str, ...], overwrite: bool
) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    for name in made:
        (folder / name).mkdir() if name == "frames" else (folder / name).touch()
    with pytest.raises(DataError) as failure:
        complete(folder)
    assert str(failure.value) == (f"nothing was shot into {folder}; start anew")
    shoot(folder, overwrite=overwrite)
    assert read_report(folder).status == "complete"
    assert not list(folder.glob("*.part"))


def test_resume_removes_what_a_killed_process_left(tmp_path: Path) -> None:
    folder = one_of_two(tmp_path / "out")
    for name in (".report.json.12.part", ".sum.tiff.12.part", "frames/.frame-02.npy.staged"):
        (folder / name).write_bytes(b"half")
    (folder / ".hidden").write_bytes(b"mine")
    complete(folder)
    hidden = {str(path.relative_to(folder)) for path in folder.rglob(".*")}
    assert hidden == {".camctl.lock", ".hidden"}


def test_resume_finishes_the_rename_of_a_saved_frame(tmp_path: Path) -> None:
    folder = one_of_two(tmp_path / "out")
    before = (folder / FIRST).read_bytes()
    (folder / FIRST).rename(folder / "frames" / ".frame-01.npy.staged")
    complete(folder)
    assert (folder / FIRST).read_bytes() == before


def test_staged_frame_with_another_checksum_is_shot_again(tmp_path: Path) -> None:
    folder = one_of_two(tmp_path / "out")
    (folder / FIRST).unlink()
    (folder / "frames" / ".frame-01.npy.staged").write_bytes(b"half")
    complete(folder)
    assert np.load(folder / FIRST).shape == (12, 16)


def test_force_never_follows_a_link(tmp_path: Path) -> None:
    folder, elsewhere = tmp_path / "out", tmp_path / "photos"
    shoot(folder)
    (folder / "frames").rename(elsewhere)
    (folder / "frames").symlink_to(elsewhere)
    before = contents(elsewhere)
    with pytest.raises(StorageError, match="frames is a link or a file, not a folder"):
        shoot(folder, overwrite=True)
    assert contents(elsewhere) == before


@pytest.mark.parametrize("report", ['{"tests": 12}', "[]", "", '{"status": "complete"}'])
def test_foreign_report_is_no_proof_of_a_capture(tmp_path: Path, report: str) -> None:
    folder = tmp_path / "out"
    (folder / "frames").mkdir(parents=True)
    (folder / "report.json").write_text(report)
    (folder / FIRST).write_bytes(b"film")
    before = contents(folder)
    with pytest.raises(StorageError, match=r"is not empty, and not replaced: .*report\.json is"):
        shoot(folder, overwrite=True)
    assert contents(folder) == before


def test_force_leaves_other_files_alone(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    shoot(folder)
    for name in ("notes.txt", "frames/notes.txt", "frames/frame-01.xmp.txt"):
        (folder / name).write_text("mine")
    shoot(folder, seed=1, overwrite=True)
    for name in ("notes.txt", "frames/notes.txt", "frames/frame-01.xmp.txt"):
        assert (folder / name).read_text() == "mine"


@pytest.mark.parametrize("name", ["sum.tiff", "frames/frame-02.npy", "frames/frame-03.jpg"])
@pytest.mark.parametrize("act", ["force", "resume"])
def test_file_that_the_report_does_not_name_is_neither_removed_nor_replaced(
    tmp_path: Path, name: str, act: str
) -> None:
    folder = one_of_two(tmp_path / "out")
    (folder / name).write_bytes(b"mine")
    with pytest.raises(StorageError, match=rf"{name} is not named in report.json; move it away"):
        complete(folder) if act == "resume" else shoot(folder, overwrite=True)
    assert (folder / name).read_bytes() == b"mine"
    (folder / name).unlink()
    complete(folder)


# What a camera supplies


class WithFiles(WrappedCamera):
    """A camera with files of its own, whose frame `wrong` has half of its light the first time."""

    def __init__(self, camera: SimulatedCamera, suffix: str, wrong: int | None = None) -> None:
        super().__init__(camera)
        self.suffix, self.wrong = suffix, wrong

    def shoot(self, settings: Sequence[ExposureSetting]) -> FrameStream:
        return self._frames(super().shoot(settings))

    def _frames(self, frames: FrameStream) -> Generator[Frame, None, None]:
        for frame in frames:
            pixels: NDArray[Any] = frame.pixels
            if frame.index == self.wrong:
                self.wrong, pixels = None, frame.pixels // 2
            yield replace(
                frame, pixels=pixels, original=OriginalFile(self.suffix, pixels.tobytes())
            )


@pytest.mark.parametrize(
    ("suffix", "expected"),
    [
        (".NEF", ".nef"),
        (".npy", ".bin"),
        (".NPY", ".bin"),
        ("", ".bin"),
        (".", ".bin"),
        ("/../../../evil", ".evil"),
        ("/", ".bin"),
        (".jpg\0.npy", ".jpgnpy"),
        (".x\x1b[31m", ".x31m"),
        ("." + "long" * 100, ".longlong"),
        (".été", ".t"),
        ("\ud800", ".bin"),
    ],
)
def test_suffix_of_a_camera_is_data(suffix: str, expected: str) -> None:
    assert clean_suffix(suffix) == expected


def test_suffix_of_a_camera_names_no_other_folder(tmp_path: Path) -> None:
    folder, suffix, expected = tmp_path / "a" / "out", "/../../../evil", ".evil"
    with small_camera(light=LIGHT) as simulated:
        report = capture(WithFiles(simulated, suffix), REQUEST, folder)
    names = {path.name for path in (folder / "frames").iterdir()}
    stems = ("frame-01", "frame-02")
    assert names == {f"{stem}{end}" for stem in stems for end in (".npy", expected)}
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
    assert report.frames[0].original == f"frames/frame-01{expected}"
    assert (folder / f"frames/frame-01{expected}").read_bytes() == report.frame(0).tobytes()
    assert read_report(folder).frames == report.frames


@pytest.mark.parametrize(
    ("details", "kept"),
    [
        ({"lens": "50 mm \ud800"}, {"lens": "50 mm ?"}),
        ({"shift": float("nan"), "far": float("inf")}, {"shift": None, "far": None}),
        ({"card": {1, 2}}, {"card": "{1, 2}"}),
        ({("a", "b"): 1}, {"omitted": "no JSON object of up to 65536 bytes"}),
        ({"long": "x" * 100_000}, {"omitted": "no JSON object of up to 65536 bytes"}),
    ],
)
def test_details_of_a_camera_are_data(
    tmp_path: Path, details: dict[str, Any], kept: dict[str, Any]
) -> None:
    folder = tmp_path / "out"

    class Talkative(WithFiles):
        def _frames(self, frames: FrameStream) -> Generator[Frame, None, None]:
            for frame in super()._frames(frames):
                yield replace(frame, details=details, timestamp_s=float("nan"))

    with small_camera(light=LIGHT) as simulated:
        capture(Talkative(simulated, ".raw"), REQUEST, folder)
    frame = read_report(folder).frames[0]
    assert (frame.details, frame.timestamp_s) == (kept, 0.0)


def test_own_file_of_a_rejected_frame_is_kept(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    with small_camera(
        light=LIGHT * np.float32(0.5)
    ) as simulated:  # halved samples are unsaturated ones
        report = capture(WithFiles(simulated, ".raw", wrong=1), REQUEST, folder)
    # Of two frames that disagree, both are shot again.
    stems = [f"frame-0{number}{aside}" for number in (1, 2) for aside in ("", "-rejected-1")]
    names = {f"{stem}{suffix}" for stem in stems for suffix in (".npy", ".raw")}
    assert {path.name for path in (folder / "frames").iterdir()} == names
    for stem in stems:
        samples = np.load(folder / "frames" / f"{stem}.npy")
        assert (folder / "frames" / f"{stem}.raw").read_bytes() == samples.tobytes()
    assert set(report.rejected) == {f"frames/{name}" for name in names if "rejected" in name}
    assert np.array_equal(tifffile.imread(folder / "sum.tiff"), sum_of_frames(folder, report))


def test_own_file_of_a_frame_whose_samples_are_missing_is_set_aside(tmp_path: Path) -> None:
    folder, request, done = tmp_path / "out", replace(REQUEST, ratios=(1.0, 4.0, 16.0)), [0]
    with small_camera(light=LIGHT) as simulated, pytest.raises(InterruptedCaptureError):
        capture(
            WithFiles(simulated, ".raw"),
            request,
            folder,
            progress=lambda each: done.append(each.done),
            cancelled=lambda: done[-1] > 0,
        )
    own = (folder / "frames" / "frame-01.raw").read_bytes()
    (folder / FIRST).unlink()
    complete(folder)
    assert (folder / "frames" / "frame-01-rejected-1.raw").read_bytes() == own
    assert "frames/frame-01-rejected-1.raw" in read_capture(folder).rejected
