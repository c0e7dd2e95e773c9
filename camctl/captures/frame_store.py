"""Where the frames and pictures of a capture are kept: in a folder, or in memory.

A folder holds ``frames/`` (every frame from the moment it arrived), the picture files, and
``report.json``, which is there from the first frame on.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, TypeAdapter, ValidationError

from camctl.camera import Frame, Pixels
from camctl.captures.picture_files import (
    IMAGE,
    PREVIEW,
    RADIANCE,
    SUM,
    read_radiance,
    read_tiff,
    write_picture_files,
)
from camctl.captures.pictures import Rendering
from camctl.captures.report import CaptureReport, Pictures, UnfinishedCapture
from camctl.errors import DataError, StorageError, UsageError
from camctl.files import storage_error, write_array, write_bytes

REPORT = "report.json"
FRAMES = "frames"


class CaptureStore(Pictures, Protocol):
    """Keeps what a capture produces, and returns it again."""

    def keep(self, frame: Frame, position: int) -> tuple[str | None, str | None]:
        """Keep a frame; return the file names of its samples and of the camera's own file."""
        ...

    def holds(self, position: int) -> bool:
        """Return whether a frame that was kept is still there."""
        ...

    def reject(self, position: int) -> str | None:
        """Set a frame aside, since it will be shot again; return its new file name."""
        ...

    def save_report(self, report: UnfinishedCapture | CaptureReport) -> None:
        """Keep the report in its present state."""
        ...

    def keep_pictures(
        self, total: NDArray[np.unsignedinteger], rendering: Rendering
    ) -> dict[str, str]:
        """Keep the sum and the pictures rendered from it; return their file names by kind."""
        ...

    def after_failure(self, done: int, count: int) -> tuple[str, str]:
        """Return what an error adds: how many frames are kept, and how to go on."""
        ...


@dataclass(frozen=True)
class FolderStore:
    """A capture in a folder: each file is complete or missing.

    Its methods raise `StorageError` where a file cannot be written, `DataError` where one that is
    read is missing or damaged.
    """

    directory: Path

    @staticmethod
    def check_free(directory: Path, *, overwrite: bool = False) -> None:
        """Check, before anything is shot, that `directory` can take a capture.

        With `overwrite` an earlier capture there may be replaced; other files are never touched.

        Raises:
            StorageError: the folder is not empty, or cannot be read
        """
        try:
            occupied = directory.exists() and any(directory.iterdir())
        except OSError as error:
            raise storage_error(directory, error) from error
        if occupied and not (overwrite and (directory / REPORT).exists()):
            hint = "choose another folder with -o"
            if (directory / REPORT).exists():
                hint += ", or replace this capture with --force"
            raise StorageError(f"{directory} is not empty", hint=hint)

    @classmethod
    def create(cls, directory: Path, *, overwrite: bool = False) -> FolderStore:
        """Make the folder, and remove the files of an earlier capture from it.

        Raises:
            StorageError: as `check_free`, or the folder cannot be made
        """
        cls.check_free(directory, overwrite=overwrite)
        try:
            for name in (REPORT, SUM, IMAGE, RADIANCE, PREVIEW):
                (directory / name).unlink(missing_ok=True)
            frames = directory / FRAMES
            if frames.exists():
                for old in frames.iterdir():
                    old.unlink()
            frames.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise storage_error(directory, error) from error
        return cls(directory)

    def keep(self, frame: Frame, position: int) -> tuple[str | None, str | None]:
        """Write a frame, and the camera's own file first, if there is one."""
        path, original = self._frame_path(position), None
        if frame.original is not None:
            original = f"{FRAMES}/{path.stem}{frame.original.suffix}"
            write_bytes(self.directory / original, frame.original.data)
        write_array(path, frame.pixels)
        return f"{FRAMES}/{path.name}", original

    def holds(self, position: int) -> bool:
        """Return whether the frame's file exists."""
        return self._frame_path(position).exists()

    def reject(self, position: int) -> str | None:
        """Rename the frame's file."""
        path = self._frame_path(position)
        for number in range(1, 100):
            aside = path.with_name(f"{path.stem}-rejected-{number}{path.suffix}")
            if not aside.exists():
                break
        try:
            path.rename(aside)
        except OSError as error:
            raise storage_error(path, error) from error
        return f"{FRAMES}/{aside.name}"

    def save_report(self, report: UnfinishedCapture | CaptureReport) -> None:
        """Write report.json."""
        write_bytes(self.directory / REPORT, report.model_dump_json(indent=2).encode() + b"\n")

    def keep_pictures(
        self, total: NDArray[np.unsignedinteger], rendering: Rendering
    ) -> dict[str, str]:
        """Write sum.tiff, image.tiff, radiance.exr and preview.png."""
        return write_picture_files(total, rendering, self.directory)

    def after_failure(self, done: int, count: int) -> tuple[str, str]:
        """Name the command that completes the capture."""
        return (
            f"{done} of {count} frames are kept",
            f"go on with: camctl shoot --resume {self.directory}",
        )

    def frame(self, position: int) -> Pixels:
        """Read the samples of a frame."""
        path = self._frame_path(position)
        try:
            pixels: Pixels = np.load(path, allow_pickle=False)
        except (OSError, ValueError, EOFError) as error:
            raise DataError(
                f"{path} cannot be read: {error}", hint="remove it, and resume: it is shot again"
            ) from error
        if pixels.dtype not in (np.uint8, np.uint16):
            raise DataError(
                f"{path} holds {pixels.dtype} instead of uint8 or uint16",
                hint="remove it, and resume: it is shot again",
            )
        return pixels

    def sum(self) -> NDArray[np.unsignedinteger]:
        """Read sum.tiff."""
        return read_tiff(self.directory / SUM)

    def image(self) -> NDArray[np.uint16]:
        """Read image.tiff."""
        return read_tiff(self.directory / IMAGE)

    def radiance(self) -> NDArray[np.float32]:
        """Read radiance.exr."""
        return read_radiance(self.directory / RADIANCE)[0]

    def mask(self) -> NDArray[np.uint8]:
        """Read the masks in radiance.exr."""
        return read_radiance(self.directory / RADIANCE)[1]

    def _frame_path(self, position: int) -> Path:
        return self.directory / FRAMES / f"frame-{position + 1:02d}.npy"


