"""`camctl table build`: an exposure table for another camera."""

from __future__ import annotations

import os
from concurrent.futures import BrokenExecutor
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

from camctl.cli import options
from camctl.cli.commands import command
from camctl.cli.options import declare, declare_as, option
from camctl.cli.output import print_json, print_text, print_warning, progress_bar
from camctl.cli.parameter_types import PATH, DynamicRange, ListOf
from camctl.cli.real_camera import RealCameraOptions, real_camera_options
from camctl.cli.request_options import SEARCHED, named
from camctl.errors import CamctlError, visible
from camctl.model.response.names import RESPONSES


class LostWorkerError(CamctlError):
    """A process that solved rows was ended, such as by the system for lack of memory."""


class InterruptedBuildError(CamctlError):
    """The building of a table was interrupted; finished rows are kept."""

    exit_status = 130


@dataclass(frozen=True)
class TableContent:
    """The rows to build: all responses, with all ranges, with 1 to `count` exposures."""

    responses: tuple[str, ...] = declare_as(named("responses", default=",".join(RESPONSES)))
    ranges: tuple[float, ...] = declare(
        "--ranges RANGE,...",
        "Dynamic ranges, by name or number.",
        ListOf(DynamicRange(), unique=True),
        default="low,medium,high",
    )
    count: int = declare_as(named("count", "Numbers of exposures: 1 up to N.", SEARCHED, default=6))

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.responses) * len(self.ranges) * self.count

    def work_done(self, rows: int) -> float:
        """Return the fraction of the solver's work in the first `rows` rows.

        Rows with the most exposures, which take longest, are solved first.
        """
        from camctl.exposure.solver import EVALUATIONS, MAX_EVALUATIONS

        each = len(self.responses) * len(self.ranges)
        if self.count == 1:
            return rows / each
        work = [0.0] + [n * EVALUATIONS.get(n, MAX_EVALUATIONS) for n in range(2, self.count + 1)]
        done = sum(
            weight * min(max(rows - each * place, 0), each)
            for place, weight in enumerate(reversed(work))
        )
        return done / (sum(work) * each)


content_options = options.option_group(TableContent, "content")


@command(
    examples=(
        ("camctl table build --bits 10 -o ten-bit.json", "all menu entries for a 10-bit camera"),
        (
            "camctl table build --curve webcam.txt --responses log --ranges 500,5000 -n 3",
            "six rows for a measured camera",
        ),
    ),
)
@real_camera_options
@content_options
@options.seed
@named(
    "workers", "Number of processes; the table is the same with any.  [default: one per processor]"
)
@option("-o --output FILE", "File for the table.", PATH, default="exposure-table.json")
@options.force
@options.as_json
def build(
    real_camera: RealCameraOptions,
    content: TableContent,
    seed: int,
    workers: int | None,
    output: Path,
    force: bool,
    as_json: bool,
) -> None:
    """Build an exposure table for a camera.

    Takes seconds per row, most for rows of five exposures and more. Finished rows are kept beside
    the table: after an interruption, the same command continues.
    """
    from camctl.exposure.build import build_table, discard_rows, table_jobs
    from camctl.studies.parallel import processes
    from camctl.system.files import check_new

    check_new(output, overwrite=force)
    real = real_camera.response()
    for note in real.notes:
        print_warning(note)
    done = 0

    def count_rows(finished: int, _all: int) -> None:
        nonlocal done
        done = finished
        if bar is not None:
            bar(content.work_done(finished), "")

    finished_rows = output.with_name(f"{output.name}.parts")
    counts = range(1, content.count + 1)
    jobs = table_jobs(real, content.responses, content.ranges, counts, seed=seed)
    count = min(workers or os.cpu_count() or 1, content.rows)
    try:
        with (
            progress_bar(f"solving {content.rows} rows") as bar,
            nullcontext() if count == 1 else processes(count) as executor,
        ):
            table = build_table(
                jobs,
                executor=executor,
                state=finished_rows,
                progress=count_rows,
            )
    except (KeyboardInterrupt, BrokenExecutor) as error:
        is_lost = isinstance(error, BrokenExecutor)
        what = "a worker process was ended" if is_lost else str(error) or "interrupted"
        raise (LostWorkerError if is_lost else InterruptedBuildError)(
            f"{what} after {done} of {content.rows} rows",
            hint=f"the same command continues, with the rows kept in {finished_rows}"
            if done
            else "",
        ) from None
    table.save(output)
    discard_rows(jobs, finished_rows)
    if as_json:
        print_json({"file": output, "entries": table.entries})
    else:
        print_text(
            f"wrote {visible(output)}: {content.rows} rows for {visible(real.name)}\n"
            f"show it with: camctl table show --table {visible(output)}"
        )
