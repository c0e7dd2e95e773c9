"""A capture's folder through shots, kills, resumes, replacements and tampering in any order."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from copy import deepcopy
from dataclasses import replace
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule
from small_cameras import gradient, small_camera, sum_of_frames

from camctl.captures.sequencer import capture, resume
from camctl.errors import CamctlError, DataError, StorageError
from camctl.exposure.goal import CaptureRequest
from camctl.records.folder_store import read_capture
from camctl.records.report import UnfinishedCapture
from camctl.system.files import file_lock

REQUEST = CaptureRequest(ratios=(1.0, 4.0), base_s=0.01)
LIGHT = gradient(12, 16)
FILE_OPERATIONS = ("fsync", "rename", "replace", "unlink", "mkdir", "rmdir")

#: Values that an edited report may hold anywhere.
VALUES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-2, 3) | st.sampled_from([10**9, 10**30, 2**64]),
    st.sampled_from([0.0, -1.0, 0.5, 1e-320, 1e-9, 1e9, 1e308, 1e999, float("nan")]),
    st.sampled_from(["", "x", "../../photos/mine.npy", "frames/frame-01.npy", "sum.tiff", "\x00"]),
    st.sampled_from([[], {}, [[]], ["frames/frame-02.npy"], ["../photos/mine.npy"]]),
)


class Killed(BaseException):
    """The process was killed: nothing that it would do to files happens any more."""


@contextmanager
def killed_at(operation: int) -> Iterator[None]:
    """Let the file operation of this number, and all after it, fail in the block."""
    count = 0

    def counted(function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            nonlocal count
            count += 1
            if count > operation:
                raise Killed
            return function(*arguments, **options)

        return call

    with pytest.MonkeyPatch.context() as patch:
        for name in FILE_OPERATIONS:
            patch.setattr(os, name, counted(getattr(os, name)))
        yield


def contents(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not path.is_symlink() and path.name != ".camctl.lock"
    }


def edit(report: Any, data: st.DataObject) -> None:
    """Put any value into any place of a report."""
    place = report
    while True:
        keys = list(place) if isinstance(place, dict) else list(range(len(place)))
        key = data.draw(st.sampled_from(keys))
        deeper = isinstance(place[key], dict | list) and place[key]
        if not deeper or data.draw(st.integers(0, 3)) == 0:
            break
        place = place[key]
    place[key] = deepcopy(data.draw(VALUES))


class FolderStates(RuleBasedStateMachine):
    """The rules are what people, programs and failures do to a folder."""

    def __init__(self) -> None:
        super().__init__()
        memory = Path("/dev/shm")
        self.base = Path(tempfile.mkdtemp(dir=memory if memory.is_dir() else None))
        self.folder, self.photos = self.base / "out", self.base / "photos"
        self.photos.mkdir()
        (self.photos / "mine.npy").write_bytes(b"mine")
        (self.photos / "frame-01.npy").write_bytes(b"mine, too")
        self.outside = contents(self.photos)
        self.tampered = False
        self.seed = 0

    def teardown(self) -> None:
        shutil.rmtree(self.base)

    def saved(self) -> set[str]:
        """Return the checksums of the frames that a report written by camctl names."""
        if self.tampered or not (self.folder / "report.json").exists():
            return set()
        frames = read_capture(self.folder).frames
        return {str(frame.sha256) for frame in frames if frame is not None}

    def act(self, *, again: bool, overwrite: bool = False, frames: int | None = None) -> None:
        """Capture or resume (`again`), cancelled after some frames; only `CamctlError` passes."""
        self.seed += 1
        saved = set() if overwrite else self.saved()
        calls = iter(range(1, 100))

        def cancelled() -> bool:
            return frames is not None and next(calls) >= frames

        failure: CamctlError | None = None
        try:
            with small_camera(light=LIGHT, seed=self.seed) as camera:
                if again:
                    report = resume(camera, self.folder, cancelled=cancelled)
                else:
                    report = capture(
                        camera, REQUEST, self.folder, overwrite=overwrite, cancelled=cancelled
                    )
            total = tifffile.imread(self.folder / "sum.tiff")
            assert np.array_equal(total, sum_of_frames(self.folder, report))
            self.tampered = False
        except CamctlError as error:
            failure = error
        except Killed:
            pass
        if failure is not None:
            assert "\n" not in str(failure)
            assert self.tampered or frames is not None or self.refusal_is_due(failure, again)
        present = {sha256(data).hexdigest() for data in contents(self.folder).values()}
        assert saved <= present, "a frame that was reported as saved is lost"

    def refusal_is_due(self, error: CamctlError, again: bool) -> bool:
        """Return whether an untouched folder is a reason for this error."""
        if again:
            advised = "is complete", "holds no capture", "nothing was shot"
            return isinstance(error, DataError) and any(text in error.what for text in advised)
        return isinstance(error, StorageError) and "is not empty" in error.what

    @rule(overwrite=st.booleans())
    def shoot(self, overwrite: bool) -> None:
        self.act(again=False, overwrite=overwrite)

    @rule()
    def resume(self) -> None:
        self.act(again=True)

    @rule(again=st.booleans(), overwrite=st.booleans(), frames=st.integers(1, 2))
    def cancel(self, again: bool, overwrite: bool, frames: int) -> None:
        self.act(again=again, overwrite=overwrite, frames=frames)

    @rule(again=st.booleans(), overwrite=st.booleans(), operation=st.integers(0, 45))
    def kill(self, again: bool, overwrite: bool, operation: int) -> None:
        with killed_at(operation):
            self.act(again=again, overwrite=overwrite)

    @precondition(lambda self: self.folder.exists() and not self.tampered)
    @rule(again=st.booleans(), overwrite=st.booleans())
    def act_while_another_process_writes(self, again: bool, overwrite: bool) -> None:
        before = contents(self.folder)
        with file_lock(self.folder / ".camctl.lock"), small_camera(light=LIGHT) as camera:
            act = partial(capture, camera, REQUEST, self.folder, overwrite=overwrite)
            with pytest.raises(CamctlError) as failure:
                resume(camera, self.folder) if again else act()
        is_locked = "another process is writing" in failure.value.what
        assert is_locked or self.refusal_is_due(failure.value, again)
        assert contents(self.folder) == before

    def frame_file(self, number: int) -> Path:
        return self.folder / "frames" / f"frame-{number:02d}.npy"

    def has_frame(self, number: int) -> bool:
        """Return whether there is a file of that frame that a test may change."""
        path = self.frame_file(number)
        return path.is_file() and not path.is_symlink() and not path.parent.is_symlink()

    @precondition(lambda self: self.has_frame(1))
    @rule(place=st.floats(0, 1, exclude_max=True))
    def flip_a_bit_of_a_frame(self, place: float) -> None:
        path = self.frame_file(1)
        data = bytearray(path.read_bytes())
        if not data:  # it was cut off before
            return
        data[int(place * len(data))] ^= 1
        path.unlink()
        path.write_bytes(data)
        self.tampered = True

    @precondition(lambda self: self.has_frame(1))
    @rule(length=st.integers(0, 200))
    def truncate_a_frame(self, length: int) -> None:
        os.truncate(self.frame_file(1), length)
        self.tampered = True

    @precondition(lambda self: self.has_frame(1))
    @rule()
    def remove_a_frame(self) -> None:
        self.frame_file(1).unlink()
        self.tampered = True

    @precondition(lambda self: self.has_frame(1))
    @rule(number=st.integers(1, 2))
    def put_a_link_in_place_of_a_frame(self, number: int) -> None:
        self.frame_file(number).unlink(missing_ok=True)
        self.frame_file(number).symlink_to(self.photos / "mine.npy")
        self.tampered = True

    @precondition(lambda self: self.folder.exists())
    @rule()
    def put_a_link_in_place_of_the_frames(self) -> None:
        frames = self.folder / "frames"
        if frames.is_dir() and not frames.is_symlink():
            shutil.rmtree(frames)
        if not frames.is_symlink():
            frames.symlink_to(self.photos)
        self.tampered = True

    @precondition(lambda self: self.folder.exists())
    @rule(name=st.sampled_from(["sum.tiff", "report.json", ".camctl.lock", "frames"]))
    def put_something_else_there(self, name: str) -> None:
        if not os.path.lexists(self.folder / name):
            (self.folder / name).write_bytes(b"foreign")
            self.tampered = True

    @precondition(lambda self: (self.folder / "report.json").exists())
    @rule(data=st.data())
    def edit_the_report(self, data: st.DataObject) -> None:
        try:
            report = json.loads((self.folder / "report.json").read_text())
        except ValueError:
            return
        edit(report, data)
        (self.folder / "report.json").write_text(json.dumps(report))
        self.tampered = True

    @rule()
    def start_anew(self) -> None:
        shutil.rmtree(self.folder, ignore_errors=True)
        self.tampered = False

    @invariant()
    def nothing_outside_has_changed(self) -> None:
        assert contents(self.photos) == self.outside

    @invariant()
    def a_complete_capture_is_the_sum_of_its_frames(self) -> None:
        try:
            report = read_capture(self.folder)
            if isinstance(report, UnfinishedCapture):
                return
            frames = [report.frame(position) for position in range(len(report.frames))]
            total = report.sum()
        except DataError:
            if self.tampered or not (self.folder / "report.json").exists():
                return
            raise
        clipped = [np.minimum(frame, report.white).astype(np.int64) for frame in frames]
        assert self.tampered or np.array_equal(total, np.sum(clipped, axis=0))


FolderStates.TestCase.settings = settings(
    stateful_step_count=15, max_examples=settings().max_examples * 2 // 5
)
TestFolderStates = pytest.mark.slow(FolderStates.TestCase)


@pytest.fixture(scope="module")
def begun(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one frame of two."""
    folder = tmp_path_factory.mktemp("begun") / "out"
    with small_camera(light=LIGHT) as camera, pytest.raises(CamctlError, match="cancelled"):
        capture(camera, replace(REQUEST, ratios=(1.0, 4.0, 16.0)), folder, cancelled=lambda: True)
    return folder


@given(st.data())
def test_edited_report_causes_no_other_error_than_camctls(begun: Path, data: st.DataObject) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "out"
        shutil.copytree(begun, folder)
        report = json.loads((folder / "report.json").read_text())
        for _ in range(data.draw(st.integers(1, 3))):
            edit(report, data)
        (folder / "report.json").write_text(json.dumps(report))
        with suppress(CamctlError), small_camera(light=LIGHT) as camera:
            completed = resume(camera, folder)
            total = tifffile.imread(folder / "sum.tiff")
            assert np.array_equal(total, sum_of_frames(folder, completed))
        assert [path.name for path in Path(name).iterdir()] == ["out"]
