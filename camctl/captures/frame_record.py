"""What is known of one frame of a capture: its part of ``report.json``."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from camctl.controls import ExposureSetting

_Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class ReportModel(BaseModel):
    """A part of a report, which has no unknown fields."""

    model_config = ConfigDict(extra="forbid")


#: Share of the compared samples that may have changed by another ratio than most, for a wrong
#: exposure; with more, only parts of the picture disagree.
_MOST_MOVED = 0.5

#: A thing that covers less of a frame's samples is small.
_SMALL_THING = 0.02

#: Share of a frame's samples that must be compared before its exposure counts as contradicted.
LEAST_COMPARED = 0.1


class RatioCheck(ReportModel):
    """A frame's exposure compared with its neighbour's, on pixels unsaturated in both.

    Attributes:
        expected: ratio of the applied exposures
        measured: ratio of the irradiances in the pixels; None: too few pixels to measure it
        tolerance: relative difference up to which the two agree
        agrees: False where they do not
        moved: share of the compared samples that changed by another ratio than most
        compared: share of the frame's samples that were compared
        contradicting: share of them that contradict `expected`, all brighter or all darker
        contradicts: whether most of many samples contradict it, by more than lamps can or by more
            than 10 %
        lamps: factor by which lamps that flicker may change the ratio
    """

    expected: float
    measured: float | None
    tolerance: float
    agrees: bool
    moved: float
    compared: float = 0.0
    contradicting: float = 0.0
    contradicts: bool = False
    lamps: float = 1.0

    @property
    def factor(self) -> float:
        """Factor between measured and expected ratio, at least 1; infinite where not measured."""
        if self.measured is None:
            return math.inf
        return max(self.measured / self.expected, self.expected / self.measured)

    @property
    def is_certain(self) -> bool:
        """Whether enough samples were compared."""
        return self.compared >= LEAST_COMPARED

    @property
    def is_one_ratio(self) -> bool:
        """Whether most of what was compared changed by one ratio, and it is not a small thing."""
        return self.moved <= _MOST_MOVED and self.compared >= _SMALL_THING

    @property
    def is_of_whole_picture(self) -> bool:
        """Whether the exposures disagree, and not things that moved or light that spread.

        Then many samples were compared, and most of them changed by one ratio.
        """
        return not self.agrees and self.is_certain and self.is_one_ratio


class ExposureRatio(ReportModel):
    """A frame's exposure relative to the smallest one of the capture, and where it comes from.

    Attributes:
        exposure: with which the pictures are computed
        used: which one that is: the camera's statement, its profile's, or the estimate
        label: as the camera states it
        profile: as the camera's profile corrects it; None where it has no correction
        estimate: from the pixels; None where it was not estimated
        low: lower end of the 95 % confidence interval of the estimate, else of the profile's
        high: upper end
    """

    exposure: float
    used: Literal["label", "profile", "estimate"]
    label: float
    profile: float | None = None
    estimate: float | None = None
    low: float | None = None
    high: float | None = None


class StoredFrame(ReportModel):
    """One frame of a capture.

    Attributes:
        file: its samples in the capture's folder; None for a capture in memory
        sha256: checksum of that file, in hexadecimal
        original: the camera's own file there, where it made one
        original_sha256: checksum of that file
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

    model_config = ConfigDict(extra="ignore")  # a frame of a complete capture has more fields

    file: str | None = None
    sha256: _Sha256 | None = None
    original: str | None = None
    original_sha256: _Sha256 | None = None
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
        exposure: that the pictures are computed with, relative to the smallest of the capture
        exposure_ratio: where it comes from; None in reports of earlier versions
    """

    model_config = ConfigDict(extra="forbid")

    exposure: float
    exposure_ratio: ExposureRatio | None = None
