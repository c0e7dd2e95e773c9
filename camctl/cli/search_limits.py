"""The options of `camctl solve` for what exposures are chosen from and by what."""

from __future__ import annotations

from dataclasses import dataclass

import click

from camctl.cli import options
from camctl.cli.parameter_types import Number, Seconds, Settings
from camctl.errors import UsageError

CONFLICTS = {
    "tolerance": {"p", "noise", "jitter", "total_limit", "settings", "time_limit"},
    "settings": {"noise", "jitter", "time_limit"},
    "gains": {"total_limit"},
    "certificate": {"p", "noise", "jitter", "total_limit", "settings", "tolerance"},
}
"""Parameters, and those that each cannot be combined with."""

ONLY_FOR_XI = {
    "tolerance",
    "certificate",
    "time_limit",
    "seed",
    "levels_wanted",
    "p",
    "noise",
    "noise_weight",
    "noise_kind",
    "jitter",
}
"""Parameters that have no meaning where exposures are chosen by accuracy."""


@dataclass(frozen=True)
class SearchLimits:
    """What the exposures are chosen from, and how long the search may take."""

    count: int
    objective_kind: str | None
    accuracy: float | None
    tolerance: float | None
    total_limit: float | None
    settings: tuple[float, ...] | None
    gains: tuple[float, ...] | None
    certificate: bool
    time_limit: float | None
    seed: int

    def check(self, levels_wanted: float | None) -> None:
        """Raise `UsageError` where options contradict each other or one that is needed lacks."""
        if self.tolerance is not None and levels_wanted is None:
            raise UsageError("--tolerance needs --levels", hint="give the desired number of levels")
        if self.gains is not None and self.settings is None:
            raise UsageError(
                "--gains needs --settings", hint="give the shutter times to choose from"
            )
        context = click.get_current_context()
        if self.objective_kind == "xi":
            options.refuse_together(context, "--objective xi", {"accuracy"})
        if self.by_accuracy:
            option = "--accuracy" if self.objective_kind is None else "--objective accuracy"
            options.refuse_together(context, option, ONLY_FOR_XI)
            return
        for option in CONFLICTS.keys() & options.given(context):
            options.refuse_together(context, f"--{option}", CONFLICTS[option])

    @property
    def by_accuracy(self) -> bool:
        """Whether exposures are chosen by the least predicted error with the camera's noise."""
        return self.objective_kind == "accuracy" or self.accuracy is not None

    @property
    def counts(self) -> tuple[int, ...]:
        """Numbers of exposures to choose from by accuracy."""
        from camctl.exposure.accuracy import COUNTS

        chosen = self.accuracy is not None or self.total_limit is not None
        count_given = "count" in options.given(click.get_current_context())
        return COUNTS if chosen and not count_given else (self.count,)


search_limits = options.option_group(
    SearchLimits,
    "limits",
    options.count,
    options.objective_kind,
    options.accuracy,
    click.option(
        "--tolerance",
        type=Number("a number of levels of at least 0", least=0),
        metavar="X",
        help="Find the fewest exposures with at most X desired levels missing; needs --levels, and "
        "-n is then the largest number.  [default: as many as -n]",
    ),
    click.option(
        "--total-limit",
        type=Number("a positive number", above=0),
        metavar="X",
        help="Limit the total exposure time to X times the shortest exposure, or with --settings "
        "to X seconds.  [default: no limit]",
    ),
    click.option(
        "--settings",
        type=Settings(
            "a file of times, a list of times or MIN:MAX:STEP in seconds", unit=Seconds(), file=True
        ),
        metavar="FILE|MIN:MAX:STEP",
        help="Choose among a camera's shutter times, for the shortest exposure too: a file with "
        "true seconds, one per line, such as 0.004 or 1/32; or even steps.  [default: any times]",
    ),
    click.option(
        "--gains",
        type=Settings(
            "gains such as 1,2,4, or MIN:MAX:STEP", unit=Number("a gain above 0", above=0)
        ),
        metavar="A,B,...|MIN:MAX:STEP",
        help="Gains, as factors, that can be combined with each of --settings.  [default: 1]",
    ),
    click.option(
        "--certificate",
        is_flag=True,
        help="Also compute how much better any other exposures could be: for two exposures of up "
        "to 10 bits a proof that none are (takes seconds); for more, a lower bound.",
    ),
    click.option(
        "--time-limit",
        type=Number("a time in seconds above 0", above=0),
        metavar="SECONDS",
        help="Stop the search after this time; with --certificate, stop bounding after about this "
        "time.  [default: no limit]",
    ),
    options.seed,
)
