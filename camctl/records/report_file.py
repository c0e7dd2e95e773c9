"""Reading ``report.json`` and naming the files of a capture's folder.

A report is read as hostile input: anybody may have written it.  What `read_report_file` returns
names files of its own folder only, and its numbers are possible for a capture.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import pydantic_core
from pydantic import BaseModel, Field, TypeAdapter, ValidationError

from camctl.errors import CamctlError, DataError
from camctl.exposure.objective import MAX_LEVELS_WANTED
from camctl.exposure.search.settings import relative_exposures
from camctl.interface.camera import Camera, CameraInfo
from camctl.interface.controls import ExposureSetting
from camctl.model.effective import WIDEST_RATIO, check_count
from camctl.pictures.files import PICTURE_FILES
from camctl.records import REPORT as REPORT
from camctl.records.frame import StoredFrame
from camctl.records.report import FORMAT_VERSION, CaptureReport, UnfinishedCapture
from camctl.records.report_json import from_json
from camctl.system.files import leftovers
from camctl.system.input_files import first_problem, read_own_file

FRAMES, LOCK = "frames", ".camctl.lock"

SAMPLES = ".npy"
"""Suffix of a file with the samples of a frame."""

#: Bytes that are read as a report at most; 64 frames with all that a simulation reports are 0.4 MB.
_LARGEST_REPORT = 8 << 20
#: Bytes of what a camera reports of one frame; 64 of them fit into a report.
_LONGEST_DETAILS = 64 << 10
#: Characters of a file suffix at most, without the dot.
_LONGEST_SUFFIX = 8
#: More stops than any light is above a range.
_MOST_STOPS = 200

#: A frame's file, with its position from 1, the number of a rejected one, and its suffix.
_FRAME = rf"frame-(\d\d)(?:-rejected-([1-9]\d?))?(\.[a-z0-9]{{1,{_LONGEST_SUFFIX}}})"
FRAME_FILE = re.compile(rf"{_FRAME}", re.ASCII)
#: What a killed process may leave in the folder, and in frames/.
LEFTOVER = leftovers((REPORT, *PICTURE_FILES.values()))
STAGED_FILE = re.compile(rf"\.{_FRAME}\.staged", re.ASCII)

_ANY_CAPTURE: TypeAdapter[CaptureReport | UnfinishedCapture] = TypeAdapter(
    Annotated[CaptureReport | UnfinishedCapture, Field(discriminator="status")]
)


class _Header(BaseModel):
    """What reports of all versions have in common."""

    format_version: int


def frame_file(position: int, suffix: str = SAMPLES, rejected: int = 0) -> str:
    """Return the name in the folder of a file of frame `position`, 0 first."""
    aside = f"-rejected-{rejected}" if rejected else ""
    return f"{FRAMES}/frame-{position + 1:02d}{aside}{suffix}"


def position_of(name: str) -> int:
    """Return the position of the frame that a file of `frame_file` belongs to."""
    return int(name.removeprefix(f"{FRAMES}/frame-")[:2]) - 1


def clean_suffix(suffix: str) -> str:
    """Return a suffix that a camera supplied as one of a file beside a frame's samples.

    >>> clean_suffix(".NEF"), clean_suffix("/../a.npy"), clean_suffix(".npy")
    ('.nef', '.anpy', '.bin')
    """
    letters = re.sub(r"[^a-z0-9]", "", suffix.lower())[:_LONGEST_SUFFIX]
    return f".{letters}" if letters and f".{letters}" != SAMPLES else ".bin"


def clean_details(details: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a camera reports of a frame as a short JSON object that can be read back.

    >>> clean_details({"lens": "50 mm", "shift": float("nan")})
    {'lens': '50 mm', 'shift': None}
    """
    try:
        text = json.dumps(dict(details), default=str, ensure_ascii=False).encode("utf-8", "replace")
        if len(text) <= _LONGEST_DETAILS:
            cleaned: dict[str, Any] = json.loads(text, parse_constant=lambda _: None)
            return cleaned
    except (TypeError, ValueError, RecursionError):
        pass
    return {"omitted": f"no JSON object of up to {_LONGEST_DETAILS} bytes"}


