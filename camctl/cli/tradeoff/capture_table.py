"""What `camctl tradeoff capture` prints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from camctl.cli.output import format_duration, format_number, format_table

if TYPE_CHECKING:
    from camctl.studies.capture_rows import CaptureStudy, Rated

FRONT = "front"
"""`camctl.studies.bracket_methods.FRONT`, here because that module imports numpy."""

_MOST_GROUPS = 7
"""Exposures of a set that the table shows, so that its lines end within 140 characters."""


def study_text(study: CaptureStudy) -> str:
    """Return the table, the error by decade, what it says in words, and what has no result."""
    from camctl.exposure.noise import noise_findings
    from camctl.messages.command_line import finding_line

    run = study.runs[0]
    is_known = study.results[0][1].noise_known
    before = f"{run.sensor} sensor before {run.scene}" if run.scene else run.camera
    parts = [
        f"{run.desired.description}; {before}; shortest exposure {format_duration(run.base_s)}",
        _points_text(study),
        _explanation(study),
        _decades_text(study),
        "\n".join(study.in_words(_short)),
        "" if is_known else "\n".join(map(finding_line, noise_findings(None, run.camera))),
        "\n".join(
            f"{run.method}, {run.n} exposure{'s' * (run.n > 1)}: {point.note}"
            for run, point in zip(study.runs, study.points, strict=True)
            if point.note
        ),
    ]
    return "\n\n".join(filter(None, parts))


def _explanation(study: CaptureStudy) -> str:
    """Return what the columns of the table are."""
    lines = [
        "L: effective levels, predicted, (12 mean square error)^(-1/2) in the desired brightness, "
        f"{study.noise_counted}.",
    ]
    if study.front:
        lines += [
            "front: the most levels in each time, of all settings of the camera; *: recommended.",
            "slower by: time over the least time for the same levels.",
            "less accurate by: share that is missing of the most levels in the same time.",
        ]
    point = study.results[0][1]
    if point.effective_levels_each:
        lines += [
            "measured: how far captures are from the prediction, least to most, over the "
            f"{100 * point.coverage:.0f} % of the range that the scene has.",
        ]
    return "\n".join(lines)


def _short(seconds: float) -> str:
    return format_duration(float(f"{seconds:.2g}"))


def exposures_text(exposures: Sequence[float]) -> str:
    """Return exposures, those that differ by less than 1 % once, with their number.

    >>> exposures_text([1.0, 1.002, 9.9099])
    '2 x 1, 9.91'
    """
    groups: list[list[float]] = []
    for exposure in exposures:
        if groups and exposure < 1.01 * groups[-1][0]:
            groups[-1].append(exposure)
        else:
            groups.append([exposure])
    texts = [
        f"{len(group)} x {format_number(group[0], 3)}"
        if len(group) > 1
        else format_number(group[0], 4)
        for group in groups
    ]
    if len(texts) > _MOST_GROUPS:
        texts[_MOST_GROUPS - 1 : -1] = ["..."]
    return ", ".join(texts)


def _points_text(study: CaptureStudy) -> str:
    rows = [
        (method if not place else "", *_cells(study, rated))
        for method in study.methods
        for place, rated in enumerate(study.of_method(method))
    ]
    headings = (
        *("method", "n", "shutter", "time", "L", "measured"),
        *("slower by", "less accurate by", "exposures"),
    )
    return format_table(headings, rows, right_aligned=range(1, 8))


def _cells(study: CaptureStudy, rated: Rated) -> tuple[str, ...]:
    run, point = rated
    each = sorted(point.deviations)
    slower, less = study.slower_by(point), point.less_accurate_by
    gains = {setting.gain for setting in point.settings}
    exposures = exposures_text(point.exposures)
    if len(gains) > 1:
        applied = ", ".join(format_number(setting.gain, 3) for setting in point.settings)
        exposures += f" at gain {applied}"
    is_compared = slower is not None and run.method != FRONT
    return (
        str(run.n),
        format_duration(float(f"{point.shutter_s:.3g}")),
        format_duration(float(f"{point.time_s:.3g}")),
        format_number(point.effective_levels, 4),
        f"{100 * each[0]:+.1f} to {100 * each[-1]:+.1f} %" if each else "-",
        f"{slower:.2f} x" if is_compared else "*" if run.is_recommended else "",
        f"{round(100 * less)} %" if is_compared else "",
        exposures,
    )


def _decades_text(study: CaptureStudy) -> str:
    """Return the error of the light by decade, of the recommended point and of three exposures."""
    shown = [] if study.recommended is None else [study.recommended]
    shown += [(run, point) for run, point in study.results if run.n == 3 and run.method != FRONT]
    headings = ["error of the light, by decade of E"]
    rows: list[list[str]] = []
    for run, point in shown:
        if not point.decades:
            continue
        if not rows:
            rows.append(["share of the samples"])
            for decade in point.decades:
                headings.append(f"{decade.low:g} to {decade.high:g}")
                rows[0].append(f"{100 * decade.share:.0f} %")
        errors = [f"{100 * decade.relative_error:.1f} %" for decade in point.decades]
        rows.append([f"{run.method}, {run.n} exposure{'s' * (run.n > 1)}", *errors])
    return format_table(headings, rows, right_aligned=range(1, len(headings))) if rows else ""
