"""A capture in a folder: the frames, the pictures, and the report that is the folder's journal.

A folder holds ``frames/`` (every frame from the moment it arrived), the picture files, and
``report.json``, which is there from before the first frame on.  One process at a time writes it.

What happens to a file is written in the report first, and then done.  A new frame is written under
a hidden name; the report that names it, with its checksum, is saved; then the file gets its name.
The same holds for frames that are set aside, pictures, and files of an earlier capture that are
removed.  Each of these steps is on disk before the next begins, so that whenever the process or the
power fails, the report is never behind the frames, and `FolderStore.reopen` does what was left.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any, Final

import numpy as np
import pydantic_core
from numpy.typing import NDArray

from camctl.errors import DataError, StorageError
from camctl.findings import note
from camctl.interface.backends import is_local
from camctl.interface.camera import Frame, Pixels
from camctl.pictures.details import PictureDetails
from camctl.pictures.files import (
    IMAGE,
    RADIANCE,
    SUM,
    load_libraries,
    picture_files,
    read_deviation,
    read_mask,
    read_radiance,
    read_tiff,
    write_picture_files,
)
from camctl.pictures.render import Rendering
from camctl.records.folder import CaptureFolder, staged_name
from camctl.records.frame import StoredFrame
from camctl.records.frame_store import AfterFailure, KeptFiles
from camctl.records.report import CaptureReport, UnfinishedCapture
from camctl.records.report_file import (
    LOCK,
    REPORT,
    clean_suffix,
    frame_file,
    is_unused,
    named_files,
    position_of,
    read_report_file,
)
from camctl.records.report_json import to_json
from camctl.system.files import make_folder, npy_parts, write_bytes
from camctl.system.system_errors import advice

_READERS: Final[dict[str, tuple[str, Callable[[Path], NDArray[Any]]]]] = {
    "sum": (SUM, read_tiff),
    "image": (IMAGE, read_tiff),
    "radiance": (RADIANCE, read_radiance),
    "deviation": (RADIANCE, read_deviation),
    "mask": (RADIANCE, read_mask),
}
#: How often one exposure can be rejected; far more than happens.
_MOST_REJECTED = 99


def resumption(directory: Path, source: Mapping[str, Any]) -> Path | tuple[Path, str]:
    """Return what the remedy "resume" has: also the camera where a report may not lead to it."""
    camera, values = source.get("camera"), source.get("options")
    if isinstance(camera, str) and isinstance(values, dict) and not is_local(camera, values):
        return directory, camera
    return directory


class FolderStore:
    """A capture in a folder: each file is complete or missing.

    `create` and `reopen` own the folder; a store made by the constructor only reads.  The methods
    raise `StorageError` where a file cannot be written, `DataError` where one that is read is
    missing or damaged.

    Args:
        directory: the folder
        report: the report that is in it; None: none is there yet
    """

    def __init__(
        self, directory: Path, report: UnfinishedCapture | CaptureReport | None = None
    ) -> None:
        self.directory = directory
        self.report = report
        self._folder = CaptureFolder(directory)
        self._renames: dict[str, str] = {}  # done when the next report was saved
        self._removals: list[str] = []  # the same
        self._kept: set[int] = set()  # positions of the frames that this process wrote

    @classmethod
    @contextmanager
    def create(cls, directory: Path, *, overwrite: bool = False) -> Iterator[FolderStore]:
        """Make the folder where it is missing, and own it while the block runs.

        With `overwrite` an earlier capture there is replaced, when the first report is saved; other
        files are never touched.  Where no report is saved the folder is left as it was.

        Raises:
            StorageError: the folder is in use or not empty, or cannot be made
        """
        load_libraries()
        lock = directory / LOCK
        if not (overwrite and (directory / REPORT).exists()):
            cls._replaced(directory)  # before a lock is made in a folder of others
        store, has_lock = cls(directory), lock.exists()
        with store._folder.storage_errors():
            made = make_folder(directory)
        try:
            with store._folder.owned():
                try:
                    store._removals = sorted(cls._replaced(directory, overwrite=overwrite))
                    with store._folder.storage_errors():
                        store._folder.remove_leftovers()
                    yield store
                finally:
                    if store.report is None and not has_lock:
                        lock.unlink(missing_ok=True)
        finally:
            if store.report is None:
                with suppress(OSError):  # not empty: another process has begun a capture in it
                    for folder in made:
                        folder.rmdir()

    @classmethod
    @contextmanager
    def reopen(cls, directory: Path) -> Iterator[FolderStore]:
        """Own the folder of a capture while the block runs; first do what its report says.

        The store's `report` has None for each frame whose file is missing.

        Raises:
            DataError: the folder holds no capture, or its report is damaged
            StorageError: the folder is in use, or holds files that the capture would overwrite
        """
        load_libraries()
        read_report_file(directory)  # no lock is made in a folder that holds no capture
        store = cls(directory)
        with store._folder.owned():
            store.report = read_report_file(directory)
            if isinstance(store.report, UnfinishedCapture):
                with store._folder.storage_errors():
                    store._recover(store.report)
            yield store

    @staticmethod
    def check_free(directory: Path, *, overwrite: bool = False) -> None:
        """Check, before anything is shot or computed, that `directory` can take a capture.

        Raises:
            StorageError: the folder is in use or not empty, or cannot be read
        """
        folder = CaptureFolder(directory)
        with folder.owned() if (directory / LOCK).exists() else nullcontext():
            FolderStore._replaced(directory, overwrite=overwrite)

    @staticmethod
    def _replaced(directory: Path, *, overwrite: bool = False) -> set[str]:
        """Return the names of the files of an earlier capture, which the new one replaces.

        Those are the files that its report names.

        Raises:
            StorageError: the folder is not empty, or cannot be read
        """
        folder = CaptureFolder(directory)
        with folder.storage_errors():
            if is_unused(directory):
                return set()
            hint, remedies = "choose another folder", {"directory": None}
            is_capture = (directory / REPORT).exists()
            if not (is_capture and overwrite):
                if is_capture:
                    hint += ", or replace this capture"
                    remedies = {**remedies, "overwrite": None}
                raise StorageError(f"{directory} is not empty", hint=hint, remedies=remedies)
            try:
                report = read_report_file(directory)
            except DataError as error:
                raise StorageError(
                    f"{directory} is not empty, and not replaced: {error.what}",
                    hint=hint,
                    remedies=remedies,
                ) from error
            names = named_files(report)
            folder.check_claims(names)
            return {name for name in names if folder.is_file(name)}

    def keep(self, frame: Frame, position: int) -> KeptFiles:
        """Write a frame, and the camera's own file first, if there is one, under hidden names."""
        original = original_sha256 = None
        if frame.original is not None:
            original = frame_file(position, clean_suffix(frame.original.suffix))
            staged, original_sha256 = self._folder.stage(original, (frame.original.data,))
            self._renames[staged] = original
        file = frame_file(position)
        staged, sha256 = self._folder.stage(file, npy_parts(frame.pixels))
        self._renames[staged] = file
        self._kept.add(position)
        return KeptFiles(file, sha256, original, original_sha256)

    def reject(self, position: int) -> list[str]:
        """Rename the frame's files."""
        record = self._record(position)
        sources = {  # of a frame that is about to get its name
            name: staged for staged, name in self._renames.items() if position_of(name) == position
        }
        of_record = (record.file, record.original) if record is not None else ()
        sources |= {name: name for name in of_record if name and self._folder.is_file(name)}
        for number in range(1, _MOST_REJECTED + 1):
            targets = [frame_file(position, Path(name).suffix, number) for name in sources]
            if not any(os.path.lexists(self.directory / target) for target in targets):
                break
        else:
            raise StorageError(
                f"{self._folder.frames} holds {_MOST_REJECTED} rejected frames of one exposure",
                hint="move them away",
            )
        self._renames.update(zip(sources.values(), targets, strict=True))
        return targets

    def save_report(self, report: UnfinishedCapture | CaptureReport) -> None:
        """Write report.json, then rename and remove what it says."""
        if isinstance(report, UnfinishedCapture):
            report.discarded = self._removals
        with self._folder.storage_errors():
            make_folder(self._folder.frames)
            data = pydantic_core.to_json(to_json(report), indent=2, inf_nan_mode="null")
            write_bytes(self.directory / REPORT, data + b"\n")
            self.report = report
            self._folder.remove(self._removals)
            for source, target in self._renames.items():
                self._folder.rename(source, target)
            if self._removals:  # a rename that is lost is done again: the report names the file
                self._folder.sync()
        self._removals, self._renames = [], {}

    def keep_pictures(
        self, total: NDArray[np.unsignedinteger], rendering: Rendering, details: PictureDetails
    ) -> dict[str, str]:
        """Write the picture files; the report names them first."""
        assert self.report is not None  # it was saved before the first frame
        self.report.files = picture_files(rendering)
        self.save_report(self.report)
        with self._folder.storage_errors():
            self._folder.sync()  # nobody recovers the files of a complete capture
        write_picture_files(total, rendering, details, self.directory)
        return picture_files(rendering)

    def after_failure(self, done: int, count: int) -> AfterFailure:
        """Say how many frames are kept, and how to continue."""
        if not (self.directory / REPORT).exists():
            gone = f"{self.directory} was removed meanwhile, and the frames with it"
            return AfterFailure(gone, "shoot again")
        if self.report is not None and not self.report.repeatable:
            return AfterFailure(
                "the photographs are as they were", "merge them again", {"overwrite": True}
            )
        hint = "shoot the others" if done < count else "make the picture of them"
        source = {} if self.report is None else self.report.source
        remedies = {"resume": resumption(self.directory, source)}
        return AfterFailure(f"{done} of {count} frames are kept", hint, remedies)

    def frame(self, position: int) -> Pixels:
        """Read the samples of a frame, and compare its checksum with the one in the report.

        Until the capture is complete the frames that this process wrote are trusted.
        """
        name, record = frame_file(position), self._record(position)
        is_trusted = position in self._kept and not isinstance(self.report, CaptureReport)
        checksum = None if record is None or is_trusted else record.sha256
        return self._read(name, lambda: self._folder.samples(name, checksum))

    def rows(self, position: int, part: slice) -> Pixels:
        name = frame_file(position)
        return self._read(name, lambda: self._folder.rows(name, part))

    def _read(self, name: str, read: Callable[[], Pixels]) -> Pixels:
        hint = "shoot the capture again"
        if not isinstance(self.report, CaptureReport):
            hint = "move it away, and resume: it is shot again"
        path = self.directory / name
        try:
            self._folder.check_frames_folder()
            return read()
        except (OSError, ValueError, DataError, StorageError) as error:
            what = f"{path} cannot be read: {error}"
            cause: BaseException | None = error
            if isinstance(error, DataError | StorageError):
                what, cause = error.what, error.__cause__
            if isinstance(cause, OSError) and cause.errno != errno.ENOENT:  # the frame is there
                hint = advice(cause.errno) or hint
            raise DataError(what, hint=hint) from error

    def picture(self, kind: str) -> NDArray[Any]:
        name, read = _READERS[kind]
        return read(self.directory / name)

    def _record(self, position: int) -> StoredFrame | None:
        return None if self.report is None else self.report.frames[position]

    def _recover(self, report: UnfinishedCapture) -> None:
        """Do what the report says and a killed process did not."""
        folder, named = self._folder, named_files(report)
        aside = {  # by the names that these files have until they are renamed
            name.partition("-rejected-")[0] + Path(name).suffix: name
            for name in report.rejected
            if not folder.is_file(name)
        }
        folder.check_claims(named | aside.keys())
        make_folder(folder.frames)
        self._removals = report.discarded
        for source, name in aside.items():
            # A file beside one that has its name is of the next attempt, and not in the report.
            for before in (source, staged_name(source)):
                if source not in named and folder.is_file(before):
                    self._renames[before] = name
                    break
        for position, record in enumerate(report.frames):
            if record is None:
                continue
            has_original = record.original is not None and folder.finish_rename(
                record.original, record.original_sha256
            )
            if record.file is None or not folder.finish_rename(record.file, record.sha256):
                if has_original:
                    report.rejected += self.reject(position)
                report.frames[position] = None
            elif record.original is not None and not has_original:
                text = f"{record.original}, the camera's own file, is missing"
                report.findings.append(note(text))
                record.original = record.original_sha256 = None
        if self._renames or self._removals:
            self.save_report(report)
        folder.remove_leftovers()
        folder.sync()


def read_capture(directory: str | os.PathLike[str]) -> CaptureReport | UnfinishedCapture:
    """Read the report of a capture in a folder, complete or not.

    Raises:
        DataError: there is none, it is damaged, or it is of another version
    """
    directory = Path(directory)
    report = read_report_file(directory)
    if isinstance(report, CaptureReport):
        report.with_pictures(FolderStore(directory, report))
    return report


def read_report(directory: str | os.PathLike[str]) -> CaptureReport:
    """Read the report of a complete capture; its pictures are read when they are asked for.

    Raises:
        DataError: the folder holds no complete capture, or its report is damaged
    """
    report = read_capture(directory)
    if isinstance(report, UnfinishedCapture):
        raise DataError(
            f"{directory} holds an incomplete capture",
            hint="shoot its other frames",
            remedies={"resume": directory},
        )
    return report
