"""The folder of a series: its journal ``series.json``, and the names of the sets in it.

Each set is a capture in a folder of its own.  The journal states the folder of a set
before the set begins, and afterwards how it ended, so that a series can be continued whatever
ended it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from camctl.errors import CamctlError, DataError, StorageError, UsageError, unknown_name
from camctl.exposure.goal import CaptureRequest
from camctl.interface.camera import CameraInfo
from camctl.records import REPORT, SERIES
from camctl.records.capture_plan import CapturePlan
from camctl.records.report import CaptureReport
from camctl.records.report_file import LOCK, is_unused
from camctl.system.files import storage_error, write_bytes
from camctl.system.input_files import first_problem, read_own_file

GALLERY, THUMBNAILS = "index.html", "thumbnails"

PATTERN = "set-{number}"
"""Names of the sets' folders unless others are asked for."""

LEAST_INTERVAL_S = 1e-9
"""Shortest time between the starts of two sets, s: clocks count nanoseconds."""

MOST_SETS = 100_000
"""Most sets of a series: one a second for a day."""

_FIELDS = ("number", "date", "time")
_FIELD = re.compile(r"\{([^{}]*)\}")
#: A field of gphoto2's --filename: its number (%n, %03n), date, time and file name.
_GPHOTO2_FIELD = re.compile(r"%\d*[naAbBdfFHkIljmMSyYC]")
_RESERVED = {SERIES, GALLERY, THUMBNAILS, LOCK, REPORT}
#: Characters that no file name may have on one of the usual systems.
_FORBIDDEN = set('/\\<>:"|?*')
#: Bytes of a name, so that a file of the longest name in the folder still has a possible path.
_LONGEST_NAME = 200
#: Bytes that are read as a journal at most; a set takes less than 1 kB.
_LARGEST_JOURNAL = 256 << 20


def check_name(name: str) -> str:
    """Return a name for a folder in the folder of a series; raise `UsageError` for any other."""
    problem = ""
    if not name or name.startswith(".") or name != name.strip() or name.endswith("."):
        problem = "it is empty, or begins or ends with a dot or a space"
    elif not name.isprintable() or _FORBIDDEN & set(name):
        problem = (
            f"it has one of the characters {' '.join(sorted(_FORBIDDEN))}, or an invisible one"
        )
    elif name.lower() in _RESERVED or name.lower().startswith("-"):
        problem = "it is the name of a file of the series, or begins with -"
    elif len(name.encode()) > _LONGEST_NAME:
        problem = f"it is longer than {_LONGEST_NAME} bytes"
    if problem:
        raise UsageError(
            f"invalid folder name '{name[:80]}': {problem}",
            hint=f"name folders inside the series, such as {PATTERN}",
        )
    return name


def check_pattern(pattern: str) -> str:
    """Return a pattern for `set_name`; raise `UsageError` where it is none."""
    for field in _FIELD.findall(pattern):
        if field not in _FIELDS:
            raise unknown_name(
                "field of a name", f"{{{field}}}", [f"{{{each}}}" for each in _FIELDS]
            )
    if set("{}") & set(_FIELD.sub("", pattern)):
        raise UsageError(
            f"invalid name pattern '{pattern[:80]}': a brace has no partner",
            hint=f"fields are {', '.join(f'{{{each}}}' for each in _FIELDS)}",
        )
    if found := _GPHOTO2_FIELD.search(pattern):
        raise UsageError(
            f"unknown field of a name '{found[0]}', which is one of gphoto2",
            hint="write {number} for %n, {date} for %Y-%m-%d, {time} for %H-%M-%S",
        )
    check_name(set_name(pattern, MOST_SETS, datetime.min))
    return pattern


def set_name(pattern: str, number: int, begun: datetime) -> str:
    """Return the name of a set's folder.

    >>> set_name("hall {date} {number}", 7, datetime(2026, 5, 4))
    'hall 2026-05-04 0007'
    """
    values = {"number": f"{number:04d}", "date": f"{begun:%Y-%m-%d}", "time": f"{begun:%H-%M-%S}"}
    return _FIELD.sub(lambda field: values[field[1]], pattern)


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid")


class SetRecord(_Model):
    """One set of a series.

    Attributes:
        number: from 1
        folder: its name in the folder of the series
        state: "begun" until it is complete or has failed
        run: which time the series was begun or continued, from 1
        slot: with an interval, it was to begin `slot` intervals after the first set of the run
        started_s: when it began, after the first set of the run, by the camera's clock, s
        started_at: date and time when it began, ISO 8601
        seconds: how long it took by the camera's clock, s
        attempts: 2 where it was tried again
        error: why the last attempt that failed did; None where none did
        response: desired response
        dynamic_range: desired dynamic range
        exposures: number of exposures
        effective_levels: accuracy of its picture
        has_noise: whether `effective_levels` counts the camera's noise
        outside: share of its samples that are saturated in every frame, or too dark in every frame
        trustworthy: False where its frames contradict their exposures
        hook: "done" or "failed"; None where none was run
        hook_error: why the hook failed
        has_thumbnail: whether the gallery has a picture of it
    """

    number: int = Field(ge=1, le=MOST_SETS)
    folder: str
    state: Literal["begun", "complete", "failed"] = "begun"
    run: int = Field(default=1, ge=1)
    slot: int = Field(default=0, ge=0)
    started_s: float = Field(default=0.0, allow_inf_nan=False)
    started_at: str = Field(max_length=40)
    seconds: float = Field(default=0.0, allow_inf_nan=False)
    attempts: int = Field(default=1, ge=1, le=2)
    error: str | None = None
    response: str | None = None
    dynamic_range: float | None = None
    exposures: int | None = None
    effective_levels: float | None = None
    has_noise: bool = False
    outside: float | None = None
    trustworthy: bool = True
    hook: Literal["done", "failed"] | None = None
    hook_error: str | None = None
    has_thumbnail: bool = False

    @field_validator("folder")
    @classmethod
    def _is_inside(cls, folder: str) -> str:
        try:
            return check_name(folder)
        except UsageError as error:
            raise ValueError(error.what) from None

    def complete(self, report: CaptureReport) -> None:
        """Take over what the report of the set says."""
        achieved = report.achieved
        self.state = "complete"
        self.response, self.dynamic_range = report.plan.desired.name, report.plan.dynamic_range
        self.exposures = len(report.frames)
        self.effective_levels = achieved.effective_levels
        self.has_noise = achieved.noise is not None
        self.outside = achieved.saturated_fraction + achieved.dark_fraction
        self.trustworthy = report.trustworthy


