"""Options that the studies share: plots, processes, and rows to run again."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import click

from camctl.cli import options
from camctl.cli.parameter_types import PATH, WholeNumber


@dataclass(frozen=True)
class StudyOptions:
    """Where plots go, how many processes work, and the JSON rows whose runs are repeated."""

    plots: tuple[Path, ...]
    workers: int | None
    again: Path | None
    force: bool

    def check(self, context: click.Context, run_parameters: Collection[str]) -> None:
        """Check what can be checked before the work.

        Args:
            context: of the command
            run_parameters: the parameters that say what to run, which --again replaces

        Raises:
            UsageError: --again beside one of them, or a plot of an unknown format
            StorageError: a plot exists, or there is no folder for it
            MissingPlotLibraryError: a plot is requested, and matplotlib is not installed
        """
        from camctl.studies.plots import check_plots

        if self.again is not None:
            options.refuse_together(context, "--again", set(run_parameters))
        check_plots(self.plots, overwrite=self.force)


study_options = options.option_group(
    StudyOptions,
    "study",
    click.option(
        "--plot",
        "plots",
        type=PATH,
        multiple=True,
        metavar="FILE",
        help="Also draw the results: .svg or .png; may be given several times.",
    ),
    click.option(
        "--workers",
        type=WholeNumber(least=1, most=256),
        metavar="N",
        help="Number of processes; the Dask cluster that $DASK_SCHEDULER_ADDRESS names takes "
        "their place.  [default: one per processor]",
    ),
    click.option(
        "--again",
        type=PATH,
        metavar="FILE",
        help="Repeat the runs in the rows of a file that --json has written.",
    ),
    options.force,
)
