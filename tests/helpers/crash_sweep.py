"""Kill a small capture before each of its file operations, and check what can be made of the rest.

    python crash_sweep.py FOLDER SCENARIO STEP

SCENARIO is "resume" (of a capture with one frame of two), "force" (over an older capture), or
"retry" (into a new folder; one frame has a wrong exposure and is shot again, and the camera makes
files of its own).  Each crash point is checked twice: as a kill leaves the folder, and as a
power failure at the same moment leaves it.  Then the capture is resumed, or what the folder advises
is done.  Prints one JSON object for each check.

A program of its own: it forks, which a process with threads must not.
"""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable, Generator, Sequence
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import cv2
import filelock  # noqa: F401  imported before the fork, once for all crash points
import numpy as np
import tifffile
from crash_points import PowerLoss, run
from numpy.typing import NDArray
from small_cameras import WrappedCamera

import camctl
from camctl.interface.camera import Frame, FrameStream, OriginalFile
from camctl.interface.controls import ExposureSetting
from camctl.pictures.files import read_radiance
from camctl.records.folder_store import read_capture
from camctl.records.report_file import named_files
from sim.camera import SimulatedCamera
from sim.scenes.scene import load_scene
from sim.sensors.sensor import load_sensor

REQUEST = camctl.CaptureRequest(ratios=(1.0, 8.0), base_s=0.01)
NAME = "out"


def open_camera(seed: int = 0) -> SimulatedCamera:
    return SimulatedCamera(load_scene("uniform", (16, 24)), load_sensor("standard"), seed=seed)


class LyingCamera(WrappedCamera):
    """Its second frame is as bright as half of its exposure; it makes files of its own."""

    def __init__(self, camera: SimulatedCamera, lies: int = 1) -> None:
        super().__init__(camera)
        self._lies = lies

    def shoot(self, settings: Sequence[ExposureSetting]) -> FrameStream:
        return self._frames(super().shoot(settings), len(settings))

    def _frames(self, frames: FrameStream, count: int) -> Generator[Frame, None, None]:
        for frame in frames:
            pixels = frame.pixels
            if self._lies and frame.index == count - 1:
                self._lies -= 1
                pixels = pixels // 2
            original = OriginalFile(".RAW", bytes(pixels))
            yield replace(frame, pixels=pixels, original=original)


def capture(folder: Path, *, overwrite: bool = False, seed: int = 0) -> int:
    with open_camera(seed) as camera:
        camctl.capture(camera, REQUEST, folder, overwrite=overwrite)
    return 0


def capture_with_retry(folder: Path) -> int:
    with LyingCamera(open_camera().open()) as camera:
        camctl.capture(camera, REQUEST, folder)
    return 0


def resume(folder: Path) -> int:
    with open_camera() as camera:
        camctl.resume(camera, folder)
    return 0


def interrupted(folder: Path) -> None:
    """Leave a capture with one frame of two."""
    calls = iter((False, True))
    with open_camera() as camera:
        try:
            camctl.capture(camera, REQUEST, folder, cancelled=lambda: next(calls, True))
        except camctl.InterruptedCaptureError:
            frames = folder / "frames"
            (frames / "frame-02.npy").unlink()
            report = json.loads((folder / "report.json").read_text())
            report["frames"][1] = None
            (folder / "report.json").write_text(json.dumps(report))


SCENARIOS: dict[str, tuple[Callable[[Path], object], Callable[[Path], int]]] = {
    "resume": (interrupted, resume),
    "force": (lambda f: capture(f, seed=1), lambda f: capture(f, overwrite=True)),
    "retry": (lambda _: None, capture_with_retry),
}
"""What is in the folder before, and what is killed."""


def damaged(folder: Path) -> list[str]:
    """Return the files that are neither hidden nor whole."""
    wrong = []
    readers: dict[str, Callable[[Path], object]] = {
        ".npy": np.load,
        ".tiff": tifffile.imread,
        ".exr": read_radiance,
        ".raw": lambda path: np.frombuffer(path.read_bytes(), np.uint8).reshape(16, 24),
    }
    for path in sorted(folder.rglob("*")):
        if path.is_dir() or path.name.startswith("."):
            continue
        try:
            if path.name == "report.json":
                read_capture(folder)
            elif path.suffix == ".png":
                assert cv2.imdecode(np.fromfile(path, np.uint8), -1) is not None
            else:
                readers[path.suffix](path)
        except Exception as error:  # whatever the reader of a damaged file raises
            wrong.append(f"{path.relative_to(folder)}: {type(error).__name__}: {error}")
    return wrong


