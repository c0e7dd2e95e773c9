"""What `camctl tradeoff capture` prints."""

from __future__ import annotations

from typing import TYPE_CHECKING

from camctl.cli.output import format_duration, format_number, format_table

if TYPE_CHECKING:
    from camctl.studies.capture_rows import CaptureStudy


def study_text(study: CaptureStudy) -> str:
    """Return the table, the error by decade, the steps in words, and what has no result."""
    from camctl.studies.bracket_methods import LABELS

    run = study.runs[0]
    before = f"{run.sensor} sensor before {run.scene}" if run.scene else run.camera
    parts = [
        f"{run.desired.description}; {before}; shortest exposure {format_duration(run.base_s)}",
        _points_text(study),
        _explanation(study),
    ]
    if decades := _decades_text(study):
        parts.append(decades)
    method, words = study.methods[0], []
    if steps := study.steps_in_words(method, _short):
        words = [f"With {method} ({LABELS[method]}):", *steps]
    if study.knee is not None:
        best, point = study.runs[study.knee], study.points[study.knee]
        words.append(
            f"The knee of the front is {best.method} with {best.n} "
            f"exposure{'s' * (best.n > 1)} and {_short(point.time_s)}: beyond it, "
            "time brings less accuracy than before it."
        )
    if words:
        parts.append("\n".join(words))
    notes = [
        f"{run.method}, {run.n} exposure{'s' * (run.n > 1)}: {point.note}"
        for run, point in zip(study.runs, study.points, strict=True)
        if point.note
    ]
    return "\n\n".join([*parts, *(["\n".join(notes)] if notes else [])])


def _explanation(study: CaptureStudy) -> str:
    """Return what the columns of the table are."""
    points = [point for point in study.points if not point.note]
    noise = study.noise_counted
    lines = [
        f"L: effective levels, (12 mean square error)^(-1/2) in the desired brightness, {noise}.",
        "*: no other line has more levels, by over 0.5 %, in no more time.",
    ]
    if not {"accuracy", "quick"}.isdisjoint(study.methods):
        lines.append(
            "accuracy, quick: the fastest set among those within 0.5 % of the best accuracy "
            "predicted: another line may have up to 0.5 % more."
        )
    if points[0].effective_levels_each:
        lines += [
            "measured: median of the captures, and their spread.",
            f"The scene has {100 * points[0].coverage:.0f} % of the range.",
        ]
    return "\n".join(lines)


def _short(seconds: float) -> str:
    return format_duration(float(f"{seconds:.2g}"))


def _points_text(study: CaptureStudy) -> str:
    rows = []
    for method in study.methods:
        for place, run, point in study.of_method(method):
            each, measured = point.effective_levels_each, point.effective_levels_measured
            gains = {setting.gain for setting in point.settings}
            exposures = ", ".join(format_number(exposure, 4) for exposure in point.exposures)
            if len(gains) > 1:
                applied = ", ".join(format_number(each.gain, 3) for each in point.settings)
                exposures += f" at gain {applied}"
            rows.append(
                (
                    method if run.n == study.of_method(method)[0][1].n else "",
                    str(run.n),
                    format_duration(float(f"{point.shutter_s:.3g}")),
                    format_duration(float(f"{point.time_s:.3g}")),
                    format_number(point.effective_levels_predicted, 4),
                    "-" if measured is None else format_number(measured, 4),
                    f"{min(each):.1f} to {max(each):.1f}" if each else "-",
                    "*" if study.pareto[place] else "",
                    exposures,
                )
            )
    headings = (
        "method",
        "n",
        "shutter",
        "time",
        "L predicted",
        "L measured",
        "spread",
        "",
        "exposures",
    )
    return format_table(headings, rows, right_aligned=range(1, 7))


def _decades_text(study: CaptureStudy) -> str:
    """Return the error of the light by decade, for each method at the number most have."""
    headings = ["error of the light, by decade of E"]
    rows: list[list[str]] = []
    count = study.common_count
    for method in study.methods:
        for _, run, point in study.of_method(method):
            if run.n == count and point.decades:
                if not rows:
                    rows.append(["share of the samples"])
                    for decade in point.decades:
                        headings.append(f"{decade.low:g} to {decade.high:g}")
                        rows[0].append(f"{100 * decade.share:.0f} %")
                errors = [f"{100 * decade.relative_error:.1f} %" for decade in point.decades]
                rows.append([f"{method}, {run.n} exposure{'s' * (run.n > 1)}", *errors])
    return format_table(headings, rows, right_aligned=range(1, len(headings))) if rows else ""
