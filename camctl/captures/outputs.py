"""The last step of a capture: from the sum of its frames to its pictures and its report."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from camctl.captures.frame_store import CaptureStore
from camctl.captures.metering import BLACK_SHARE, OUTLIER_SHARE
from camctl.captures.pictures import Rendering, Tables, outside_shares
from camctl.captures.report import (
    Achieved,
    CaptureReport,
    FrameRecord,
    Irradiance,
    UnfinishedCapture,
)
from camctl.captures.request import relative_exposures
from camctl.controls import ExposureControls
from camctl.exposure.effective import EffectiveCamera
from camctl.exposure.objective import Objective, evaluate

#: A picture with more than this share of its samples saturated gets a warning.
_MOST_SATURATED = 0.99


def complete(
    unfinished: UnfinishedCapture,
    total: NDArray[np.unsignedinteger],
    controls: ExposureControls,
    store: CaptureStore,
) -> CaptureReport:
    """Render the pictures into `store`, save the report there, and return it.

    The effective camera is that of the applied exposures, not of the planned ones.

    Args:
        unfinished: a capture that has all its frames
        total: sum of its frames, black included
        controls: of the camera
        store: where the frames are

    Raises:
        StorageError: a file could not be written
    """
    began = time.perf_counter()
    plan = unfinished.plan
    frames = [frame for frame in unfinished.frames if frame is not None]
    applied = [frame.applied for frame in frames]
    exposures = relative_exposures(applied)
    effective = EffectiveCamera.of(controls.levels, exposures)
    desired = plan.desired
    full_scale_exposure = min(setting.exposure for setting in applied)
    if controls.sensitivity is not None:
        full_scale_exposure *= controls.sensitivity
    tables = Tables.of(effective, desired, unfinished.black_total, full_scale_exposure)
    outside = outside_shares(total, tables)
    quality = evaluate(controls.levels, desired, exposures, objective=Objective(plan.levels_wanted))
    no_light = _no_light(total, unfinished.black_total, controls.levels.M, outside.saturated)
    rendering = Rendering(controls.layout, tables, desired, full_scale_exposure)
    files = store.keep_pictures(total, rendering)
    begun = {name: getattr(unfinished, name) for name in type(unfinished).model_fields}
    report = CaptureReport.model_validate(
        begun
        | {
            "status": "complete",
            "frames": [
                FrameRecord.model_validate({**dict(frame), "exposure": exposure})
                for frame, exposure in zip(frames, exposures, strict=True)
            ],
            "achieved": Achieved(
                xi=quality.xi,
                effective_levels=quality.effective_levels,
                levels=quality.levels,
                levels_distinct=quality.levels_distinct,
                saturated_fraction=outside.saturated,
                dark_fraction=outside.dark,
            ),
            "irradiance": Irradiance(
                unit="full scales per second" if controls.sensitivity is None else "as the scene",
                full_scale_exposure=full_scale_exposure,
            ),
            "files": files,
            "warnings": [*plan.warnings, *unfinished.warnings, *no_light],
            "timing": {**unfinished.timing, "writing_s": time.perf_counter() - began},
        }
    )
    store.save_report(report)
    return report.with_pictures(store)


def _no_light(
    total: NDArray[np.unsignedinteger], black_total: int, levels: int, saturated: float
) -> list[str]:
    """Return a warning for a picture without light, or with nearly all of it saturated.

    Read noise around a black level lifts half of the samples above it: only those count as lit that
    are above it by `BLACK_SHARE` of one frame's levels.
    """
    lit = np.count_nonzero(total > black_total + BLACK_SHARE * levels) / total.size
    if lit <= OUTLIER_SHARE:
        return [
            "the picture is black in every exposure; take the lens cap off, or expose longer "
            "(--base)"
        ]
    if saturated > _MOST_SATURATED:
        return [
            f"{saturated:.2%} of the picture is white in every exposure; expose shorter (--base), "
            f"close the aperture, or put a filter before the lens"
        ]
    return []
