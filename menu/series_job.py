"""A series of the menu, taken as the command line takes one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from camctl.captures.series import Series
from camctl.captures.series_sets import CameraSets, SeriesProgress, SeriesTools, date_by
from camctl.errors import CaptureError
from camctl.exposure.goal import CaptureRequest
from camctl.interface.camera import Camera
from camctl.interface.clock import cancelled_by
from camctl.menu.data import Progress, SeriesChoice, Summary
from camctl.menu.views import summary_view
from camctl.records.folder_store import read_report
from camctl.records.journal import SeriesJournal, SeriesOptions


def take_series(
    camera: Camera,
    source: Mapping[str, Any],
    request: CaptureRequest,
    series: SeriesChoice,
    directory: Path,
    on_progress: Callable[[Progress], None],
    cancelled: Callable[[], bool],
) -> Summary:
    """Take the pictures of a series; return the last complete one, with what to know as notes.

    The light is metered once, so that the pictures do not flicker in a film.

    Args:
        camera: an open camera
        source: what is needed to open it again, for ``camctl resume``
        request: what is asked of each picture
        series: how many, and how often
        directory: the new folder of the series
        on_progress: called before each picture, and while the series waits
        cancelled: returns True once the series is to end

    Raises:
        InterruptedCaptureError: it was cancelled; the pictures and the frames so far are kept
        CaptureError: no picture is complete
    """
    options = SeriesOptions(repeat=series.count, interval_s=series.interval_s)
    journal = SeriesJournal(
        camera=camera.info, source=dict(source), request=request, options=options
    )
    notes: list[str] = []

    def show(progress: SeriesProgress) -> None:
        total = progress.total or series.count
        on_progress(Progress(progress.done, total, "taken", progress.done / total))

    tools = SeriesTools(camera.clock, warn=notes.append, progress=show, date=date_by(camera.clock))
    sets = CameraSets(camera, journal, date=tools.date, cancelled=cancelled)
    with cancelled_by(cancelled):
        Series(directory, journal, sets, tools).run()
    complete = [each for each in journal.sets if each.state == "complete"]
    if not complete:
        raise CaptureError(
            f"none of {series.count} pictures is complete: {journal.sets[-1].error}",
            hint="see the log of the series, series.json",
        )
    folder = directory / complete[-1].folder
    taken = f"{len(complete)} of {series.count} pictures are in {directory}"
    summary = summary_view(read_report(folder), folder)
    return replace(summary, notes=(taken, *notes, *summary.notes))
