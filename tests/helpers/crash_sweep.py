"""What is wrong with the folder of a capture after a crash, and captures to be killed.

`crash_witness` kills them; tests of signals and limits check their folders, too.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import cv2
import imagecodecs
import numpy as np
import tifffile
from numpy.typing import NDArray
from small_cameras import WrappedCamera

import camctl
from camctl.interface.camera import Frame, FrameStream, OriginalFile
from camctl.interface.controls import ExposureSetting
from camctl.pictures.files import read_radiance
from camctl.records.folder_store import read_capture
from camctl.records.report_file import named_files
from camctl.sim.camera import SimulatedCamera
from camctl.sim.scenes.scene import load_scene
from camctl.sim.sensors.sensor import load_sensor

REQUEST = camctl.CaptureRequest(ratios=(1.0, 8.0), base_s=0.01)


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


def damaged(folder: Path) -> list[str]:
    """Return the files that are neither hidden nor whole."""
    wrong = []
    readers: dict[str, Callable[[Path], object]] = {
        ".npy": np.load,
        ".tiff": tifffile.imread,
        ".exr": read_radiance,
        ".avif": imagecodecs.imread,
        ".raw": lambda path: np.frombuffer(path.read_bytes(), np.uint8).reshape(16, 24),
    }
    for path in sorted(folder.rglob("*")):
        if path.is_dir() or path.name.startswith(".") or path.name in ("series.json", "index.html"):
            continue
        try:
            if path.name == "report.json":
                read_capture(folder)
            elif path.suffix in (".png", ".jpg"):
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
