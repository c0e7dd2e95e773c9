"""Kill a small capture before each of its file operations, and check the files that remain.

    python crash_sweep.py FOLDER STEP

Prints one JSON object for each crash point: what is wrong with the folder, and with the capture
that `camctl.resume` completes in it.  A program of its own: it forks, which a process with threads
must not.
"""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tifffile
from crash_points import run

import camctl
from camctl.captures.frame_store import read_capture
from camctl.captures.picture_files import read_radiance

REQUEST = camctl.CaptureRequest(ratios=(1.0, 8.0), base_s=0.01)


def open_camera() -> camctl.Camera:
    return camctl.open_camera("sim", size="24x16")


def capture(folder: Path) -> int:
    with open_camera() as camera:
        camctl.capture(camera, REQUEST, folder)
    return 0


def damaged(folder: Path) -> list[str]:
    """Return the files that are neither hidden nor whole."""
    wrong = []
    readers: dict[str, Callable[[Path], object]] = {
        ".npy": np.load,
        ".tiff": tifffile.imread,
        ".exr": read_radiance,
    }
    for path in sorted(folder.rglob("*")):
        if path.is_dir() or path.name.startswith("."):
            continue
        try:
            if path.name == "report.json":
                read_capture(folder)
            elif path.suffix == ".png":
                assert cv2.imread(str(path)) is not None
            else:
                readers[path.suffix](path)
        except Exception as error:  # whatever the reader of a damaged file raises
            wrong.append(f"{path.relative_to(folder)}: {type(error).__name__}: {error}")
    return wrong


def resumed(folder: Path) -> str:
    """Complete the capture; return what is wrong with its sum, or ""."""
    with open_camera() as camera:
        report = camctl.resume(camera, folder)
    frames = [np.load(folder / str(frame.file)).astype(np.int64) for frame in report.frames]
    expected = np.sum([np.minimum(frame, report.white) for frame in frames], axis=0)
    same = np.array_equal(tifffile.imread(folder / "sum.tiff"), expected)
    return "" if same else "sum.tiff is not the sum of the frames"


def main(folder: Path, step: int) -> None:
    cv2.setNumThreads(1)
    whole = run(lambda: capture(folder), folder)
    assert whole.status == 0, whole
    for point in range(0, len(whole.operations), step):
        shutil.rmtree(folder)
        assert run(lambda: capture(folder), folder, die_at=point).status is None
        found: dict[str, Any] = {"point": point, "before": whole.operations[point].name}
        found["damaged"] = []
        if folder.exists():
            found["damaged"] = damaged(folder)
            if (folder / "report.json").exists():
                is_complete = isinstance(read_capture(folder), camctl.CaptureReport)
                found["resumed"] = "" if is_complete else resumed(folder)
                found["damaged"] += damaged(folder)
        else:
            folder.mkdir()
        print(json.dumps(found), flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
