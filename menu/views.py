"""What the menu shows of the controller's cameras, plans, progress and reports."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from camctl.interface.camera import CameraInfo
from camctl.interface.controls import ExposureControls, ExposureSetting, Layout
from camctl.menu.data import CameraEntry, Plan, Progress, Summary
from camctl.menu.entries import TOGETHER
from camctl.menu.text import format_exact_time
from camctl.menu.thumbnails import preview_picture
from camctl.messages.menu import finding_text

if TYPE_CHECKING:  # the idle menu does not load what captures are made with
    from camctl.captures.sequence import Progress as CaptureProgress
    from camctl.exposure.goal import CaptureRequest
    from camctl.records.capture_plan import CapturePlan
    from camctl.records.report import CaptureReport

#: Bytes of the pictures of a capture for each sample of a frame: sum, image and radiance.
_PICTURE_BYTES = 40


def entry_of(*infos: CameraInfo) -> CameraEntry:
    """Return what a camera, or several that shoot together, are called."""
    return CameraEntry(
        TOGETHER.join(each.id for each in infos), TOGETHER.join(each.name for each in infos)
    )


def needed_bytes(plan: CapturePlan, controls: ExposureControls) -> int:
    """Return the space that a capture takes, without compression."""
    rows, columns = controls.shape
    samples = rows * columns * (3 if controls.layout is Layout.RGB else 1)
    frame_bytes = (1 if controls.bits <= 8 else 2) * len(plan.settings)
    return samples * frame_bytes + rows * columns * _PICTURE_BYTES


def plan_view(plan: CapturePlan, request: CaptureRequest) -> Plan:
    """Return what the menu shows of a plan."""
    texts = [setting_text(setting) for setting in plan.settings]
    return Plan(
        frames=tuple(zip(texts, plan.exposures, strict=True)),
        shutter_s=plan.shutter_s,
        wall_s=plan.wall_s,
        is_wall_known=plan.is_wall_known,
        effective_levels=plan.effective_levels,
        effective_levels_noise_free=plan.effective_levels_noise_free,
        noise_known=plan.noise is not None,
        xi=plan.xi,
        levels_wanted=plan.levels_wanted,
        dynamic_range=plan.dynamic_range,
        warnings=tuple(map(finding_text, plan.findings)),
        handle=(plan, request),
    )


def setting_text(setting: ExposureSetting) -> str:
    """Return the setting of a frame in words."""
    parts = [format_exact_time(setting.time_s)]
    if setting.gain != 1:
        parts.append(f"gain {setting.gain:.7g}")
    if setting.f_number is not None:
        parts.append(f"f/{setting.f_number:.7g}")
    return " ".join(parts)


def progress_view(progress: CaptureProgress) -> Progress:
    """Return how far a capture is."""
    return Progress(progress.done, progress.total, progress.stage, progress.share)


def summary_view(report: CaptureReport, folder: Path) -> Summary:
    """Return what the menu shows of a complete capture."""
    achieved = report.achieved
    is_comparable = (report.plan.noise is None) == (achieved.levels_with_noise is None)
    return Summary(
        effective_levels=achieved.levels_with_noise or achieved.effective_levels,
        effective_levels_noise_free=achieved.effective_levels_noise_free,
        noise_known=achieved.levels_with_noise is not None,
        planned_levels=report.plan.effective_levels if is_comparable else None,
        saturated=report.achieved.saturated_fraction,
        folder=str(folder),
        notes=tuple(map(finding_text, report.remarks)),
        untrustworthy_because=report.untrustworthy_because or "",
        histogram=tuple(report.achieved.light_shares),
        picture=preview_picture(folder),
    )
