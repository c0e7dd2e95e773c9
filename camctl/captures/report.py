"""What a capture says of itself: the content of ``report.json``."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from camctl.camera import CameraInfo
from camctl.captures.request import CapturePlan, CaptureRequest
from camctl.controls import ExposureSetting, Layout
from camctl.errors import DataError
from camctl.files import storage_error, write_bytes

REPORT = "report.json"


class _Record(BaseModel):
    model_config = ConfigDict(extra="forbid")


class RatioCheck(_Record):
    """How a frame's exposure compares with its neighbour's, on pixels unsaturated in both.

    Attributes:
        expected: ratio of the applied exposures
        measured: ratio of the irradiances in the pixels; None: too few pixels to tell
        tolerance: relative difference up to which the two agree
        agrees: False where they do not
        moved: share of the pixels that changed by more than noise and rounding explain
    """

    expected: float
    measured: float | None
    tolerance: float
    agrees: bool
    moved: float


class FrameRecord(_Record):
    """One frame of the sum; times in s, brightness in DN, `exposure` relative to the smallest."""

    file: str
    original: str | None = None
    requested: ExposureSetting
    applied: ExposureSetting
    requested_s: float
    applied_s: float
    exposure: float
    black: int
    white: int
    saturated_fraction: float
    timestamp_s: float
    ratio: RatioCheck | None = None
    attempts: int = 1
    details: dict[str, Any] = {}


class Achieved(_Record):
    """What the applied exposures give, and how much of the picture lies outside them."""

    xi: float
    effective_levels: float
    levels: int
    levels_distinct: int
    saturated_fraction: float
    dark_fraction: float


class Irradiance(_Record):
    """How `radiance.exr` is scaled: its values are E / `full_scale_exposure`, with E = 1 at white.

    `unit` says whether that is the scene's own unit (the camera's sensitivity is known) or full
    scales a second.
    """

    unit: str
    full_scale_exposure: float


class CaptureReport(_Record):
    """All that is known of a capture; kept in its folder from the first frame on."""

    status: Literal["incomplete", "complete"]
    camera: CameraInfo
    source: dict[str, Any]
    layout: Layout
    request: CaptureRequest
    plan: CapturePlan
    frames: list[FrameRecord | None]
    rejected: list[str] = []
    white: int
    black_total: int
    achieved: Achieved | None = None
    irradiance: Irradiance | None = None
    timing: dict[str, float] = {}
    files: dict[str, str] = {}
    warnings: list[str] = []
    versions: dict[str, str] = {}

    def write(self, directory: Path) -> None:
        """Write the report into the folder of its capture, whole."""
        write_bytes(directory / REPORT, self.model_dump_json(indent=2).encode() + b"\n")


def read_report(directory: Path) -> CaptureReport:
    """Read the report of a capture.

    Raises:
        DataError: there is none, or it is damaged

    """
    path = directory / REPORT
    try:
        return CaptureReport.model_validate_json(path.read_bytes())
    except FileNotFoundError as error:
        raise DataError(
            f"{directory} holds no capture: {REPORT} is missing",
            hint="name the folder of a capture",
        ) from error
    except OSError as error:
        raise storage_error(path, error) from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or "the file"
        raise DataError(
            f"{path} is damaged at {where}: {first['msg']}",
            hint="its frames are still in frames/; shoot again into another folder",
        ) from error
