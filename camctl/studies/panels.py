"""Plots of camctl against other methods, one panel for each problem: a bold line, and dots."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from camctl.system.plots import COLOURS, plain_ticks, plot

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Place = tuple[float, float]
"""What is spent, and what is lost by it."""

_LINE = "#111111"
"""Colour of camctl's line."""

_MARKERS = "osP^D"


@dataclass(frozen=True)
class Panel:
    """One problem.

    Attributes:
        title: what it is
        line: places of camctl, in the order in which they are connected
        dots: places of each other method
        names: texts beside some places
    """

    title: str
    line: Sequence[Place]
    dots: dict[str, Sequence[Place]]
    names: dict[Place, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Form:
    """What all panels of a plot share.

    Attributes:
        line: what camctl's line is called
        x, y: what the axes show
        least: where smaller values of y are drawn: 0 has no place on a logarithmic axis
        caption: what to see, below the panels
        mark: a value of y with a dotted line; None: none
        columns: panels beside each other, at most
    """

    line: str
    x: str
    y: str
    least: float
    caption: str
    mark: float | None = None
    columns: int = 3


def draw_panels(panels: Sequence[Panel], form: Form, paths: tuple[Path, ...]) -> None:
    """Draw panels to `paths`, both axes logarithmic; raises what `plots.plot` raises."""
    columns = min(form.columns, len(panels))
    rows = math.ceil(len(panels) / columns)
    size = (2.9 * max(columns, 3), 2.7 * rows + 1.2)
    with plot(paths, size, form.caption) as figure:
        grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
        for axes, panel in zip(grid, panels, strict=False):
            _draw(axes, panel, form)
        plain_ticks(grid[0].xaxis)
        for place, axes in enumerate(grid[len(panels) :], len(panels)):
            axes.remove()
            grid[place - columns].tick_params(labelbottom=True)
        found = [axes.get_legend_handles_labels() for axes in grid[: len(panels)]]
        legend = {label: handle for each in found for handle, label in zip(*each, strict=True)}
        figure.legend(
            list(legend.values()),
            list(legend),
            loc="outside upper center",
            ncols=len(legend),
            frameon=False,
        )
        figure.supylabel(form.y, fontsize=9)


def _draw(axes: Axes, panel: Panel, form: Form) -> None:
    axes.set_title(panel.title)
    axes.set(xscale="log", yscale="log", xlabel=form.x)
    if form.mark is not None:
        axes.axhline(form.mark, color="#888888", linewidth=0.8, linestyle=":")

    def drawn(places: Sequence[Place]) -> tuple[list[float], list[float]]:
        return [x for x, _ in places], [max(y, form.least) for _, y in places]

    axes.plot(*drawn(panel.line), "o-", color=_LINE, markersize=3, linewidth=3, label=form.line)
    for place, (method, places) in enumerate(panel.dots.items()):
        colour, marker = COLOURS[place % len(COLOURS)], _MARKERS[place % len(_MARKERS)]
        axes.plot(*drawn(places), marker, color=colour, markersize=4, label=method)
    for (x, y), text in panel.names.items():
        at = (x, max(y, form.least))
        axes.annotate(text, at, (4, 4), textcoords="offset points", fontsize=6.5)
