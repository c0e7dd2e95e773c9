"""Where the frames and pictures of a capture are kept: the interface, and a capture in memory.

`camctl.records.folder_store` keeps a capture in a folder.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from camctl.errors import DataError
from camctl.interface.camera import Frame, Pixels
from camctl.pictures.details import PictureDetails
from camctl.pictures.render import Rendering
from camctl.records.report import CaptureReport, Pictures, UnfinishedCapture
from camctl.system.picture_operations import channels_together


@dataclass(frozen=True)
class KeptFiles:
    """The files of one frame; see the fields of `StoredFrame` of the same names."""

    file: str | None = None
    sha256: str | None = None
    original: str | None = None
    original_sha256: str | None = None


class AfterFailure(NamedTuple):
    """What an error adds where a capture fails.

    Attributes:
        kept: how many frames are kept
        hint: how to continue
        remedies: the same as data, see `camctl.findings.Finding.remedies`
    """

    kept: str
    hint: str
    remedies: Mapping[str, Any] = MappingProxyType({})


class CaptureStore(Pictures, Protocol):
    """Keeps what a capture produces, and returns it again.

    A frame counts as kept once a report that names it was saved after `keep`, and as rejected once
    a report was saved after `reject`.
    """

    def keep(self, frame: Frame, position: int) -> KeptFiles:
        """Keep a frame, and return its files for the report."""

    def reject(self, position: int) -> list[str]:
        """Set a frame aside that is not part of the sum; return the new names of its files."""

    def save_report(self, report: UnfinishedCapture | CaptureReport) -> None:
        """Keep the report in its present state, and carry out what it says of the frames."""

    def keep_pictures(
        self, total: NDArray[np.unsignedinteger], rendering: Rendering, details: PictureDetails
    ) -> dict[str, str]:
        """Keep the sum and the pictures rendered from it; return their file names by kind.

        `details` is what the files say of the capture.
        """

    def rows(self, position: int, part: slice) -> Pixels:
        """Return some rows of a frame; raises as `frame`, but does not compare checksums."""

    def after_failure(self, done: int, count: int) -> AfterFailure:
        """Return what an error adds: how many frames are kept, and how to continue."""


class MemoryStore:
    """A capture in memory: nothing is written to disk, and nothing survives a failure."""

    def __init__(self) -> None:
        self._frames: dict[int, Pixels] = {}
        self._pictures: dict[str, NDArray[Any]] = {}

    def keep(self, frame: Frame, position: int) -> KeptFiles:
        self._frames[position] = frame.pixels
        return KeptFiles()

    def reject(self, position: int) -> list[str]:
        """Drop the frame."""
        del self._frames[position]
        return []

    def save_report(self, report: UnfinishedCapture | CaptureReport) -> None:
        """Do nothing: the report is in memory."""

    def keep_pictures(
        self, total: NDArray[np.unsignedinteger], rendering: Rendering, details: PictureDetails
    ) -> dict[str, str]:
        """Keep the sum and render the pictures; `details` is for files only."""
        shape, row = rendering.picture_shape(total), 0
        code, mask = np.empty(shape, np.uint16), np.empty(shape, np.uint8)
        irradiance, deviation = np.empty(shape, np.float32), np.empty(shape, np.float32)
        for render in rendering.strips(total):
            strip = render()
            rows = slice(row, row + strip.code.shape[0])
            code[rows] = strip.code
            irradiance[rows] = channels_together(strip.irradiance)
            deviation[rows] = channels_together(strip.deviation)
            mask[rows] = channels_together(strip.mask)
            row = rows.stop
        self._pictures = {"sum": total, "image": code, "radiance": irradiance}
        self._pictures |= {"deviation": deviation, "mask": mask}
        return {}

    def after_failure(self, done: int, count: int) -> AfterFailure:
        """State that the frames are lost."""
        return AfterFailure(
            f"{done} of {count} frames were taken and are lost",
            "capture again, into a folder to keep the frames",
        )

    def frame(self, position: int) -> Pixels:
        return self._frames[position]

    def rows(self, position: int, part: slice) -> Pixels:
        return self._frames[position][part]

    def picture(self, kind: str) -> NDArray[Any]:
        if not self._pictures:
            raise DataError("the capture has no pictures yet", hint="capture all its frames first")
        return self._pictures[kind]