class SeriesOptions(_Model):
    """How the sets of a series follow each other.

    Attributes:
        repeat: number of sets; None: until the user ends it
        interval_s: time from the start of one set to the start of the next, s; None: at once
        on_key: each set begins when a key is pressed
        name: pattern of the folders' names, see `check_pattern`
        meter: "once": all sets have the exposures of the first; "each": each set is metered
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    repeat: int | None = Field(default=None, ge=1, le=MOST_SETS)
    interval_s: float | None = Field(default=None, ge=LEAST_INTERVAL_S, allow_inf_nan=False)
    on_key: bool = False
    name: str = PATTERN
    meter: Literal["once", "each"] = "once"

    @model_validator(mode="after")
    def _agree(self) -> SeriesOptions:
        if self.repeat is None and not self.on_key:
            raise ValueError("a series without keys needs its number of sets")
        try:
            check_pattern(self.name)
        except UsageError as error:
            raise ValueError(error.what) from None
        return self


class SeriesJournal(_Model):
    """What is known of a series; the content of ``series.json``.

    Attributes:
        format_version: of this file
        camera: identity of the camera
        source: what is needed to open the camera again
        request: what was asked of each set
        table_file: the exposure table that was given
        options: how the sets follow each other
        plan: the exposures of all sets where these are metered once
        has_hook: whether a command was run after each set; it is not kept, since a file must not
            say which commands to run
        skipped: starts that were left out, since the set before took longer than the interval
        sets: in their order
    """

    format_version: Literal[1] = 1
    camera: CameraInfo
    source: dict[str, Any]
    request: CaptureRequest
    table_file: str | None = None
    options: SeriesOptions
    plan: CapturePlan | None = None
    has_hook: bool = False
    skipped: int = 0
    sets: list[SetRecord] = []

    @model_validator(mode="after")
    def _agree(self) -> SeriesJournal:
        if [each.number for each in self.sets] != list(range(1, len(self.sets) + 1)):
            raise ValueError("the sets are not numbered from 1")
        if len({each.folder for each in self.sets}) < len(self.sets):
            raise ValueError("two sets have the same folder")
        if any(each.state == "begun" for each in self.sets[:-1]):
            raise ValueError("a set before the last is neither complete nor failed")
        return self

    def count(self, accepts: Callable[[SetRecord], bool]) -> int:
        """Return the number of sets for which `accepts` returns True."""
        return sum(map(accepts, self.sets))

    @property
    def completed(self) -> int:
        """Number of sets that are complete."""
        return self.count(lambda each: each.state == "complete")

    @property
    def failed(self) -> list[SetRecord]:
        """The sets that failed twice."""
        return [each for each in self.sets if each.state == "failed"]

    def is_done(self) -> bool:
        """Return whether all sets were taken or have failed."""
        is_open = bool(self.sets) and self.sets[-1].state == "begun"
        return (
            self.options.repeat is not None
            and not is_open
            and (len(self.sets) >= self.options.repeat)
        )

    def new_folder(self, directory: Path, begun: datetime) -> str:
        """Return the name for the next set: one that nothing in `directory` has.

        Raises:
            StorageError: the name and the name with the set's number are both taken
        """
        number = len(self.sets) + 1
        name = set_name(self.options.name, number, begun)
        used = {each.folder for each in self.sets[-1:]}
        for each in (name, f"{name}-{number}"):
            if each not in used and not os.path.lexists(directory / each):
                return each
        raise StorageError(f"{directory / each} is there already", hint="move it away")

    def save(self, directory: Path) -> None:
        """Write the journal, atomically.  Raises `StorageError`."""
        write_bytes(directory / SERIES, self.model_dump_json(indent=1).encode() + b"\n")


def check_series_folder(directory: Path) -> None:
    """Check that `directory` is new or empty; raise `StorageError` where it is not."""
    try:
        unused = is_unused(directory)
    except OSError as error:
        raise storage_error(directory, error) from error
    if not unused:
        raise StorageError(
            f"{directory} is not empty",
            hint="choose another folder for the series",
            remedies={"directory": None},
        )


def read_series(directory: Path) -> SeriesJournal:
    """Return the journal of a series.

    Raises:
        DataError: it is missing or damaged
    """
    path = directory / SERIES
    try:
        return SeriesJournal.model_validate_json(read_own_file(path, _LARGEST_JOURNAL))
    except ValidationError as error:
        raise DataError(
            f"{path} is damaged: {first_problem(error)}", hint="begin a new series"
        ) from None
    except CamctlError as error:  # of the request in it
        if isinstance(error, DataError):
            raise
        raise DataError(f"{path} is damaged: {error.what}", hint="begin a new series") from None
