"""Handing over: the results of a capture, and what it achieved."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from camctl.camera import ExposureControls
from camctl.capture.metering import GLINTS, NOTHING
from camctl.capture.pictures import Tables, shares, write_pictures, write_sum
from camctl.capture.plan import relative
from camctl.capture.report import Achieved, CaptureReport, Irradiance
from camctl.exposure.effective import EffectiveCamera, effective_levels
from camctl.exposure.objective import xi

#: A picture with more than this share of it saturated shows nothing.
_NOTHING_LEFT = 0.99


def hand_over(
    report: CaptureReport,
    total: NDArray[np.unsignedinteger],
    controls: ExposureControls,
    directory: Path,
) -> None:
    """Write the sum and the pictures into `directory`, and complete the report.

    The effective camera is that of the applied exposures, not of the wanted ones.

    Args:
        report: of a capture that has all its frames; changed in place and written
        total: sum of its frames, black included
        controls: of the camera
        directory: the capture's folder

    Raises:
        StorageError: a file could not be written

    """
    began = time.perf_counter()
    plan = report.plan
    records = [record for record in report.frames if record is not None]
    applied = [record.applied for record in records]
    exposures = relative(applied)
    for record, exposure in zip(records, exposures, strict=True):
        record.exposure = exposure
    effective = EffectiveCamera.of(controls.levels, exposures)
    desired = plan.desired
    full_scale_exposure = min(setting.exposure for setting in applied)
    if controls.sensitivity is not None:
        full_scale_exposure *= controls.sensitivity
    tables = Tables.of(effective, desired, report.black_total, full_scale_exposure)
    outside = shares(total, tables)
    report.achieved = Achieved(
        xi=xi(effective, desired, plan.levels_wanted),
        effective_levels=effective_levels(effective, desired),
        levels=effective.levels_total,
        levels_distinct=effective.levels_distinct,
        saturated_fraction=outside.saturated,
        dark_fraction=outside.dark,
    )
    report.warnings += _blind(total, report.black_total, controls.levels.M, outside.saturated)
    report.irradiance = Irradiance(
        unit="full scales per second" if controls.sensitivity is None else "as the scene",
        full_scale_exposure=full_scale_exposure,
    )
    write_sum(total, directory / "sum.tiff")
    write_pictures(total, controls.layout, tables, desired, full_scale_exposure, directory)
    report.files = {
        "sum": "sum.tiff",
        "image": "image.tiff",
        "radiance": "radiance.exr",
        "preview": "preview.png",
    }
    report.warnings = [*plan.warnings, *report.warnings]
    report.timing["writing_s"] = time.perf_counter() - began
    report.status = "complete"
    report.write(directory)


def _blind(
    total: NDArray[np.unsignedinteger], black_total: int, levels: int, saturated: float
) -> list[str]:
    """Return a line for a picture that holds no light, or nothing but too much of it.

    Read noise around a black level lights half of the samples: light is what rises above
    `metering.NOTHING` of one frame's levels.
    """
    lit = np.count_nonzero(total > black_total + NOTHING * levels) / total.size
    if lit <= GLINTS:
        return [
            "there is nothing to see: all is black in every exposure; take the lens cap off, or "
            "expose longer (--base)"
        ]
    if saturated > _NOTHING_LEFT:
        return [
            f"{saturated:.2%} of the picture is white in every exposure; expose shorter (--base), "
            f"close the aperture, or put a filter before the lens"
        ]
    return []
