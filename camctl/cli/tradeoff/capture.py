"""`camctl tradeoff capture`: accuracy of pictures against the time that they take."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from camctl.cli import options
from camctl.cli.commands import command
from camctl.cli.options import declare, declare_as, option
from camctl.cli.output import format_duration, format_number, format_table, progress_bar
from camctl.cli.parameter_types import (
    CAMERA,
    PATH,
    ListOf,
    Name,
    WholeNumber,
)
from camctl.cli.request_options import RESPONSE, named
from camctl.cli.tradeoff.study_options import StudyOptions, study_options
from camctl.errors import UsageError

if TYPE_CHECKING:
    from camctl.studies.capture_rows import CaptureStudy, Rated
    from camctl.studies.capture_study import CaptureRun

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
        "\n".join(study.in_words(lambda seconds: format_duration(float(f"{seconds:.2g}")))),
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


METHODS = ("xi", "paper", "hasinoff", "equal", "doubling", "2-stop", "3-stop")
SIZE = "320x240"
"""Frames of the simulated camera: enough samples to measure to 1 %, and quick."""


@dataclass(frozen=True)
class Brackets:
    """Which brackets are compared, for which camera and scene."""

    camera: str = declare(
        "--camera ID",
        "Camera; only the pictures of the simulated one are measured, of others accuracy and "
        "time are predicted.",
        CAMERA,
        default="sim",
    )
    camera_settings: tuple[tuple[str, str], ...] = declare_as(options.camera_settings)
    scene: str = declare_as(named("scene", default="tile-floor"))
    sensor: str = declare_as(named("sensor", default="standard"))
    size: str = declare_as(named("size", "Size of a simulated frame in pixels.", default=SIZE))
    lens: bool = declare(
        "--lens/--no-lens",
        "Simulate the lens, too: blur, vignetting and glare change the light itself, and no "
        "choice of exposures corrects them.",
        default=False,
    )
    response: str = declare(
        "--response linear|gamma|log", "How brightness depends on light.", RESPONSE, default="log"
    )
    gamma: float | None = declare_as(named("gamma"))
    dynamic_range: float = declare_as(
        named(
            "dynamic_range",
            "Dynamic range of the picture: 256, 1,000, 16,000, or any NUMBER.",
            default="medium",
        )
    )
    counts: tuple[int, ...] | None = declare_as(
        named(
            "counts",
            "Numbers of exposures of the other methods.  [default: 1 to 6, doubling to 7, and 3, "
            "5, 7 of the brackets that cameras offer]",
        )
    )
    methods: tuple[str, ...] = declare(
        "--methods NAME,...",
        "Methods to compare with the front: xi (least missing levels), paper (its printed "
        "table), hasinoff (best worst-case signal-to-noise ratio, with gain), equal (averaging), "
        "doubling (1, 2, 4, ..., also the 3, 5 or 7 frames that cameras offer), 2-stop and 3-stop "
        "(frames so far apart, which cameras offer, too).",
        ListOf(Name("method", METHODS), unique=True),
        default=",".join(METHODS),
    )
    base_s: float | None = declare_as(
        named(
            "base_s",
            "Shutter time of the shortest exposure; auto meters it as camctl shoot does, so "
            "that highlights are just below saturation.",
            default="auto",
        )
    )
    repeats: int = declare(
        "--repeats N",
        "Captures of each bracket, each with noise of its own; the time grows with their number.",
        WholeNumber(least=1, most=1000),
        default=3,
    )
    seed: int = declare_as(options.seed)
    no_profile: bool = declare(
        "--no-profile", "Leave out what calibrations of this camera have measured."
    )

    def runs(self) -> tuple[CaptureRun, ...]:
        """Return the runs, with the base exposure metered where it is not given.

        Raises:
            UsageError: a response and a gamma contradict each other
            CameraError, CaptureError: the camera cannot be opened, or not be metered
        """
        from camctl.studies.bracket_methods import COUNTS, offers
        from camctl.studies.capture_study import SIMULATED, CaptureRun, front_runs, metered

        response = self.response
        if self.gamma is not None:
            if response not in ("gamma", "log"):
                raise UsageError(
                    f"--gamma cannot be combined with --response {response}",
                    hint="leave one of them out",
                )
            response = "gamma"
        is_simulated, settings = self.camera == SIMULATED, self.camera_settings
        first = CaptureRun(
            method=self.methods[0],
            n=1,
            response=response,
            dynamic_range=self.dynamic_range,
            base_s=self.base_s or 1.0,
            gamma=self.gamma,
            camera=self.camera,
            options=settings,
            scene=self.scene if is_simulated else None,
            sensor=self.sensor if is_simulated else None,
            size=self.size if is_simulated else None,
            lens=self.lens,
            seeds=tuple(range(self.seed, self.seed + self.repeats)) if is_simulated else (),
            # A simulated camera states all that a profile could say, unless it has options.
            profile="none" if self.no_profile or (is_simulated and not settings) else "all",
        )
        if self.base_s is None:
            first = metered(first)
        return front_runs(first) + tuple(
            replace(first, method=method, n=count)
            for method in self.methods
            for count in self.counts or COUNTS[method]
            if offers(method, first.desired, count)
        )


bracket_options = options.option_group(Brackets, "brackets")


@command(
    examples=(
        ("camctl tradeoff capture", "the front and all methods, on the simulated camera"),
        ("camctl tradeoff capture --response linear -n 1,2,3,4", "for a linear picture"),
        ("camctl tradeoff capture --sensor webcam --plot webcam.svg", "another sensor, and a plot"),
        (
            "camctl tradeoff capture --methods doubling --json",
            "one other method, as JSON rows",
        ),
        ("camctl tradeoff capture --again rows.json", "the runs of such rows once more"),
    )
)
@bracket_options
@option(
    "--keep FILE",
    "Keep the result of each bracket in FILE as soon as it is there; the same command continues "
    "with those that it finds there.",
    PATH,
)
@study_options
@options.as_json
@click.pass_context
def capture(
    context: click.Context,
    brackets: Brackets,
    keep: Path | None,
    study: StudyOptions,
    as_json: bool,
) -> None:
    """Show what accuracy costs in time: the front, and how far other methods are from it.

    The front has the most accurate settings for each time, over all that the camera can set.
    Accuracy is the number of effective levels with the camera's noise: predicted, and measured
    against the scene in real captures of the simulated camera. Time lasts from the first request
    until the last frame has arrived. Both are relative to full scale of the shortest exposure.
    """
    study.check(context, set(vars(brackets)))
    from camctl.studies.capture_plot import draw_study
    from camctl.studies.capture_rows import CaptureStudy
    from camctl.studies.capture_study import SIMULATED, CapturePoint, CaptureRun, rate
    from camctl.studies.parallel import run_all
    from camctl.studies.rows import KeptResults, read_runs

    with progress_bar("metering") as bar:
        runs = brackets.runs() if study.again is None else read_runs(study.again, CaptureRun)
        is_simulated = all(run.camera == SIMULATED for run in runs)
        # The longest first, so that no process waits for one at the end.
        order = sorted(range(len(runs)), key=lambda place: -runs[place].n)
        ranked = run_all(
            rate,
            [runs[place] for place in order],
            workers=study.workers if is_simulated else 1,
            may_leave=is_simulated,
            kept=None if keep is None else KeptResults(keep, CaptureRun, CapturePoint),
            progress=None if bar is None else lambda share: bar(share, f"{len(runs)} brackets"),
        )
    points = [point for _, point in sorted(zip(order, ranked, strict=True), key=lambda x: x[0])]
    found = CaptureStudy(runs, tuple(points))
    study.show(found, draw_study, study_text, as_json=as_json)
