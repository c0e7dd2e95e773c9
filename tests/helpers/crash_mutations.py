"""Broken orders of the writes, each of which a sweep of crash points must notice."""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from camctl.captures import gallery
from camctl.exposure import build, table
from camctl.menu import settings_file
from camctl.profiles import profile
from camctl.records import folder, folder_store, journal
from camctl.records.folder import CaptureFolder
from camctl.records.folder_store import FolderStore
from camctl.system import files

#: Modules that write files, which have names of `camctl.system.files` of their own.
_WRITERS = (files, folder, folder_store, journal, profile, settings_file, gallery, table, build)


@dataclass(frozen=True)
class Mutation:
    """One broken order: a scenario that must notice it, and what breaks it in this process."""

    scenario: str
    apply: Callable[[], None]


def _replace(name: str, new: Any) -> None:
    """Replace a function of `camctl.system.files` wherever it was imported."""
    for module in _WRITERS:
        if hasattr(module, name):
            setattr(module, name, new)


_sync = os.fsync


def _sync_nothing() -> None:
    vars(os)["fsync"] = lambda _: None


def _sync_no_file() -> None:
    def sync(descriptor: int) -> None:
        if stat.S_ISDIR(os.fstat(descriptor).st_mode):
            _sync(descriptor)

    vars(os)["fsync"] = sync


def _sync_no_folder() -> None:
    _replace("sync_folder", lambda _: None)


def _write_in_place() -> None:
    @contextmanager
    def atomic_file(path: Path) -> Iterator[Path]:
        yield path
        with path.open("r+b") as written:
            _sync(written.fileno())
        files.sync_folder(path.parent)

    def write_bytes(path: Path, data: bytes) -> None:
        with atomic_file(path) as whole:
            whole.write_bytes(data)

    _replace("atomic_file", atomic_file)
    _replace("write_bytes", write_bytes)


def _replace_before_sync() -> None:
    """The new file has its name before its content is on disk."""

    @contextmanager
    def atomic_file(path: Path) -> Iterator[Path]:
        part = path.with_name(f".{path.name}.{os.getpid()}.part")
        yield part
        part.replace(path)
        files.sync_folder(path.parent)
        with path.open("r+b") as written:
            _sync(written.fileno())

    def write_bytes(path: Path, data: bytes) -> None:
        with atomic_file(path) as part:
            part.write_bytes(data)

    _replace("write_bytes", write_bytes)


def _remove_before_write() -> None:
    """The old file is removed, and then the new one written."""
    write = files.write_bytes

    def write_bytes(path: Path, data: bytes) -> None:
        path.unlink(missing_ok=True)
        files.sync_folder(path.parent)
        write(path, data)

    _replace("write_bytes", write_bytes)


def _stage_without_sync() -> None:
    def write_new(path: Path, parts: Any) -> str:
        data = b"".join(bytes(part) for part in parts)
        path.write_bytes(data)
        return hashlib.sha256(data).hexdigest()

    _replace("write_new", write_new)


def _stage_without_name() -> None:
    """The content of a staged frame is on disk, its hidden name is not."""
    names, stage = vars(folder), CaptureFolder.stage

    def unsynced(self: CaptureFolder, name: str, parts: Any) -> tuple[str, str]:
        names["sync_folder"] = lambda _: None
        try:
            return stage(self, name, parts)
        finally:
            names["sync_folder"] = files.sync_folder

    CaptureFolder.stage = unsynced  # type: ignore[method-assign]


def _rename_before_report() -> None:
    save = FolderStore.save_report

    def renamed_first(self: FolderStore, report: Any) -> None:
        for source, target in self._renames.items():
            self._folder.rename(source, target)
        self._renames = {}
        save(self, report)

    FolderStore.save_report = renamed_first  # type: ignore[method-assign]


def _remove_before_report() -> None:
    save = FolderStore.save_report

    def removed_first(self: FolderStore, report: Any) -> None:
        self._folder.remove(self._removals)
        save(self, report)

    FolderStore.save_report = removed_first  # type: ignore[method-assign]


