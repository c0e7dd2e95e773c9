"""The options of a study of exposures: what they are chosen from, and what they are rated by."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import click

from camctl.cli import options
from camctl.cli.options import declare, declare_as
from camctl.cli.parameter_types import Name, Number, Seconds, Settings
from camctl.cli.request_options import RequestOptions
from camctl.errors import UsageError
from camctl.exposure.goal import DEFAULT_COUNT

if TYPE_CHECKING:
    from camctl.exposure.noise import NoiseTerm

NOISE_KINDS = ("paper", "time", "aperture", "gain")

CONFLICTS = {
    "tolerance": {"p", "noise", "jitter", "settings"},
    "settings": {"noise", "jitter"},
    "gains": {"total_limit"},
    "certificate": {"p", "noise", "jitter", "total_limit", "settings", "tolerance"},
}
"""Parameters, and those that each cannot be combined with."""

ONLY_FOR_XI = {
    "tolerance",
    "certificate",
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

    total_limit: float | None = declare(
        "--total-limit X",
        "Limit the total exposure time to X times the shortest exposure, or with --settings "
        "to X seconds.  [default: no limit]",
        Number("a positive number", above=0),
    )
    settings: tuple[float, ...] | None = declare(
        "--settings FILE|MIN:MAX:STEP",
        "Choose among a camera's shutter times, for the shortest exposure too: a file with "
        "true seconds, one per line, such as 0.004 or 1/32; or even steps.  [default: any times]",
        Settings(
            "a file of times, a list of times or MIN:MAX:STEP in seconds", unit=Seconds(), file=True
        ),
    )
    gains: tuple[float, ...] | None = declare(
        "--gains A,B,...|MIN:MAX:STEP",
        "Gains, as factors, that can be combined with each of --settings.  [default: 1]",
        Settings("gains such as 1,2,4, or MIN:MAX:STEP", unit=Number("a gain above 0", above=0)),
    )
    certificate: bool = declare(
        "--certificate",
        "Also compute how much better any other exposures could be: for two exposures of up "
        "to 10 bits a proof that none are (takes seconds); for more, a lower bound.",
    )
    seed: int = declare_as(options.seed)

    def check(self, request: RequestOptions) -> None:
        """Raise `UsageError` where options contradict each other or one that is needed lacks."""
        if "tolerance" in request and "levels_wanted" not in request:
            raise UsageError("--tolerance needs --levels", hint="give the desired number of levels")
        if self.gains is not None and self.settings is None:
            raise UsageError(
                "--gains needs --settings", hint="give the shutter times to choose from"
            )
        context = click.get_current_context()
        if request.get("objective") == "xi":
            options.refuse_together(context, "--objective xi", {"accuracy"})
        if by_accuracy(request):
            option = "--objective accuracy" if "objective" in request else "--accuracy"
            options.refuse_together(context, option, ONLY_FOR_XI)
            return
        for option in CONFLICTS.keys() & options.given(context):
            options.refuse_together(context, f"--{option}", CONFLICTS[option])

    def counts(self, request: RequestOptions) -> tuple[int, ...]:
        """Return the numbers of exposures to choose from by accuracy."""
        from camctl.exposure.accuracy import COUNTS

        if "count" not in request and ("accuracy" in request or self.total_limit is not None):
            return COUNTS
        return (count_of(request),)


def by_accuracy(request: RequestOptions) -> bool:
    """Return whether exposures are chosen by the least predicted error with the camera's noise."""
    return request.get("objective") == "accuracy" or "accuracy" in request


def count_of(request: RequestOptions) -> int:
    """Return the number of exposures."""
    return int(request.get("count", DEFAULT_COUNT))


TOLERANCE_HELP = (
    "Find the fewest exposures with at most X desired levels missing; needs --levels, and -n is "
    "then the largest number.  [default: as many as -n]"
)

search_limits = options.option_group(SearchLimits, "limits")


@dataclass(frozen=True)
class ObjectiveOptions:
    """The objective beyond the count of missing levels: its power, noise and exposure errors."""

    p: float = declare(
        "--p P",
        "Power of the objective, 1 to 16; only with 1 does it count missing levels.",
        Number("a number from 1 to 16", least=1, most=16),
        default="1",
    )
    noise: float | None = declare(
        "--noise SIGMA",
        "Add the cost of noise; SIGMA is its standard deviation at exposure 1 relative to "
        "full scale.  [default: not added]",
        Number("a number from 0 to 1000", least=0, most=1e3),
    )
    noise_weight: float = declare(
        "--noise-weight C",
        "Cost, in levels, of a noise variance of one squared full scale.",
        Number("a number from 0 to 1e15", least=0, most=1e15),
        default="1",
    )
    noise_kind: str = declare(
        f"--noise-kind {'|'.join(NOISE_KINDS)}",
        "How noise depends on exposure: as in the paper, or as read noise does where "
        "exposures differ in shutter time, aperture or gain.",
        Name("noise term", NOISE_KINDS),
        default="paper",
    )
    jitter: float = declare(
        "--jitter FRACTION",
        "Average over exposures with random errors of this relative size, up to 0.2; for "
        "example 0.01.",
        Number("a fraction from 0 to 0.2", least=0, most=0.2),
        default="0",
    )

    @property
    def counts_levels(self) -> bool:
        """Whether the objective is the number of missing levels."""
        return self.p == 1 and self.noise is None and self.jitter == 0

    def noise_term(self) -> NoiseTerm | None:
        """Return the noise term; None without --noise."""
        from camctl.exposure.noise import NoiseTerm

        if self.noise is None:
            return None
        return NoiseTerm(self.noise, self.noise_weight, self.noise_kind)


objective_options = options.option_group(ObjectiveOptions, "objective")
