"""`camctl tradeoff simulation`: fidelity of the simulated sensor against its time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import click

from camctl.cli import options
from camctl.cli.commands import command
from camctl.cli.options import declare, declare_as
from camctl.cli.output import (
    format_duration,
    format_number,
    format_table,
    progress_bar,
    without_stage,
)
from camctl.cli.parameter_types import SCENE, ListOf, Number, WholeNumber
from camctl.cli.request_options import named
from camctl.cli.tradeoff.study_options import StudyOptions, study_options

if TYPE_CHECKING:
    from camctl.studies.simulation_study import SimulationStudy

SCENES = "ball,cloth,colour-chart,moving-target,night-street,ramp,room,stars,tile-floor,uniform"


@dataclass(frozen=True)
class Frames:
    """Which frames are simulated, and at which tolerances."""

    scenes: tuple[str, ...] = declare(
        "--scenes NAME|FILE,...",
        "Scenes: built-in ones, scene files or radiance maps.",
        ListOf(SCENE, unique=True),
        default=SCENES,
    )
    sensor: str = declare_as(named("sensor", default="complete"))
    stops: tuple[float, ...] = declare(
        "--stops STOPS,...",
        "Exposures, relative to the one at which the highlights are just below saturation.",
        ListOf(Number("stops from -64 to 64, such as 0,4", least=-64, most=64), unique=True),
        default="0",
    )
    size: str | None = declare_as(named("size"))
    tolerances_dn: tuple[float, ...] = declare(
        "--tolerances DN,...",
        "Tolerances, see `camctl simulate --tolerance`; each takes as many frames.",
        ListOf(Number("tolerances of at least 0 DN", least=0), unique=True),
        default="0,0.1,0.5,1,2,4,8",
    )
    repeats: int = declare(
        "--frames N",
        "Frames that are taken and compared at each tolerance; the time grows with their number.",
        WholeNumber(least=1, most=1000),
        default=8,
    )
    seed: int = declare_as(options.seed)


frame_options = options.option_group(Frames, "frames")


@command(
    examples=(
        ("camctl tradeoff simulation", "all built-in scenes, less than a minute"),
        ("camctl tradeoff simulation --scenes room,stars --stops 0,4", "also four stops longer"),
        ("camctl tradeoff simulation --plot simulation.svg", "with a plot"),
        ("camctl tradeoff simulation --again rows.json --json", "the runs of such rows once more"),
    )
)
@frame_options
@study_options
@options.as_json
@click.pass_context
def simulation(context: click.Context, frames: Frames, study: StudyOptions, as_json: bool) -> None:
    """Compare frames with effects left out with complete ones: difference against CPU time.

    A tolerance allows the simulated sensor to leave out effects that together change no sample by
    more than that before the ADC. Other methods leave out the same effects in every frame: the
    optics, or all but noise and the quantiser. Differences are counted after the ADC, from the
    frame of the same random numbers with every effect.
    """
    study.check(context, set(vars(frames)))
    from camctl.studies.parallel import run_all
    from camctl.studies.rows import read_runs
    from camctl.studies.simulation_plot import draw_study
    from camctl.studies.simulation_study import (
        SimulationRun,
        SimulationStudy,
        measure,
        simulation_runs,
    )

    if study.again is not None:
        todo = read_runs(study.again, SimulationRun)
    else:
        todo = simulation_runs(
            frames.scenes,
            frames.sensor,
            frames.tolerances_dn,
            stops=frames.stops,
            size=frames.size,
            seed=frames.seed,
            frames=frames.repeats,
        )
    with progress_bar(f"{len(todo)} scenes and exposures") as bar:
        points = run_all(measure, todo, workers=study.workers, progress=without_stage(bar))
    found = SimulationStudy(todo, tuple(points))
    study.show(found, draw_study, _to_text, as_json=as_json)


def _to_text(study: SimulationStudy) -> str:
    rows = []
    for run, points in zip(study.runs, study.points, strict=True):
        name = f"{run.scene}, {format_duration(points[0].time_s)}"
        for point in points:
            present = len(point.effects) + len(point.left_out)
            rows.append(
                (
                    name,
                    point.method
                    if point.tolerance_dn is None
                    else f"{format_number(point.tolerance_dn)} DN",
                    "-" if point.bound_dn is None else format_number(point.bound_dn, 3),
                    str(point.largest_dn),
                    format_number(point.mean_dn, 2),
                    format_number(point.shift_dn, 2),
                    f"{point.milliseconds:.1f}",
                    f"{len(point.effects)} of {present}",
                )
            )
            name = ""
    headings = (
        "scene",
        "tolerance or method",
        "bound, DN",
        "largest",
        "mean",
        "shift",
        "CPU ms",
        "effects",
    )
    return (
        format_table(headings, rows, right_aligned=range(1, len(headings)))
        + "\n\n"
        + "\n".join(study.in_words())
        + "\n\nlargest, mean: difference of a sample from the frame with every effect, in levels "
        "after the ADC;\nshift: difference of the means of the whole frames. The bound holds "
        "before the ADC.\nThe JSON rows (--json) name the effects that ran and those that did not."
    )