def saved_frames(folder: Path) -> set[str]:
    """Return the checksums of the frames that the report names, and of their original files."""
    if not (folder / "report.json").exists():
        return set()
    frames = [frame for frame in read_capture(folder).frames if frame is not None]
    return {str(frame.sha256) for frame in frames} | {
        frame.original_sha256 for frame in frames if frame.original_sha256 is not None
    }


def unnamed_frames(folder: Path) -> set[str]:
    """Return the frames that have their name, and that the report does not name."""
    if not (folder / "report.json").exists():
        return {path.name for path in folder.glob("frames/*") if not path.name.startswith(".")}
    report = read_capture(folder)
    named = {Path(name).name for name in named_files(report)}
    named |= {name.replace("-rejected-1", "") for name in named}  # not renamed yet
    present = {path.name for path in (folder / "frames").iterdir()}
    return {name for name in present - named if not name.startswith(".")}


def followed(folder: Path) -> tuple[str, camctl.CaptureReport]:
    """Complete the capture in the way the folder's state or its error advises."""
    with open_camera(seed=7) as camera:  # a frame that is shot again differs from the lost one
        try:
            return "resumed", camctl.resume(camera, folder)
        except camctl.DataError as error:
            if "is complete" in error.what:
                return "complete", camctl.read_report(folder)
            advised = "nothing was shot" in error.what or "holds no capture" in error.what
            if saved_frames(folder) or not advised:
                raise
            return "shot anew", camctl.capture(camera, REQUEST, folder)


def checked(folder: Path) -> dict[str, Any]:
    """Return what is wrong with a folder after a crash; `done` is how it was completed."""
    wrong, saved = damaged(folder), saved_frames(folder)
    wrong += [f"the report is behind {name}" for name in unnamed_frames(folder)]
    done, report = followed(folder)
    wrong += damaged(folder)
    if not np.array_equal(tifffile.imread(folder / "sum.tiff"), sum_of_frames(folder, report)):
        wrong.append("sum.tiff is not the sum of the frames")
    wrong += [f"{name} is missing" for name in named_files(report) if not (folder / name).exists()]
    kept = {sha256(path.read_bytes()).hexdigest() for path in (folder / "frames").iterdir()}
    if saved - kept:
        wrong.append("a frame that was reported as saved is lost")
    hidden = [path.name for path in folder.rglob(".*") if path.name != ".camctl.lock"]
    if hidden and done != "complete":  # nobody writes a complete capture
        wrong.append(f"left over: {hidden}")
    return {"wrong": wrong, "done": done, "saved": len(saved)}


def sum_of_frames(folder: Path, report: camctl.CaptureReport) -> NDArray[np.int64]:
    frames = [np.load(folder / str(frame.file)).astype(np.int64) for frame in report.frames]
    return np.asarray(np.sum([np.minimum(frame, report.white) for frame in frames], axis=0))


def main(base: Path, scenario: str, step: int) -> None:
    cv2.setNumThreads(1)
    prepare, body = SCENARIOS[scenario]
    template, work, other, backups = (base / name for name in ("template", "work", "other", "kept"))
    template.mkdir(parents=True)
    prepare(template / NAME)
    shutil.copytree(template, work)
    operations = run(lambda: body(work / NAME), work).operations
    points = [*range(0, len(operations), step), len(operations)]
    for point in points:
        for folder in (work, other, backups):
            shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(template, work)
        backups.mkdir()
        loss = PowerLoss(work, backups)
        outcome = run(lambda: body(work / NAME), work, die_at=point, before=loss.before)
        assert outcome.status == (0 if point == len(operations) else None), outcome
        shutil.copytree(work, other)
        loss.strike()
        before = operations[point].name if point < len(operations) else "end"
        for cause, folder in (("kill", other / NAME), ("power", work / NAME)):
            found = checked(folder)
            print(json.dumps({"point": point, "before": before, "cause": cause, **found}))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]))
