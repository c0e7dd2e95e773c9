"""What is known of a capture: the content of ``report.json``, and the pictures beside it."""

from __future__ import annotations

from typing import Any, Literal, Protocol, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, PrivateAttr

from camctl.camera import CameraInfo, Pixels
from camctl.captures.request import CapturePlan, CaptureRequest
from camctl.controls import ExposureSetting, Layout
from camctl.errors import DataError, UsageError


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid")


class RatioCheck(_Model):
    """A frame's exposure compared with its neighbour's, on pixels unsaturated in both.

    Attributes:
        expected: ratio of the applied exposures
        measured: ratio of the irradiances in the pixels; None: too few pixels to measure it
        tolerance: relative difference up to which the two agree
        agrees: False where they do not
        moved: share of the pixels that changed by more than noise and rounding explain
    """

    expected: float
    measured: float | None
    tolerance: float
    agrees: bool
    moved: float


class StoredFrame(_Model):
    """One frame of a capture.

    Attributes:
        file: its samples in the capture's folder; None for a capture in memory
        original: the camera's own file there, where it made one
        requested: the setting that was asked for
        applied: the setting read back from the camera
        requested_s: shutter time of `requested`, s
        applied_s: shutter time of `applied`, s
        black: brightness without light, DN
        white: brightness from which samples are saturated, DN
        saturated_fraction: share of its samples at or above white
        timestamp_s: when the exposure ended, on the camera's clock, s
        ratio: its exposure compared with that of the frame before
        attempts: 2 where it was shot again because its exposure did not agree
        details: what the camera reported besides
    """

    model_config = ConfigDict(extra="ignore")  # captures begun by other versions can be resumed

    file: str | None = None
    original: str | None = None
    requested: ExposureSetting
    applied: ExposureSetting
    requested_s: float
    applied_s: float
    black: int
    white: int
    saturated_fraction: float
    timestamp_s: float
    ratio: RatioCheck | None = None
    attempts: int = 1
    details: dict[str, Any] = {}


class FrameRecord(StoredFrame):
    """One frame of a complete capture.

    Attributes:
        exposure: applied exposure, relative to the smallest applied one of the capture
    """

    model_config = ConfigDict(extra="forbid")

    exposure: float


class Achieved(_Model):
    """The quality that the applied exposures give, and how much of the picture is out of range.

    Attributes:
        xi: number of desired levels that are missing
        effective_levels: number of equal steps in the desired response that would be as accurate
        levels: number of levels of the sum
        levels_distinct: number of them that differ
        saturated_fraction: share of the samples that are saturated in every frame
        dark_fraction: share of the samples that no frame reached
    """

    xi: float
    effective_levels: float
    levels: int
    levels_distinct: int
    saturated_fraction: float
    dark_fraction: float


class Irradiance(_Model):
    """Scale of the radiance: its values are E / `full_scale_exposure`, with E = 1 at full scale.

    `unit` is the scene's own unit where the camera's sensitivity is known, else full scales per
    second.
    """

    unit: str
    full_scale_exposure: float


class _CaptureData(_Model):
    """What every capture has, complete or not.

    Attributes:
        camera: identity of the camera
        source: what is needed to open the camera again
        layout: pixel layout of the frames
        request: what was asked for
        plan: the plan that is followed
        rejected: files of frames that were shot again
        white: brightness at which each frame is clipped before it is summed, DN
        black_total: black level of the sum, DN
        timing: durations of the stages, s
        warnings: what to know of the pictures, one line each
        versions: of camctl, numpy and Python
    """

    camera: CameraInfo
    source: dict[str, Any]
    layout: Layout
    request: CaptureRequest
    plan: CapturePlan
    rejected: list[str] = []
    white: int
    black_total: int
    timing: dict[str, float] = {}
    warnings: list[str] = []
    versions: dict[str, str] = {}


class UnfinishedCapture(_CaptureData):
    """A capture that lacks frames, None in `frames`, or its pictures."""

    model_config = ConfigDict(extra="ignore")

    status: Literal["incomplete"] = "incomplete"
    frames: list[StoredFrame | None]


class Pictures(Protocol):
    """The arrays of a complete capture; see the methods of `CaptureReport`."""

    def frame(self, position: int) -> Pixels:
        """Return the samples of a frame."""
        ...

    def sum(self) -> NDArray[np.unsignedinteger]:
        """Return the sum of the frames."""
        ...

    def image(self) -> NDArray[np.uint16]:
        """Return the image in the desired response."""
        ...

    def radiance(self) -> NDArray[np.float32]:
        """Return the irradiance."""
        ...

    def mask(self) -> NDArray[np.uint8]:
        """Return the marks of what is out of range."""
        ...


class CaptureReport(_CaptureData):
    """A complete capture: what was planned, shot and achieved, and its pictures.

    Attributes:
        frames: the frames of the sum, in the order of the plan's settings
        achieved: the quality that the applied exposures give
        irradiance: scale of the radiance
        files: names of the result files by kind; empty for a capture in memory
    """

    status: Literal["complete"] = "complete"
    frames: list[FrameRecord]
    achieved: Achieved
    irradiance: Irradiance
    files: dict[str, str] = {}
    _pictures: Pictures | None = PrivateAttr(default=None)

    def with_pictures(self, pictures: Pictures) -> Self:
        """Return the report itself, connected to its pictures."""
        self._pictures = pictures
        return self

    def radiance(self) -> NDArray[np.float32]:
        """Return irradiance, float32, (rows, columns) or (rows, columns, 3) for R, G, B.

        It is in the unit of `irradiance`; what is out of range is clamped, see `mask`.

        Raises:
            DataError: the capture's file is missing or damaged
        """
        return self._connected().radiance()

    def mask(self) -> NDArray[np.uint8]:
        """Return 0 for good samples, 1 too dark, 2 saturated in every frame; radiance's shape.

        Raises:
            DataError: the capture's file is missing or damaged
        """
        return self._connected().mask()

    def image(self) -> NDArray[np.uint16]:
        """Return the image in the desired response, 0 to 65,535, in the shape of the radiance.

        Raises:
            DataError: the capture's file is missing or damaged
        """
        return self._connected().image()

    def sum(self) -> NDArray[np.unsignedinteger]:
        """Return the exact sum of the frames clipped at white, black included, a frame's shape.

        Raises:
            DataError: the capture's file is missing or damaged
        """
        return self._connected().sum()

    def frame(self, position: int) -> Pixels:
        """Return the samples of frame `position`, 0 first, as the camera returned them.

        Raises:
            UsageError: there is no frame at `position`
            DataError: the capture's file is missing or damaged
        """
        if not 0 <= position < len(self.frames):
            raise UsageError(
                f"invalid frame position {position}: expected 0 to {len(self.frames) - 1}"
            )
        return self._connected().frame(position)

    def _connected(self) -> Pictures:
        if self._pictures is None:
            raise DataError(
                "this report has no pictures: it was not read from a capture's folder",
                hint="read the folder with camctl.read_report",
            )
        return self._pictures
