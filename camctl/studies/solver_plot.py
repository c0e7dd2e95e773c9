"""The plot of `camctl tradeoff solver`: regret against CPU time, one panel for each problem."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from camctl.studies.solver_study import CAMCTL, METHODS, Case, SolverStudy
from camctl.system.number_text import range_text
from camctl.system.plots import COLOURS, plot

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LOWEST = 1e-5
"""Regrets below this are drawn here: on a logarithmic axis, 0 has no place."""

_MARKERS = ("o", "s", "^", "D")

CAPTION = """Each panel is one problem; further down is better, further left is faster. The line is
camctl, the dots are the other methods, medians over the runs. A point of camctl or of the grid is a
complete search of that length; scipy's optimisers improve one answer as time goes on. All use
the same objective code. Regret is how far xi, the missing levels, lies above the least that any
run found: 0.01 is 1 %. The dotted line marks 0.5 %; a regret of zero is drawn at the bottom."""


def draw_study(study: SolverStudy, paths: tuple[Path, ...]) -> None:
    """Draw regret against CPU time to `paths`; raises what `plots.plot` raises."""
    cases = sorted(study.cases, key=lambda case: case[2])
    columns = min(3, len(cases))
    rows = math.ceil(len(cases) / columns)
    with plot(paths, (3.4 * max(columns, 2), 2.7 * rows + 1.2), CAPTION) as figure:
        panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
        for axes, case in zip(panels, cases, strict=False):
            _panel(axes, study, case)
        for axes in panels[len(cases) :]:
            axes.remove()
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), frameon=False)
        figure.supylabel("regret in xi", fontsize=9)


def _panel(axes: Axes, study: SolverStudy, case: Case) -> None:
    response, dynamic_range, n, bits = case
    axes.set_title(f"{response}, {range_text(dynamic_range)}, {n} exposures, {bits} bits")
    axes.set(xscale="log", yscale="log", xlabel="CPU time, s")
    axes.axhline(0.005, color="#888888", linewidth=0.8, linestyle=":")
    for method, tint, marker in zip(METHODS, COLOURS, _MARKERS, strict=False):
        steps = sorted(spent for curve in study.curves(case, method) for spent, _ in curve)
        if steps:
            medians = [max(study.regret_at(case, method, time_s), LOWEST) for time_s in steps]
            width, colour = (3.0, "#111111") if method == CAMCTL else (0.0, tint)
            axes.plot(
                steps,
                medians,
                color=colour,
                marker=marker,
                markersize=3,
                linewidth=width,
                label=method,
            )
