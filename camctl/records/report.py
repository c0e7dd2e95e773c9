"""What is known of a capture: the content of ``report.json``, and the pictures beside it."""

from __future__ import annotations

from typing import Any, Literal, Protocol, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    AwareDatetime,
    ConfigDict,
    Field,
    PrivateAttr,
    computed_field,
    model_validator,
)

from camctl.errors import DataError, UsageError
from camctl.evidence.movement import FoundMovement
from camctl.evidence.ratio_check import ReportModel
from camctl.exposure.goal import CaptureRequest
from camctl.findings import Finding
from camctl.interface.camera import CameraInfo, Pixels
from camctl.interface.controls import Layout, ResponseOrigin
from camctl.messages.plain import sentence, sentences
from camctl.model.noise import MeasuredNoise, NoiseModel
from camctl.records.capture_plan import CapturePlan
from camctl.records.frame import FrameRecord, SimulationSummary, StoredFrame
from camctl.records.html import report_html

FORMAT_VERSION = 3
"""Version of report.json and of the folder's files."""


class Achieved(ReportModel):
    """The quality that the applied exposures give, and how much of the picture is out of range.

    Attributes:
        xi: number of desired levels that are missing
        effective_levels: number of equal steps in the desired response that would be as accurate,
            with the camera's noise where it is known
        effective_levels_noise_free: the same by quantisation alone
        noise: the noise of the camera; None where it is unknown
        measured: what the pixels show; None where too few are in range in two frames
        gain_over_sum: standard deviation of the light that the sum of the frames shows over that of
            the radiance, which is estimated from all frames: the median of the samples; None where
            the noise is not known
        levels: number of levels of the sum
        levels_distinct: number of them that differ
        saturated_fraction: share of the samples that are saturated in every frame
        dark_fraction: share of the samples with light below the desired range
        light_shares: shares of the samples in equal steps of ln E, from the range's lower end on
    """

    xi: float
    effective_levels: float
    effective_levels_noise_free: float | None = None
    noise: NoiseModel | None = None
    measured: MeasuredNoise | None = None
    gain_over_sum: float | None = None
    levels: int
    levels_distinct: int
    saturated_fraction: float
    dark_fraction: float
    light_shares: tuple[float, ...] = ()

    @property
    def levels_with_noise(self) -> float | None:
        """Effective levels with the noise that is known, else with the one that pixels show."""
        if self.noise is not None:
            return self.effective_levels
        return None if self.measured is None else self.measured.effective_levels


class Irradiance(ReportModel):
    """Scale of the radiance: its values are E / `full_scale_exposure`, with E = 1 at full scale.

    `unit` is the scene's own unit where the camera's sensitivity is known, else full scales per
    second.
    """

    unit: str
    full_scale_exposure: float


class _CaptureData(ReportModel):
    """What every capture has, complete or not.

    Attributes:
        format_version: version of the report's format
        camera: identity of the camera
        source: what is needed to open the camera again
        layout, pixel_format: of the frames, as in `camctl.ExposureControls`
        repeatable: whether its frames can be shot again, likewise
        response_origin: whether the response used is stated, measured or only assumed
        request: what was asked for
        plan: the plan that is followed
        rejected: files of frames that were shot again
        trustworthy: False where the frames contradict their exposures, so that the pictures are
            wrong
        untrustworthy_because: why, one line; else None
        white: brightness at which each frame is clipped before it is summed, DN
        black_total: black level of the sum, DN
        files: names of the picture files by kind, before they are written; none in memory
        timing: durations, s: "planning_s", "shooting_wall_s" and "writing_s" by this computer's
            clock; by the camera's clock "shooting_s", and from the request of the first frame
            until the last one arrived "planned_wall_s" (predicted) and "actual_wall_s"
        clock: "virtual" where the camera's clock is a simulated one, so that its times passed
            without waiting; else "real"
        findings: what to know of the pictures; `warnings` has them as plain sentences
        versions: of camctl, numpy and Python
        profile: what the camera's profile says of it, one line; None: nothing
        taken_at: when the capture began, by this computer's clock, in a simulated series by the
            simulated one
    """

    format_version: int = FORMAT_VERSION
    camera: CameraInfo
    source: dict[str, Any]
    layout: Layout
    pixel_format: str = ""
    repeatable: bool = True
    response_origin: ResponseOrigin
    request: CaptureRequest
    plan: CapturePlan
    rejected: list[str] = Field(default_factory=list)
    trustworthy: bool = True
    untrustworthy_because: str | None = None
    white: int
    black_total: int
    files: dict[str, str] = Field(default_factory=dict)
    timing: dict[str, float] = Field(default_factory=dict)
    clock: Literal["real", "virtual"] = "real"
    findings: list[Finding] = Field(default_factory=list)
    versions: dict[str, str] = Field(default_factory=dict)
    profile: str | None = None
    taken_at: AwareDatetime | None = None

    @computed_field  # type: ignore[prop-decorator]  # mypy does not know properties of pydantic
    @property
    def warnings(self) -> list[str]:
        """What to know of the pictures, one line each."""
        return [text for text, _ in sentences(self.findings)]

    @property
    def remarks(self) -> list[Finding]:
        """The findings without those for which the pictures are not trustworthy."""
        because = self.untrustworthy_because or ""
        return [finding for finding in self.findings if sentence(finding) not in because]

    def distrust(self, reasons: list[Finding]) -> None:
        """Add findings for which the pictures are not trustworthy."""
        self.findings += reasons
        if reasons:
            self.trustworthy = False
            self.untrustworthy_because = "; ".join(map(sentence, reasons))

    @model_validator(mode="before")
    @classmethod
    def _without_computed(cls, content: object) -> object:
        """Leave out what follows from the findings."""
        if not isinstance(content, dict):
            return content
        return {name: value for name, value in content.items() if name != "warnings"}


