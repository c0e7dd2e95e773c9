"""`camctl tradeoff solver`: regret of the search for exposures against CPU time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import click

from camctl.cli import options
from camctl.cli.commands import command
from camctl.cli.options import declare, declare_as
from camctl.cli.output import (
    format_duration,
    format_number,
    format_percent,
    format_table,
    progress_bar,
    without_stage,
)
from camctl.cli.parameter_types import ListOf, Name, Number, WholeNumber
from camctl.cli.request_options import named
from camctl.cli.tradeoff.study_options import StudyOptions, study_options
from camctl.model.response.names import RESPONSES
from camctl.system.number_text import range_text

if TYPE_CHECKING:
    from camctl.studies.solver_study import SolverStudy

METHODS = ("camctl", "differential-evolution", "dual-annealing", "grid")
"""Names of `camctl.studies.solver_study.METHODS`, here because that module imports numpy."""

TIMES_S = (0.03, 0.1, 0.3, 1.0, 3.0)
"""CPU times at which the text shows the regret, s; those above the limit are left out."""


@dataclass(frozen=True)
class Problems:
    """What is searched for: every response with every number of exposures."""

    responses: tuple[str, ...] = declare_as(named("responses", default=",".join(RESPONSES)))
    dynamic_range: float = declare_as(
        named("dynamic_range", "Dynamic range of the desired responses.", default="medium")
    )
    counts: tuple[int, ...] = declare_as(
        named("counts", kind=ListOf(WholeNumber(least=2, most=8), unique=True), default="3,5")
    )
    bits: int = declare(
        "--bits B", "Bits of the linear camera.", WholeNumber(least=4, most=12), default=8
    )


problem_options = options.option_group(Problems, "problems")


@dataclass(frozen=True)
class Runs:
    """Which methods run, how often, and how long."""

    methods: tuple[str, ...] = declare(
        "--methods NAME,...",
        "Methods to compare; differential-evolution and dual-annealing are scipy's.",
        ListOf(Name("method", METHODS), unique=True),
        default=",".join(METHODS),
    )
    seeds: int = declare(
        "--seeds N",
        "Runs of each method, with random numbers of their own; medians are shown, and the time "
        "grows with their number.",
        WholeNumber(least=1, most=100),
        default=3,
    )
    limit_s: float = declare(
        "--limit SECONDS",
        "CPU time of a run.",
        Number("a positive time in seconds", above=0),
        default=2.0,
    )
    max_evaluations: int | None = declare(
        "--evaluations N",
        "End a run also after N sets of exposures: results that do not depend on the "
        "machine's speed.  [default: only the time ends a run]",
        WholeNumber(least=1),
    )


run_options = options.option_group(Runs, "runs")


@command(
    examples=(
        ("camctl tradeoff solver", "six problems with four methods, about a minute"),
        ("camctl tradeoff solver --plot solver.svg --plot solver.png", "with a plot"),
        (
            "camctl tradeoff solver --methods camctl,grid -n 2,3,4 --json",
            "without scipy, as JSON rows",
        ),
        ("camctl tradeoff solver --again rows.json", "the runs of such rows once more"),
    )
)
@problem_options
@run_options
@study_options
@options.as_json
@click.pass_context
def solver(
    context: click.Context,
    problems: Problems,
    runs: Runs,
    study: StudyOptions,
    as_json: bool,
) -> None:
    """Compare the search for exposures with other methods: regret against CPU time.

    The others are scipy's differential evolution and dual annealing, and a search of all sets on a
    grid as in the paper. All minimise the same objective with the same fast code, whole populations
    at a time where the method allows that. Regret is xi above the best xi that any of the runs
    found.
    """
    study.check(context, {"responses", "dynamic_range", "counts", "bits", *vars(runs)})
    from camctl.studies.parallel import run_all
    from camctl.studies.rows import read_runs
    from camctl.studies.solver_plot import draw_study
    from camctl.studies.solver_study import (
        SolverRun,
        SolverStudy,
        measure,
        require_scipy,
        solver_runs,
    )

    if study.again is not None:
        todo = read_runs(study.again, SolverRun)
    else:
        todo = solver_runs(
            [(r, problems.dynamic_range, n) for r in problems.responses for n in problems.counts],
            runs.methods,
            bits=problems.bits,
            seeds=runs.seeds,
            limit_s=runs.limit_s,
            max_evaluations=runs.max_evaluations,
        )
    require_scipy(todo)
    with progress_bar(f"{len(todo)} runs") as bar:
        points = run_all(measure, todo, workers=study.workers, progress=without_stage(bar))
    found = SolverStudy(todo, tuple(points))
    study.show(found, draw_study, _to_text, as_json=as_json)


def _to_text(study: SolverStudy) -> str:
    """Return a table: median regret after some CPU times, and the time to a regret of 0.5 %."""
    longest = max(run.limit_s for run in study.runs)
    times = [time_s for time_s in TIMES_S if time_s <= longest] or [longest]
    rows = []
    for case in study.cases:
        response, dynamic_range, n, _ = case
        name = f"{response}, {range_text(dynamic_range)}, n = {n}"
        for method in dict.fromkeys(run.method for run in study.runs if run.case == case):
            regrets = [study.regret_at(case, method, time_s) for time_s in times]
            reached = study.time_to(case, method)
            rows.append(
                (
                    name,
                    method,
                    *("-" if math.isinf(regret) else format_percent(regret) for regret in regrets),
                    "not reached" if math.isinf(reached) else format_duration(reached),
                )
            )
            name = ""
    headings = (
        "problem",
        "method",
        *(f"after {format_number(time_s)} s" for time_s in times),
        "0.5 % after",
    )
    table = format_table(headings, rows, right_aligned=range(2, len(headings)))
    seeds = len({run.seed for run in study.runs})
    return (
        f"{table}\n\n" + "\n".join(study.in_words()) + "\n\n"
        f"Regret: xi above the best that any run found; median of {seeds} "
        f"run{'s' if seeds > 1 else ''}; CPU time of one core. A '-' means that no answer was "
        "there yet.\nAll methods use the same objective code; scipy's optimisers begin again where "
        "they end early."
    )
