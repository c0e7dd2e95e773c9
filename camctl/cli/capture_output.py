"""How a finished capture is told to a person."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from camctl.cli.output import duration, fields, number, range_name, table

if TYPE_CHECKING:
    from camctl.captures.report import CaptureReport


def percent(share: float) -> str:
    """Return a share as per cent; a little is never called nothing."""
    if 0 < share < 0.0001:
        return "< 0.01 %"
    return f"{share * 100:.2f} %" if share < 0.1 else f"{share * 100:.1f} %"


def capture_lines(report: CaptureReport, directory: Path) -> str:
    """Return what was planned, what was shot, how good it is, and where it is."""
    plan = report.plan
    rows = [
        ("camera", f"{report.camera.make} {report.camera.model} ({report.camera.id})"),
        (
            "wanted",
            f"{plan.response}, {range_name(plan.dynamic_range)}, in {len(plan.settings)} exposures",
        ),
        ("shortest exposure", f"{duration(plan.base_s)}, {_metered(report)}"),
    ]
    parts = [fields(rows), "", _frames(report), ""]
    rows = []
    if report.achieved is not None:
        achieved = report.achieved
        rows += [
            (
                "effective levels",
                f"{number(achieved.effective_levels, 4)} "
                f"(planned {number(plan.effective_levels, 4)})",
            ),
            (
                "wanted levels missing",
                f"{number(achieved.xi, 5)} of {number(plan.levels_wanted)} (xi)",
            ),
            (
                "outside the range",
                f"{percent(achieved.saturated_fraction)} saturated in every exposure, "
                f"{percent(achieved.dark_fraction)} too dark",
            ),
        ]
    rows += [
        ("time", _timing(report)),
        ("result", str(directory)),
        *(("", name) for name in [*report.files.values(), "report.json", "frames/"]),
    ]
    return "\n".join([*parts, fields(rows)])


def _timing(report: CaptureReport) -> str:
    told = {"planning_s": "planning", "shooting_s": "shooting", "writing_s": "writing"}
    return ", ".join(
        f"{name} {duration(report.timing[key])}"
        for key, name in told.items()
        if key in report.timing
    )


def _metered(report: CaptureReport) -> str:
    metering = report.plan.metering
    if metering is None:
        return "as given"
    frames = "1 frame" if metering.frames == 1 else f"{metering.frames} frames"
    return (
        f"metered in {frames}: at {duration(metering.setting.time_s)} highlights reach "
        f"{percent(metering.highlight)} of full scale, {percent(metering.clipped)} clipped"
    )


def _frames(report: CaptureReport) -> str:
    heads = ("exposure", "wanted", "time", "gain", "saturated")
    wanted = sorted(report.plan.ratios)
    lines: list[Sequence[str]] = []
    frames = [frame for frame in report.frames if frame is not None]
    by_exposure = sorted(frames, key=lambda frame: frame.exposure)
    for frame, ratio in zip(by_exposure, wanted, strict=False):
        lines.append(
            (
                number(frame.exposure),
                number(ratio),
                duration(frame.applied_s),
                number(frame.applied.gain, 4),
                percent(frame.saturated_fraction),
            )
        )
    return table(heads, lines, right=range(len(heads)))


def source_of(camera_id: str, beside: Mapping[str, str]) -> dict[str, Any]:
    """Return what a report must hold to open its camera again, from any working directory."""
    found_again = {name: _anywhere(value) for name, value in beside.items()}
    return {"camera": camera_id, "options": found_again}


def _anywhere(value: str) -> str:
    """Return a file's name as a full path; a bare word stays, even where a file is called so."""
    path = Path(value)
    return str(path.resolve()) if (path.suffix or "/" in value) and path.exists() else value


def fresh_directory(parent: Path = Path()) -> Path:
    """Return a folder in `parent` that is not there yet, named by the time of day."""
    stem = f"capture-{datetime.now():%Y%m%d-%H%M%S}"
    names = (stem if number == 1 else f"{stem}-{number}" for number in range(1, 1000))
    return next(parent / name for name in names if not (parent / name).exists())