class UnfinishedCapture(_CaptureData):
    """A capture that lacks frames, None in `frames`, or its pictures.

    Attributes:
        frames: the frames of the sum, in the order of the plan's settings
        discarded: files of an earlier capture in the same folder that are removed
    """

    model_config = ConfigDict(extra="ignore")  # a complete capture has more fields

    status: Literal["incomplete"] = "incomplete"
    frames: list[StoredFrame | None]
    discarded: list[str] = Field(default_factory=list)


class Pictures(Protocol):
    """The arrays of a complete capture; see the methods of `CaptureReport`."""

    def frame(self, position: int) -> Pixels:
        """Return the samples of a frame."""

    def picture(self, kind: str) -> NDArray[Any]:
        """Return the "sum", the "image", the "radiance", its "deviation" or its "mask"."""


class CaptureReport(_CaptureData):
    """A complete capture: what was planned, shot and achieved, and its pictures.

    Attributes:
        frames: the frames of the sum, in the order of the plan's settings
        achieved: the quality that the applied exposures give
        irradiance: scale of the radiance
        movement: where the frames contradict each other; None for a single frame
        simulation: what the frames of a simulated camera lack; None of any other camera
    """

    status: Literal["complete"] = "complete"
    frames: list[FrameRecord]
    achieved: Achieved
    irradiance: Irradiance
    movement: FoundMovement | None = None
    simulation: SimulationSummary | None = None
    _pictures: Pictures | None = PrivateAttr(default=None)

    def _repr_html_(self) -> str:
        """Return the report for a notebook, with the image."""
        return report_html(self)

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
        return self._connected().picture("radiance")

    def standard_deviation(self) -> NDArray[np.float32]:
        """Return the predicted standard deviation of the radiance, float32, in its shape and unit.

        Quantisation and, where it is known, the noise of the camera are in it; it is infinite where
        every frame is saturated.

        Raises:
            DataError: the capture's file is missing or damaged
        """
        return self._connected().picture("deviation")

    def mask(self) -> NDArray[np.uint8]:
        """Return 0 for good samples, 1 below the range, 2 saturated, 4 frames contradict, 8 hot.

        In the shape of the radiance.  Of a mosaic it marks the pixels that a marked sample
        contributed to, more than the samples that the shares in the report count.

        Raises:
            DataError: the capture's file is missing or damaged
        """
        return self._connected().picture("mask")

    def image(self) -> NDArray[np.uint16]:
        """Return the image in the desired response, 0 to 65,535, in the shape of the radiance.

        Raises:
            DataError: the capture's file is missing or damaged
        """
        return self._connected().picture("image")

    def sum(self) -> NDArray[np.unsignedinteger]:
        """Return the exact sum of the frames clipped at white, black included, a frame's shape.

        Raises:
            DataError: the capture's file is missing or damaged
        """
        return self._connected().picture("sum")

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
