"""The folder and the progress bar of a capture, and the output at its end."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import click

from camctl.cli.capture_output.summary import (
    capture_text,
    draws_bars,
    format_wall,
    light_text,
    simulation_text,
)
from camctl.cli.configuration import Configuration
from camctl.cli.output import (
    format_duration,
    print_json,
    print_text,
    print_warning,
    progress_bar,
)
from camctl.messages.command_line import finding_lines, with_remedies

if TYPE_CHECKING:
    from camctl.captures.sequence import Progress
    from camctl.records.capture_plan import CapturePlan
    from camctl.records.report import CaptureReport

Complete: TypeAlias = "Callable[[CaptureReport], CaptureReport]"
"""Takes the report of a complete capture, and returns it."""

UNTRUSTWORTHY = 3
"""Exit status for a picture whose frames contradict their exposures."""


def new_directory(kind: str = "capture") -> Path:
    """Return the path of a folder that does not exist, named by date and time.

    It is in the folder for results of the configuration file, else in the working directory.
    """
    parent = Configuration.load().folder
    stem = f"{kind}-{datetime.now():%Y%m%d-%H%M%S}"
    names = (stem if number == 1 else f"{stem}-{number}" for number in range(1, 1000))
    return next(parent / name for name in names if not (parent / name).exists())


def show_capture(
    take: Callable[[Complete], CaptureReport],
    directory: Path,
    *,
    as_json: bool,
    explain: bool = False,
    show: Callable[[CaptureReport], None] | None = None,
) -> None:
    """Take a capture, and print what was found and its summary.

    Errors after it is complete, such as in closing the camera or printing, get a note of that.

    Args:
        take: takes it; passes the complete report through its argument
        directory: of the capture
        as_json: print the report as JSON
        explain: also print which effects a simulated camera left out
        show: prints the findings and the report in another way
    """
    completed: list[CaptureReport] = []

    def complete(report: CaptureReport) -> CaptureReport:
        completed.append(report)
        return report

    try:
        report = take(complete)
        if show is not None:
            show(report)
        else:
            print_findings(report)
            if as_json:
                from camctl.records.report_json import to_json  # loads pydantic

                print_json(to_json(report))
            else:
                print_text(capture_text(report, directory, with_bars=draws_bars()))
            if explain and not as_json:
                print_text("\n" + simulation_text(report))
    except BaseException as error:
        if completed:
            error.add_note(f"the capture in {directory} is complete")
        raise
    if not report.trustworthy:
        click.get_current_context().exit(UNTRUSTWORTHY)


def print_findings(report: CaptureReport) -> None:
    """Print one line of warning for each finding of a report."""
    remarks = report.remarks
    for line in finding_lines(remarks):
        print_warning(line)
    if report.untrustworthy_because is not None:
        reasons = [finding for finding in report.findings if finding not in remarks]
        remedies = {name: each for reason in reasons for name, each in reason.remedies.items()}
        because = with_remedies(report.untrustworthy_because, remedies)
        print_warning(f"not trustworthy: {because}")


@contextmanager
def capture_progress() -> Iterator[Callable[[Progress], None] | None]:
    """Show the progress of a capture while the block runs; yield None without a terminal.

    Before the first exposure it prints what will be shot, and how long that takes.
    """
    is_planned = False
    with progress_bar("opening") as bar:
        if bar is None:
            yield None
            return
        show_share = bar

        def show(progress: Progress) -> None:
            nonlocal is_planned
            if progress.plan is not None and not is_planned:
                is_planned = True
                sys.stderr.write(plan_text(progress.plan) + "\n")
            show_share(progress.share, progress.stage)

        yield show


def plan_text(plan: CapturePlan) -> str:
    """Return one line on what will be shot, and how long it takes."""
    times = ", ".join(format_duration(setting.time_s) for setting in plan.settings)
    line = f"shooting {times}"
    if plan.light is not None:
        line = f"{light_text(plan.light)}\n{line}"
    if plan.wall_s is None:
        return line
    duration = format_wall(plan.wall_s)
    if plan.is_wall_known:
        return f"{line}: about {duration}"
    return f"{line}: at least {duration}, since this camera has not been timed yet"
