"""Failures after the first frame of a capture: what they say, and how it is resumed."""

from __future__ import annotations

import errno
import re
from collections.abc import Callable
from functools import reduce
from importlib import import_module
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from camctl_process import SHOOT
from command_line import Run
from crash_sweep import checked

from camctl.errors import CameraDisconnectedError, RefusedSettingError


def array_too_large() -> MemoryError:
    """Return the error of numpy for an array that cannot be allocated."""
    with pytest.raises(MemoryError) as caught:
        np.empty((1 << 20, 1 << 35))
    return caught.value


def no_memory_in_opencv() -> cv2.error:
    error = cv2.error("OpenCV: Failed to allocate 1 bytes")
    error.code = -4
    return error


def no_memory_in_the_c_library() -> cv2.error:
    """Return what OpenCV raises, as seen with ulimit -v 600000, while it measures text."""
    return cv2.error("std::bad_alloc")


FRAME = "camctl.sim.camera:SimulatedCamera._counted_frame"
SUM = "camctl.captures.sequence:Accumulator.accumulate"
PREVIEW = "camctl.pictures.files:png"
DISK_FULL = OSError(errno.ENOSPC, "No space left on device")
UNPLUGGED = CameraDisconnectedError("the camera was unplugged", hint="plug it in again")
REFUSED = RefusedSettingError("time_s", 1.0, 0.5)


def call_first(monkeypatch: pytest.MonkeyPatch, point: str, action: Callable[[], object]) -> None:
    """Call `action` before a call of "module:function": the second of those of each frame."""
    module, _, path = point.partition(":")
    *names, last = path.split(".")
    owner = reduce(getattr, names, import_module(module))
    function = getattr(owner, last)
    calls: list[object] = []

    def call(*arguments: Any, **named: Any) -> Any:
        calls.append(arguments)
        if len(calls) == (2 if point in (FRAME, SUM) else 1):
            action()
        return function(*arguments, **named)

    monkeypatch.setattr(owner, last, call)


@pytest.mark.parametrize(
    ("point", "error", "kept", "message"),
    [
        (FRAME, UNPLUGGED, 1, "the camera was unplugged; plug it in again"),
        (FRAME, REFUSED, 1, "the camera cannot set time_s to 1; the nearest it can do is 0.5"),
        (FRAME, ValueError("odd"), 1, "internal error: ValueError: odd"),
        (SUM, MemoryError(), 2, "not enough memory; choose a smaller picture"),
        (SUM, array_too_large(), 2, "not enough memory for an array of 2.68e.08 GiB"),
        (PREVIEW, no_memory_in_opencv(), 2, "not enough memory for a picture"),
        (PREVIEW, no_memory_in_the_c_library(), 2, "not enough memory for a picture"),
        (PREVIEW, RuntimeError("can't start new thread"), 2, "the system starts no more threads"),
        ("tifffile:imwrite", DISK_FULL, 2, r"cannot write out/(sum|image)\.tiff: the disk is full"),
        ("camctl.captures.sequence:complete", KeyboardInterrupt(), 2, "interrupted"),
    ],
)
def test_failure_after_the_first_frame_says_how_to_resume(
    run: Run,
    monkeypatch: pytest.MonkeyPatch,
    point: str,
    error: BaseException,
    kept: int,
    message: str,
) -> None:

    def fail() -> None:
        raise error

    call_first(monkeypatch, point, fail)
    ran = run(*SHOOT)
    assert ran.status == (130 if isinstance(error, KeyboardInterrupt) else 1)
    assert re.match(message, ran.error)
    what = "make the picture of them" if kept == 2 else "shoot the others"
    assert f"; {kept} of 2 frames are kept; {what} (camctl resume out)" in ran.error
    folder = Path("out").absolute()
    monkeypatch.undo()  # the working folder, too
    assert checked(folder)["wrong"] == []


@pytest.mark.parametrize("point", [FRAME, "tifffile:imwrite", PREVIEW])
def test_folder_that_is_removed_meanwhile(
    run: Run, monkeypatch: pytest.MonkeyPatch, point: str
) -> None:
    # Renamed, since another thread may be writing into it: to remove file by file could fail.
    call_first(monkeypatch, point, lambda: Path("out").rename("removed"))
    ran = run(*SHOOT)
    assert ran.status == 1
    assert ran.error.startswith("cannot write out")
    assert "out was removed meanwhile, and the frames with it; shoot again" in ran.error
    assert run(*SHOOT).status == 0
