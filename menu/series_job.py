"""A series of the menu, taken as the command line takes one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from camctl.captures.series import Series
from camctl.captures.series_sets import CameraSets, SeriesProgress, SeriesTools, date_by
from camctl.errors import CaptureError
from camctl.interface.camera import Camera
from camctl.interface.clock import cancelled_by
from camctl.menu.data import Progress, Summary
from camctl.menu.views import summary_view
from camctl.records.folder_store import read_report
from camctl.records.journal import SeriesJournal
from camctl.records.report_file import check_same_camera


def take_series(
    camera: Camera,
    journal: SeriesJournal,
    directory: Path,
    on_progress: Callable[[Progress], None],
    cancelled: Callable[[], bool],
) -> Summary:
    """Take the missing pictures of a series; return the last one, with what to know as notes.

    The light is metered once, so that the pictures do not flicker in a film.

    Args:
        camera: an open camera
        journal: what is asked of the series, and what was taken
        directory: the folder of the series
        on_progress: called before each picture, and while the series waits
        cancelled: returns True once the series is to end

    Raises:
        InterruptedCaptureError: it was cancelled; the pictures and the frames so far are kept
        CaptureError: no picture is complete
        DataError: the series was begun with another camera
    """
    check_same_camera(journal.camera, camera.info, directory)
    count = journal.options.repeat or 1  # the menu offers series of a number alone
    notes: list[str] = []

    def show(progress: SeriesProgress) -> None:
        on_progress(Progress(progress.done, count, "taken", progress.done / count))

    tools = SeriesTools(camera.clock, warn=notes.append, progress=show, date=date_by(camera.clock))
    sets = CameraSets(camera, journal, date=tools.date, cancelled=cancelled)
    with cancelled_by(cancelled):
        Series(directory, journal, sets, tools).run()
    complete = [each for each in journal.sets if each.state == "complete"]
    if not complete:
        raise CaptureError(
            f"none of {count} pictures is complete: {journal.sets[-1].error}",
            hint="see the log of the series, series.json",
        )
    folder = directory / complete[-1].folder
    taken = f"{len(complete)} of {count} pictures are in {directory}"
    summary = summary_view(read_report(folder), folder)
    return replace(summary, notes=(taken, *notes, *summary.notes))
