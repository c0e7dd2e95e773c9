"""The plot of `camctl tradeoff simulation`: differences against CPU time, a panel for a scene."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from camctl.studies.simulation_study import SimulationPoint, SimulationRun, SimulationStudy
from camctl.system.plots import COLOURS, plot

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LOWEST_DN = 1e-4
"""Differences below this are drawn here: on a logarithmic axis, 0 has no place."""


CAPTION = """Each panel is one scene and exposure; further left is faster, further down is more
faithful. Each point is a tolerance, with its number in DN beside it. The bound is what the
simulation promises before the ADC; largest and mean are differences, after the ADC, from the frame
in which every effect was simulated, whose time is the dashed line. A difference of zero is drawn at
the bottom. Where the mean lies far below the largest difference, few samples change; where it comes
near to it, a part of the light is left out in most of the frame."""


def draw_study(study: SimulationStudy, paths: tuple[Path, ...]) -> None:
    """Draw differences against CPU time to `paths`; raises what `plots.plot` raises."""
    count = len(study.runs)
    columns = min(5, count)
    rows = math.ceil(count / columns)
    with plot(paths, (2.7 * max(columns, 3), 2.5 * rows + 1.4), CAPTION) as figure:
        panels = figure.subplots(rows, columns, sharey=True, squeeze=False).ravel()
        for axes, run, points in zip(panels, study.runs, study.points, strict=False):
            _panel(axes, run, points)
        for axes in panels[count:]:
            axes.remove()
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), frameon=False)
        figure.supylabel("difference, DN", fontsize=9)


def _panel(axes: Axes, run: SimulationRun, points: Sequence[SimulationPoint]) -> None:
    exposure = "" if run.stops == 0 else f", {run.stops:+g} stops"
    axes.set_title(f"{Path(run.scene).name}{exposure}")
    axes.set(yscale="log", xlabel="CPU time of a frame, ms", ylim=(LOWEST_DN / 2, 20))
    complete = [point.milliseconds for point in points if point.tolerance_dn == 0]
    if complete:
        axes.axvline(complete[0], color="#888888", linewidth=1, linestyle="--")
    times = [point.milliseconds for point in points if point.tolerance_dn > 0]
    series = {
        "bound": [point.bound_dn for point in points if point.tolerance_dn > 0],
        "largest": [float(point.largest_dn) for point in points if point.tolerance_dn > 0],
        "mean": [point.mean_dn for point in points if point.tolerance_dn > 0],
    }
    for (name, values), colour, marker in zip(series.items(), COLOURS, "o^s", strict=False):
        drawn = [max(value, LOWEST_DN) for value in values]
        axes.plot(times, drawn, color=colour, marker=marker, linewidth=0.7, label=name)
    labels: dict[float, list[str]] = {}
    for point in points:
        if point.tolerance_dn > 0:  # several tolerances may leave out the same effects
            labels.setdefault(point.bound_dn, []).append(f"{point.tolerance_dn:g}")
    for bound_dn, names in labels.items():
        time_ms = max(point.milliseconds for point in points if point.bound_dn == bound_dn)
        place = (time_ms, max(bound_dn, LOWEST_DN))
        axes.annotate(", ".join(names), place, (3, 4), textcoords="offset points", fontsize=6.5)
    axes.set_xlim(left=0)