def _report_before_frame() -> None:
    """The frame is written once the report that names it is saved."""
    save, stage = FolderStore.save_report, CaptureFolder.stage
    waiting: list[tuple[CaptureFolder, str, list[bytes]]] = []

    def stage_later(self: CaptureFolder, name: str, parts: Any) -> tuple[str, str]:
        whole = [bytes(part) for part in parts]
        waiting.append((self, name, whole))
        return folder.staged_name(name), hashlib.sha256(b"".join(whole)).hexdigest()

    def save_first(self: FolderStore, report: Any) -> None:
        renames, self._renames = self._renames, {}
        save(self, report)
        while waiting:
            stage(*waiting.pop(0))
        for source, target in renames.items():
            self._folder.rename(source, target)

    CaptureFolder.stage = stage_later  # type: ignore[method-assign]
    FolderStore.save_report = save_first  # type: ignore[method-assign]


def _pictures_before_report() -> None:
    """A complete report is saved without a look at the renames of frames before."""
    CaptureFolder.sync = lambda self: None  # type: ignore[method-assign]


def _folders_without_sync() -> None:
    def make_folder(path: Path) -> list[Path]:
        path.mkdir(parents=True, exist_ok=True)
        return []

    _replace("make_folder", make_folder)


def _late_report() -> None:
    """Every second report is left out, though it is acknowledged."""
    save, calls = FolderStore.save_report, [0]

    def every_second(self: FolderStore, report: Any) -> None:
        calls[0] += 1
        if calls[0] % 2:
            save(self, report)

    FolderStore.save_report = every_second  # type: ignore[method-assign]


def _discard_rows_first() -> None:
    save = table.ExposureTable.save

    def discard_first(self: Any, path: Any) -> None:
        for row in path.with_name(f"{path.name}.parts").iterdir():
            row.unlink()
        save(self, path)

    table.ExposureTable.save = discard_first  # type: ignore[method-assign]


def _remove_without_sync() -> None:
    vars(build)["sync_folder"] = lambda _: None


MUTATIONS = {
    "nothing is synchronised": Mutation("fresh", _sync_nothing),
    "no file is synchronised": Mutation("fresh", _sync_no_file),
    "no folder is synchronised": Mutation("fresh", _sync_no_folder),
    "a staged frame is not synchronised": Mutation("fresh", _stage_without_sync),
    "the name of a staged frame is not synchronised": Mutation("fresh", _stage_without_name),
    "renames and removals are not synchronised": Mutation("fresh", _pictures_before_report),
    "new folders are not synchronised": Mutation("fresh", _folders_without_sync),
    "frames are renamed before the report": Mutation("retry", _rename_before_report),
    "old files are removed before the report": Mutation("force", _remove_before_report),
    "removals are not synchronised": Mutation("table", _remove_without_sync),
    "the report is saved before the frame": Mutation("fresh", _report_before_frame),
    "every second report is left out": Mutation("fresh", _late_report),
    "the report is written in place": Mutation("fresh", _write_in_place),
    "a file is replaced before it is synchronised": Mutation("resume", _replace_before_sync),
    "the journal of a series is written in place": Mutation("series", _write_in_place),
    "the journal of a series is removed first": Mutation("series", _remove_before_write),
    "a profile is written in place": Mutation("profile", _write_in_place),
    "a profile is removed first": Mutation("profile", _remove_before_write),
    "the folder of profiles is not synchronised": Mutation("profile", _folders_without_sync),
    "settings are written in place": Mutation("settings", _write_in_place),
    "settings are not synchronised": Mutation("settings", _sync_no_file),
    "the folder of a table's rows is not synchronised": Mutation("table", _folders_without_sync),
    "rows are discarded before the table is saved": Mutation("table", _discard_rows_first),
    "a row of the cache is not synchronised": Mutation("row", _sync_no_file),
}
