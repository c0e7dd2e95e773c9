"""The folder, the progress bar and the summary of a capture."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from camctl.cli.output import (
    format_duration,
    format_fields,
    format_number,
    format_percent,
    format_request,
    format_table,
    progress_bar,
)

if TYPE_CHECKING:
    from camctl.captures.report import CaptureReport
    from camctl.captures.sequencer import Progress

TIMES = {"planning_s": "planning", "shooting_s": "shooting", "writing_s": "writing"}
"""Keys of `CaptureReport.timing` that the summary shows, and their labels."""


def new_directory(parent: Path = Path()) -> Path:
    """Return the path of a folder in `parent` that does not exist, named by date and time."""
    stem = f"capture-{datetime.now():%Y%m%d-%H%M%S}"
    names = (stem if number == 1 else f"{stem}-{number}" for number in range(1, 1000))
    return next(parent / name for name in names if not (parent / name).exists())


@contextmanager
def capture_progress() -> Iterator[Callable[[Progress], None] | None]:
    """Show the progress of a capture while the block runs; yield None without a terminal."""
    with progress_bar("opening") as bar:
        if bar is None:
            yield None
            return
        show = bar
        yield lambda progress: show(progress.share, progress.stage)


def capture_text(report: CaptureReport, directory: Path) -> str:
    """Return the summary of a capture: its plan, its frames, its quality and its files."""
    plan = report.plan
    rows = [
        ("camera", f"{report.camera.make} {report.camera.model} ({report.camera.id})"),
        ("desired", format_request(plan.desired.name, plan.dynamic_range, len(plan.settings))),
        ("shortest exposure", f"{format_duration(plan.base_s)}, {_metering_text(report)}"),
    ]
    parts = [format_fields(rows), "", _frames_text(report), ""]
    achieved = report.achieved
    rows = [
        (
            "effective levels",
            f"{format_number(achieved.effective_levels, 4)} "
            f"(planned {format_number(plan.effective_levels, 4)})",
        ),
        (
            "missing levels (xi)",
            f"{format_number(achieved.xi, 5)} of {format_number(plan.levels_wanted)}",
        ),
        (
            "pixels without data",
            f"{format_percent(achieved.saturated_fraction)} saturated in every frame, "
            f"{format_percent(achieved.dark_fraction)} too dark in every frame",
        ),
        ("time", _timing_text(report)),
        ("result", str(directory)),
        *(("", name) for name in [*report.files.values(), "report.json", "frames/"]),
    ]
    return "\n".join([*parts, format_fields(rows)])


def _timing_text(report: CaptureReport) -> str:
    return ", ".join(
        f"{label} {format_duration(report.timing[key])}"
        for key, label in TIMES.items()
        if key in report.timing
    )


def _metering_text(report: CaptureReport) -> str:
    metering = report.plan.metering
    if metering is None:
        return "as given"
    frames = "1 frame" if metering.frames == 1 else f"{metering.frames} frames"
    return (
        f"metered in {frames}: at {format_duration(metering.setting.time_s)} highlights reach "
        f"{format_percent(metering.highlight)} of full scale, "
        f"{format_percent(metering.clipped)} are saturated"
    )


def _frames_text(report: CaptureReport) -> str:
    headings = ("exposure", "planned", "time", "gain", "saturated")
    frames = sorted(report.frames, key=lambda frame: frame.exposure)
    rows = [
        (
            format_number(frame.exposure),
            format_number(ratio),
            format_duration(frame.applied_s),
            format_number(frame.applied.gain, 4),
            format_percent(frame.saturated_fraction),
        )
        for frame, ratio in zip(frames, sorted(report.plan.ratios), strict=False)
    ]
    return format_table(headings, rows, right_aligned=range(len(headings)))