def is_unused(directory: Path) -> bool:
    """Return whether a folder is missing, or has only what a capture makes before its report.

    Raises OSError.
    """
    if not directory.exists():
        return True
    for entry in directory.iterdir():
        if entry.name == FRAMES and entry.is_dir() and not entry.is_symlink():
            if any(entry.iterdir()):
                return False
        elif entry.name != LOCK and not LEFTOVER.fullmatch(entry.name):
            return False
    return True


def named_files(report: CaptureReport | UnfinishedCapture) -> set[str]:
    """Return the names of all files that belong to a capture, but for its report."""
    frames = [frame for frame in report.frames if frame is not None]
    names = {*report.files.values(), *report.rejected}
    names |= {name for frame in frames for name in (frame.file, frame.original) if name is not None}
    return names | set(report.discarded if isinstance(report, UnfinishedCapture) else ())


def read_report_file(directory: Path) -> CaptureReport | UnfinishedCapture:
    """Read and check the report of a capture in a folder.

    Raises:
        DataError: there is none, it is damaged, or it is of another version
    """
    path = directory / REPORT
    try:
        data = read_own_file(path, _LARGEST_REPORT)
    except DataError as error:
        if isinstance(error.__cause__, FileNotFoundError):
            raise _no_report(directory) from error
        raise
    try:
        version = _Header.model_validate_json(data).format_version
        if version == FORMAT_VERSION:
            content = pydantic_core.to_json(from_json(pydantic_core.from_json(data)))
            report = _ANY_CAPTURE.validate_json(content)
            problem = next(_problems(report), None)
    except ValidationError as error:
        problem = first_problem(error, skipped=1)  # the first is the kind of report
    except (CamctlError, ValueError, ArithmeticError) as error:
        problem = str(error)  # the request or the plan in it is invalid
    else:
        if version != FORMAT_VERSION:
            raise DataError(
                f"{path} has format version {version}, and this camctl reads {FORMAT_VERSION}",
                hint="use that camctl; frames/*.npy can be read with numpy.load",
            )
    if problem is not None:
        raise DataError(
            f"{path} is damaged: {problem}",
            hint="its frames are still in frames/; shoot again into another folder",
        )
    return report


def check_camera(
    camera: Camera, directory: Path, report: CaptureReport | UnfinishedCapture
) -> None:
    """Raise `DataError` unless `camera` can continue the capture in `directory`."""
    check_same_camera(report.camera, camera.info, directory)
    controls = camera.controls
    black_total = controls.black * len(report.plan.settings)
    kept = report.white, report.black_total, report.layout
    if (controls.white, black_total, controls.layout) != kept:
        raise DataError(
            f"{directory} was begun in another format of the camera", hint="set the same format"
        )


def check_same_camera(begun: CameraInfo, present: CameraInfo, directory: Path) -> None:
    """Raise `DataError` unless what was begun in `directory` was begun with the present camera."""
    if (begun.make, begun.model, begun.serial) != (present.make, present.model, present.serial):
        names = begun.name, present.name
        if begun.name == present.name:
            names = f"the {begun.name} {begun.serial}", f"{present.serial}"
        raise DataError(
            f"{directory} was begun with {names[0]}, and this camera is {names[1]}",
            hint="connect the same camera",
        )


def _no_report(directory: Path) -> DataError:
    try:
        nothing_shot = directory.exists() and is_unused(directory)
    except OSError:
        nothing_shot = False
    if nothing_shot:
        return DataError(
            f"nothing was shot into {directory}",
            hint="start anew",
            remedies={"shoot": directory},
        )
    return DataError(
        f"{directory} holds no capture: {REPORT} is missing", hint="name the folder of a capture"
    )


