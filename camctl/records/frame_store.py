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
        ...

    def reject(self, position: int) -> list[str]:
        """Set a frame aside that is not part of the sum; return the new names of its files."""
        ...

    def save_report(self, report: UnfinishedCapture | CaptureReport) -> None:
        """Keep the report in its present state, and carry out what it says of the frames."""
        ...

    def keep_pictures(
        self, total: NDArray[np.unsignedinteger], rendering: Rendering, details: PictureDetails
    ) -> dict[str, str]:
        """Keep the sum and the pictures rendered from it; return their file names by kind.

        `details` is what the files say of the capture.
        """
        ...

    def after_failure(self, done: int, count: int) -> AfterFailure:
        """Return what an error adds: how many frames are kept, and how to continue."""
        ...


@dataclass(frozen=True, eq=False)
class _Arrays:
    total: NDArray[np.unsignedinteger]
    code: NDArray[np.uint16]
    irradiance: NDArray[np.float32]
    deviation: NDArray[np.float32]
    mask: NDArray[np.uint8]


class MemoryStore:
    """A capture in memory: nothing is written to disk, and nothing survives a failure."""

    def __init__(self) -> None:
        self._frames: dict[int, Pixels] = {}
        self._arrays: _Arrays | None = None

    def keep(self, frame: Frame, position: int) -> KeptFiles:
        """Keep the samples of a frame."""
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
        arrays = _Arrays(
            total,
            np.empty(shape, np.uint16),
            np.empty(shape, np.float32),
            np.empty(shape, np.float32),
            np.empty(shape, np.uint8),
        )
        for render in rendering.strips(total):
            strip = render()
            rows = slice(row, row + strip.code.shape[0])
            arrays.code[rows] = strip.code
            arrays.irradiance[rows] = channels_together(strip.irradiance)
            arrays.deviation[rows] = channels_together(strip.deviation)
            arrays.mask[rows] = channels_together(strip.mask)
            row = rows.stop
        self._arrays = arrays
        return {}

    def after_failure(self, done: int, count: int) -> AfterFailure:
        """State that the frames are lost."""
        return AfterFailure(
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

    def standard_deviation(self) -> NDArray[np.float32]:
        """Return the standard deviation of the irradiance."""
        return self._complete().deviation

    def mask(self) -> NDArray[np.uint8]:
        """Return the marks of what is out of range."""
        return self._complete().mask

    def _complete(self) -> _Arrays:
        if self._arrays is None:
            raise DataError("the capture has no pictures yet", hint="capture all its frames first")
        return self._arrays
