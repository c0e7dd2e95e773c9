"""The plot of `camctl tradeoff capture`: accuracy against time, and error against irradiance."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from camctl.studies.bracket_methods import LABELS, METHODS
from camctl.studies.capture_rows import CaptureStudy
from camctl.studies.plots import COLOURS, plot, spread_out

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MARKERS = "oPsD^vX"

_LEAST_GAP = 0.045
"""Least distance of two names of lines, share of the height."""

_GAP, _NAMES = 0.06, 0.66
"""Distance and width of the column of names, shares of the axis before they were added."""

CAPTION = """Left: further up is more accurate, further left is quicker. Each point is a bracket,
labelled with its number of exposures; the grey line joins the best of all methods, the Pareto
front, and the ring is its knee. Right: where in the scene the light is well known, with
{count} exposures; lower is better. {source}"""

_MEASURED = """Effective levels, {noise}, are measured against the simulated scene (median;
captures of each bracket: {repeats}); black crosses are the prediction."""
_PREDICTED = "Effective levels, {noise}, are predicted: this is no simulated camera."


def draw_study(study: CaptureStudy, paths: tuple[Path, ...]) -> None:
    """Draw a study to `paths`; raises what `plots.plot` raises."""
    is_measured = any(point.effective_levels_each for point in study.points)
    repeats = max(len(point.effective_levels_each) for point in study.points)
    source = (_MEASURED if is_measured else _PREDICTED).format(
        repeats=repeats, noise=study.noise_counted
    )
    caption = CAPTION.format(count=study.common_count, source=source)
    if not is_measured:
        caption = caption.split("Right:")[0].replace("Left: f", "F") + source
    run = study.runs[0]
    before = f", {run.sensor} sensor, {run.scene}" if run.scene else f", {run.camera}"
    with plot(paths, (11, 5.4) if is_measured else (7, 5.4), caption) as figure:
        panels = figure.subplots(
            1, 2 if is_measured else 1, squeeze=False, width_ratios=[1.5, 1][: 1 + is_measured]
        ).ravel()
        panels[0].set_title(f"What accuracy costs: {run.desired.description}{before}")
        _draw_front(panels[0], study)
        if is_measured:
            _draw_decades(panels[1], study)


def _colour(method: str) -> str:
    return COLOURS[list(METHODS).index(method)]


def _draw_front(axes: Axes, study: CaptureStudy) -> None:
    axes.set(xscale="log", yscale="log")
    axes.set_xlabel("time until the last frame, s")
    axes.set_ylabel(f"effective levels, {study.noise_counted}")
    front = sorted(
        (point.time_s, point.levels)
        for point, is_on in zip(study.points, study.pareto, strict=True)
        if is_on
    )
    axes.plot(*zip(*front, strict=True), color="#bbbbbb", linewidth=5, zorder=1)
    labels: list[tuple[float, float, str]] = []
    for method in study.methods:
        found = [(run.n, point) for _, run, point in study.of_method(method)]
        times, levels = [p.time_s for _, p in found], [p.levels for _, p in found]
        colour, marker = _colour(method), _MARKERS[list(METHODS).index(method)]
        axes.plot(times, levels, color=colour, marker=marker, linewidth=1, label=LABELS[method])
        predicted = [p.effective_levels_predicted for _, p in found]
        if any(p.effective_levels_each for _, p in found):
            axes.plot(
                times, predicted, "x", color="black", markersize=3.5, markeredgewidth=0.7, zorder=4
            )
            low = [p.levels - min(p.effective_levels_each) for _, p in found]
            high = [max(p.effective_levels_each) - p.levels for _, p in found]
            axes.errorbar(times, levels, [low, high], fmt="none", ecolor=colour, elinewidth=1)
        labels += [
            (time, level, f"{n}") for (n, _), time, level in zip(found, times, levels, strict=True)
        ]
    _label_points(axes, labels)
    if study.knee is not None:
        best = study.points[study.knee]
        axes.plot(best.time_s, best.levels, "o", markersize=15, fillstyle="none", color="#222222")
    _plain_ticks(axes)
    ends = [(method, study.of_method(method)[-1][2]) for method in study.methods]
    _name_lines(axes, [(m, p.time_s, p.levels) for m, p in ends], at_right=True)


def _label_points(axes: Axes, points: list[tuple[float, float, str]]) -> None:
    """Write a number beside each point, once where several points are at the same place."""
    low_x, high_x = (math.log(value) for value in axes.get_xlim())
    low_y, high_y = (math.log(value) for value in axes.get_ylim())
    taken: list[tuple[float, float]] = []
    for x, y, text in sorted(points, key=lambda point: -point[1]):
        place = ((math.log(x) - low_x) / (high_x - low_x), (math.log(y) - low_y) / (high_y - low_y))
        if any(
            abs(place[0] - other[0]) < 0.03 and abs(place[1] - other[1]) < 0.045 for other in taken
        ):
            continue
        taken.append(place)
        axes.annotate(text, (x, y), (0, 6), textcoords="offset points", ha="center", fontsize=7.5)


def _name_lines(axes: Axes, ends: list[tuple[str, float, float]], *, at_right: bool) -> None:
    """Write the methods of lines in a column at one side, each joined with the end of its line.

    `ends`: method, and x and y of that end of its line.
    """
    left, right = (math.log(value) for value in axes.get_xlim())
    low, high = (math.log(value) for value in axes.get_ylim())
    column = right + _GAP * (right - left) if at_right else left - _GAP * (right - left)
    wide = _NAMES * (right - left) * (1 if at_right else 0.38)
    edges = (left, column + wide) if at_right else (column - wide, right)
    axes.set_xlim(*(math.exp(edge) for edge in edges))
    heights = spread_out([(math.log(y) - low) / (high - low) for _, _, y in ends], _LEAST_GAP)
    for (method, x, y), height in zip(ends, heights, strict=True):
        place = (math.exp(column), math.exp(low + height * (high - low)))
        axes.plot([x, place[0]], [y, place[1]], ":", color=_colour(method), linewidth=0.8)
        axes.annotate(
            f"{method}: {LABELS[method]}" if at_right else method,
            place,
            (3 if at_right else -3, 0),
            textcoords="offset points",
            color=_colour(method),
            ha="left" if at_right else "right",
            va="center",
            fontsize=8,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.5},
        )
    axes.set_ylim(math.exp(low), math.exp(high))


def _draw_decades(axes: Axes, study: CaptureStudy) -> None:
    axes.set(xscale="log", yscale="log")
    axes.set_title(f"Where the light is well known, {study.common_count} exposures")
    axes.set_xlabel("irradiance E, relative to full scale of the shortest exposure")
    axes.set_ylabel("error of the irradiance, %")
    ends: list[tuple[str, float, float]] = []
    for method in study.methods:
        for _, run, point in study.of_method(method):
            if run.n != study.common_count:
                continue
            known = [d for d in point.decades if math.isfinite(d.relative_error)]
            middles = [math.sqrt(decade.low * decade.high) for decade in known]
            errors = [100 * decade.relative_error for decade in known]
            marker = _MARKERS[list(METHODS).index(method)]
            axes.plot(middles, errors, color=_colour(method), marker=marker)
            ends.append((method, middles[-1], errors[-1]))
    _plain_ticks(axes, x_digits=(1.0,))
    _name_lines(axes, ends, at_right=False)


def _plain_ticks(axes: Axes, *, x_digits: tuple[float, ...] = (1.0, 2.0, 5.0)) -> None:
    """Write the numbers of both axes in full: 0.2, 1, 20; on x numbers with these digits.

    Only those within the present limits: what is added beside is for names.
    """
    from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullLocator

    low, high = axes.get_ylim()
    y_digits = (1.0, 2.0, 5.0) if high > 10 * low else (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)
    for axis, digits in ((axes.xaxis, x_digits), (axes.yaxis, y_digits)):
        least, most = axis.get_view_interval()
        ticks = LogLocator(subs=digits).tick_values(least, most)
        axis.set_major_locator(FixedLocator([tick for tick in ticks if least <= tick <= most]))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_locator(NullLocator())
