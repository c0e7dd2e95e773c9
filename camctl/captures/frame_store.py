"""Where a capture lands: a folder that keeps every frame from the moment it came."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from camctl.camera import Frame, Pixels
from camctl.captures.report import REPORT
from camctl.errors import DataError, StorageError
from camctl.files import storage_error, write_array, write_bytes

FRAMES = "frames"
RESULTS = ("sum.tiff", "image.tiff", "radiance.exr", "preview.png")


class FrameStore:
    """The folder of one capture."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory

    @classmethod
    def check_free(cls, directory: Path, *, overwrite: bool = False) -> None:
        """Say before anything is shot whether `directory` can take a capture.

        An earlier capture there may be replaced only if `overwrite` says so; what is nobody's
        capture is never touched.

        Raises:
            StorageError: something is there already, or it cannot be looked at

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
    def create(cls, directory: Path, *, overwrite: bool = False) -> FrameStore:
        """Make the folder, without what an earlier capture left there.

        Raises:
            StorageError: as `check_free`, or the folder cannot be made

        """
        cls.check_free(directory, overwrite=overwrite)
        try:
            for name in (REPORT, *RESULTS):
                (directory / name).unlink(missing_ok=True)
            frames = directory / FRAMES
            if frames.exists():
                for old in frames.iterdir():
                    old.unlink()
            frames.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise storage_error(directory, error) from error
        return cls(directory)

    def keep(self, frame: Frame, position: int) -> tuple[str, str | None]:
        """Write a frame; return the names of its samples and of the camera's own file, if any."""
        stem = f"{FRAMES}/frame-{position + 1:02d}"
        original = None
        if frame.original is not None:
            original = f"{stem}{frame.original.suffix}"
            write_bytes(self.directory / original, frame.original.data)
        write_array(self.directory / f"{stem}.npy", frame.pixels)
        return f"{stem}.npy", original

    def reject(self, name: str) -> str:
        """Set a frame aside under another name, which is returned."""
        path = self.directory / name
        for number in range(1, 100):
            aside = path.with_name(f"{path.stem}-rejected-{number}{path.suffix}")
            if not aside.exists():
                break
        try:
            path.rename(aside)
        except OSError as error:
            raise storage_error(path, error) from error
        return f"{FRAMES}/{aside.name}"

    def read(self, name: str) -> Pixels:
        """Return the samples of a frame that was kept.

        Raises:
            DataError: the file is missing or damaged

        """
        path = self.directory / name
        try:
            pixels: Pixels = np.load(path, allow_pickle=False)
        except (OSError, ValueError, EOFError) as error:
            raise DataError(
                f"{path} cannot be read: {error}", hint="remove it, and resume: it is shot again"
            ) from error
        if pixels.dtype not in (np.uint8, np.uint16):
            raise DataError(
                f"{path} holds {pixels.dtype}, not frames", hint="remove it, and resume"
            )
        return pixels