@dataclass(frozen=True, eq=False)
class _Arrays:
    total: NDArray[np.unsignedinteger]
    code: NDArray[np.uint16]
    irradiance: NDArray[np.float32]
    mask: NDArray[np.uint8]


class MemoryStore:
    """A capture in memory: nothing is written to disk, and nothing survives a failure."""

    def __init__(self) -> None:
        self._frames: dict[int, Pixels] = {}
        self._arrays: _Arrays | None = None

    def keep(self, frame: Frame, position: int) -> tuple[str | None, str | None]:
        """Keep the samples of a frame."""
        self._frames[position] = frame.pixels
        return None, None

    def holds(self, position: int) -> bool:
        """Return whether the frame was kept."""
        return position in self._frames

    def reject(self, position: int) -> str | None:
        """Drop the frame."""
        del self._frames[position]
        return None

    def save_report(self, report: UnfinishedCapture | CaptureReport) -> None:
        """Do nothing: the report is in memory."""

    def keep_pictures(
        self, total: NDArray[np.unsignedinteger], rendering: Rendering
    ) -> dict[str, str]:
        """Keep the sum and render the pictures."""
        shape, row = rendering.picture_shape(total), 0
        arrays = _Arrays(
            total,
            np.empty(shape, np.uint16),
            np.empty(shape, np.float32),
            np.empty(shape, np.uint8),
        )
        for strip in rendering.strips(total):
            rows = slice(row, row + strip.code.shape[0])
            arrays.code[rows], arrays.irradiance[rows] = strip.code, strip.irradiance
            arrays.mask[rows] = strip.mask
            row = rows.stop
        self._arrays = arrays
        return {}

    def after_failure(self, done: int, count: int) -> tuple[str, str]:
        """State that the frames are lost."""
        return (
            f"{done} of {count} frames were taken and are lost",
            "capture again, into a folder to keep the frames",
        )

    def frame(self, position: int) -> Pixels:
        """Return the samples of a frame."""
        return self._frames[position]

    def sum(self) -> NDArray[np.unsignedinteger]:
        """Return the sum of the frames."""
        return self._complete().total

    def image(self) -> NDArray[np.uint16]:
        """Return the image in the desired response."""
        return self._complete().code

    def radiance(self) -> NDArray[np.float32]:
        """Return the irradiance."""
        return self._complete().irradiance

    def mask(self) -> NDArray[np.uint8]:
        """Return the marks of what is out of range."""
        return self._complete().mask

    def _complete(self) -> _Arrays:
        if self._arrays is None:
            raise DataError("the capture has no pictures yet", hint="capture all its frames first")
        return self._arrays


_ANY_CAPTURE: TypeAdapter[CaptureReport | UnfinishedCapture] = TypeAdapter(
    Annotated[CaptureReport | UnfinishedCapture, Field(discriminator="status")]
)


def read_capture(directory: str | os.PathLike[str]) -> CaptureReport | UnfinishedCapture:
    """Read the report of a capture in a folder, complete or not.

    Raises:
        DataError: there is none, or it is damaged
    """
    directory = Path(directory)
    path = directory / REPORT
    try:
        report = _ANY_CAPTURE.validate_json(path.read_bytes())
    except FileNotFoundError as error:
        raise DataError(
            f"{directory} holds no capture: {REPORT} is missing",
            hint="name the folder of a capture",
        ) from error
    except OSError as error:
        raise DataError(f"cannot read {path}: {error.strerror or error}") from error
    except (ValidationError, UsageError) as error:
        raise DataError(
            f"{path} is damaged: {_first_problem(error)}",
            hint="its frames are still in frames/; shoot again into another folder",
        ) from error
    if isinstance(report, CaptureReport):
        report.with_pictures(FolderStore(directory))
    return report


def _first_problem(error: ValidationError | UsageError) -> str:
    """Return what is damaged in a report, in one line."""
    if isinstance(error, UsageError):
        return str(error)
    first = error.errors()[0]
    where = ".".join(str(part) for part in first["loc"][1:])  # the first is the kind of report
    return f"{where}: {first['msg']}" if where else first["msg"]


def read_report(directory: str | os.PathLike[str]) -> CaptureReport:
    """Read the report of a complete capture; its pictures are read when they are asked for.

    Raises:
        DataError: the folder holds no complete capture, or its report is damaged
    """
    report = read_capture(directory)
    if isinstance(report, UnfinishedCapture):
        raise DataError(
            f"{directory} holds an incomplete capture",
            hint=f"complete it with: camctl shoot --resume {directory}",
        )
    return report
