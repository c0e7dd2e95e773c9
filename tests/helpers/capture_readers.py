"""Readers of a capture's folder: the report, the frames and the pictures."""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import io
import json
import shutil
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

from input_readers import Reader

import camctl
from camctl.captures.sequence import Progress
from camctl.cli import main
from camctl.errors import InterruptedCaptureError

REQUEST = camctl.CaptureRequest(ratios=(1.0, 4.0, 16.0), base_s=0.001)
OPTIONS = {"scene": "uniform", "size": "8x6"}
SOURCE = {"camera": "sim", "options": OPTIONS}


@cache
def _original(*, is_complete: bool) -> Path:
    """Return a folder with a complete capture, or one without its last frame."""
    folder = Path(tempfile.mkdtemp(prefix="camctl-capture-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)

    def interrupt(progress: Progress) -> None:
        if not is_complete and progress.stage == "shooting" and progress.done >= 2:
            raise KeyboardInterrupt

    with (
        camctl.open_camera("sim", OPTIONS) as camera,
        contextlib.suppress(InterruptedCaptureError),
    ):
        camctl.capture(camera, REQUEST, folder, source=SOURCE, progress=interrupt)
    return folder


def _copy(folder: Path, *, is_complete: bool) -> Path:
    copy = folder / "capture"
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(_original(is_complete=is_complete), copy)
    return copy


def _samples(name: str, *, is_complete: bool = True) -> Callable[[], list[bytes]]:
    return lambda: [(_original(is_complete=is_complete) / name).read_bytes()]


def _picture(name: str, read: Callable[[camctl.CaptureReport], object]) -> Reader:
    def replace_and_read(data: bytes, folder: Path) -> object:
        copy = _copy(folder, is_complete=True)
        (copy / name).write_bytes(data)
        return read(camctl.read_report(copy))

    return Reader(_samples(name), replace_and_read)


def _read_all(report: camctl.CaptureReport) -> object:
    frames = [report.frame(position) for position in range(len(report.frames))]
    return report.sum(), report.radiance(), report.mask(), report.image(), frames


def _resume(data: bytes, folder: Path) -> object:
    """Resume with the input as the report, by the command; it may end as commands do."""
    copy = _copy(folder, is_complete=False)
    (copy / "report.json").write_bytes(data)
    return _run("resume", str(copy), "--json")


def _run(*arguments: str) -> int:
    out, err = (io.TextIOWrapper(io.BytesIO(), encoding="utf-8") for _ in range(2))
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = main(arguments)
    for stream in (out, err):
        stream.seek(0)
    errors = [line for line in err if "camctl: warning: " not in line]
    assert status in (0, 1, 2, 3), status
    assert len(errors) == (status not in (0, 3)), errors
    assert not any("internal error" in line for line in errors), errors
    json.load(out)
    return status


def _resume_with_frame(data: bytes, folder: Path) -> object:
    """Resume with the input as a frame whose checksum is right."""
    copy = _copy(folder, is_complete=False)
    (copy / "frames" / "frame-01.npy").write_bytes(data)
    report = json.loads((copy / "report.json").read_bytes())
    report["frames"][0]["sha256"] = hashlib.sha256(data).hexdigest()
    (copy / "report.json").write_text(json.dumps(report))
    with camctl.open_camera("sim", OPTIONS) as camera:
        return camctl.resume(camera, copy)


CAPTURES = {
    "report": _picture("report.json", _read_all),
    "sum": _picture("sum.tiff", lambda report: report.sum()),
    "image": _picture("image.tiff", lambda report: report.image()),
    "radiance": _picture("radiance.exr", lambda report: (report.radiance(), report.mask())),
    "frame": _picture("frames/frame-01.npy", lambda report: report.frame(0)),
    "resumed report": Reader(_samples("report.json", is_complete=False), _resume),
    "resumed frame": Reader(_samples("frames/frame-01.npy", is_complete=False), _resume_with_frame),
}
