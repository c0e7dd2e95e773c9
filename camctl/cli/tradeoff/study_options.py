"""Options that the studies share: plots, processes, and rows to run again."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

import click

from camctl.cli import options
from camctl.cli.options import declare, declare_as
from camctl.cli.output import print_json, print_text
from camctl.cli.parameter_types import PATH
from camctl.cli.request_options import named


class Study(Protocol):
    """The results of a study."""

    def rows(self) -> list[dict[str, Any]]:
        """Return one JSON object for each run."""


StudyT = TypeVar("StudyT", bound=Study)


@dataclass(frozen=True)
class StudyOptions:
    """Where plots go, how many processes work, and the JSON rows whose runs are repeated."""

    plots: tuple[Path, ...] = declare(
        "--plot FILE",
        "Also draw the results: .svg or .png; may be given several times.",
        PATH,
        multiple=True,
    )
    workers: int | None = declare_as(named("workers"))
    again: Path | None = declare(
        "--again FILE", "Repeat the runs in the rows of a file that --json has written.", PATH
    )
    force: bool = declare_as(options.force)

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
        from camctl.system.plots import check_plots

        if self.again is not None:
            options.refuse_together(context, "--again", set(run_parameters))
        check_plots(self.plots, overwrite=self.force)

    def show(
        self,
        found: StudyT,
        draw: Callable[[StudyT, tuple[Path, ...]], None],
        text: Callable[[StudyT], str],
        *,
        as_json: bool,
    ) -> None:
        """Draw the results where plots are asked for, and print them."""
        if self.plots:
            draw(found, self.plots)
        if as_json:
            print_json({"rows": found.rows()})
        else:
            print_text(text(found))


study_options = options.option_group(StudyOptions, "study")