def _problems(report: CaptureReport | UnfinishedCapture) -> Iterator[str]:
    """Yield what in a report cannot be true, one line each.  May raise `CamctlError`."""
    settings, frames = report.plan.settings, report.frames
    check_count(len(settings))
    if len(frames) != len(settings):
        yield f"frames: {len(frames)} instead of {len(settings)}, as many as the plan has settings"
    if not (1 <= report.white <= 0xFFFF and 0 <= report.black_total < report.white * len(settings)):
        yield "white and black_total contradict each other"
    yield from _number_problems("", report.model_dump(exclude={"source"}))
    present = [frame for frame in frames if frame is not None]
    used = [*settings, *(frame.applied for frame in present)]
    if not all(map(_is_possible, used)):
        yield "an exposure setting is not positive and finite"
    elif not _agree(report.plan.exposures, relative_exposures(settings)):
        yield "plan.exposures do not follow from plan.settings"
    elif max(one.exposure for one in used) > WIDEST_RATIO * min(one.exposure for one in used):
        yield f"the exposures differ by more than a factor of {WIDEST_RATIO:g}"
    if not 0 < report.plan.levels_wanted <= MAX_LEVELS_WANTED:
        yield f"plan.levels_wanted is not from 0 to {MAX_LEVELS_WANTED:g}"
    light = report.plan.light
    if light is not None and not 0 <= light.clips_stops <= _MOST_STOPS:
        yield f"plan.light.clips_stops is not from 0 to {_MOST_STOPS}"
    _ = report.plan.desired  # raises where there is no such response
    for position, frame in enumerate(frames):
        if frame is not None:
            yield from _frame_problems(report, frame, position)
    yield from _name_problems(report)


def _number_problems(where: str, value: object) -> Iterator[str]:
    """Yield the places with a number that is not finite."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _number_problems(f"{where}.{key}" if where else str(key), item)
    elif isinstance(value, list | tuple):
        for index, item in enumerate(value):
            yield from _number_problems(f"{where}.{index}", item)
    elif isinstance(value, float) and not math.isfinite(value):
        yield f"{where}: {value} is not finite"


def _agree(first: Sequence[float], second: Sequence[float]) -> bool:
    """Return whether both are the same numbers but for rounding."""
    return len(first) == len(second) and all(map(math.isclose, first, second))


def _is_possible(setting: ExposureSetting) -> bool:
    f_number = 1.0 if setting.f_number is None else setting.f_number
    values = (setting.time_s, setting.gain, f_number)
    return all(0 < value < math.inf for value in values) and 0 < setting.exposure < math.inf


def _frame_problems(
    report: CaptureReport | UnfinishedCapture, frame: StoredFrame, position: int
) -> Iterator[str]:
    expected = report.white, report.black_total
    if (frame.white, frame.black * len(report.frames)) != expected:
        yield f"frames.{position}: its black and white differ from the capture's"
    if (frame.requested_s, frame.applied_s) != (frame.requested.time_s, frame.applied.time_s):
        yield f"frames.{position}: requested_s and applied_s are not the times of its settings"
    if (frame.file is None) != (frame.sha256 is None):
        yield f"frames.{position}: file and sha256 belong together"
    if (frame.original is None) != (frame.original_sha256 is None):
        yield f"frames.{position}: original and original_sha256 belong together"


def _name_problems(report: CaptureReport | UnfinishedCapture) -> Iterator[str]:
    """Yield names that a capture cannot have: no other file is opened, renamed or removed."""
    for position, frame in enumerate(report.frames):
        if frame is None:
            continue
        if frame.file not in (None, frame_file(position)):
            yield f"frames.{position}.file: expected {frame_file(position)}"
        if frame.original is not None:
            suffix = "." + frame.original.rpartition(".")[2]
            if frame.original != frame_file(position, clean_suffix(suffix)):
                yield f"frames.{position}.original: expected a file beside {frame_file(position)}"
    for name in report.rejected:
        match = FRAME_FILE.fullmatch(name.removeprefix(f"{FRAMES}/"))
        if not name.startswith(f"{FRAMES}/") or match is None or match[2] is None:
            yield "rejected: a file with another name than a rejected frame"
    if any(PICTURE_FILES.get(kind) != name for kind, name in report.files.items()):
        yield "files: a file with another name than a picture"
    if not isinstance(report, UnfinishedCapture):
        return
    named = named_files(report.model_copy(update={"discarded": []}))
    for name in report.discarded:
        is_frame = name.startswith(f"{FRAMES}/") and FRAME_FILE.fullmatch(name[len(FRAMES) + 1 :])
        if (not is_frame and name not in PICTURE_FILES.values()) or name in named:
            yield "discarded: a file with another name than the files of a capture"
