"""The plot of `camctl tradeoff capture`: the front of accuracy against time, and what is below."""

from __future__ import annotations

import math
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

from camctl.studies.bracket_methods import FRONT, LABELS, METHODS
from camctl.studies.capture_rows import CaptureStudy, Rated
from camctl.system.plots import COLOURS, plain_ticks, plot

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MARKERS = "oPX^sDv"

_FRONT = "#111111"
"""Colour of the front."""

CAPTION = """Further up is more accurate, further left is quicker. The line has the most accurate
settings for each time, with shutter times of some; the ring marks where more time begins to pay
only as averaging does. Each dot is another way to choose the number of exposures beside it.
{source}"""

_MEASURED = """Effective levels, {noise}, are predicted; bars show by how much {repeats} captures,
measured against the simulated scene, differ from that at least and at most."""
_PREDICTED = "Effective levels, {noise}, are predicted: this is no simulated camera."


def draw_study(study: CaptureStudy, paths: tuple[Path, ...]) -> None:
    """Draw a study to `paths`; raises what `plots.plot` raises."""
    repeats = max(len(point.effective_levels_each) for point in study.points)
    source = (_MEASURED if repeats else _PREDICTED).format(
        repeats=repeats, noise=study.noise_counted
    )
    run = study.runs[0]
    before = f", {run.sensor} sensor, {run.scene}" if run.scene else f", {run.camera}"
    with plot(paths, (8.6, 5.6), CAPTION.format(source=source)) as figure:
        axes = figure.subplots()
        axes.set_title(f"What accuracy costs: {run.desired.description}{before}")
        axes.set(xscale="log", yscale="log")
        axes.set_xlabel("time until the last frame, s")
        axes.set_ylabel(f"effective levels, {study.noise_counted}")
        label = f"{FRONT}: {LABELS[FRONT]}"
        axes.plot(*zip(*study.line, strict=True), color=_FRONT, linewidth=3, label=label)
        for method in study.methods:
            _draw_method(axes, method, study.of_method(method))
        if study.recommended is not None:
            point = study.recommended[1]
            axes.plot(
                *(point.time_s, point.effective_levels),
                *"o",
                markersize=13,
                fillstyle="none",
                color="#222222",
                zorder=5,
            )
        _widen(axes)
        _label_front(axes, study.around)
        _label_counts(axes, [each for each in study.results if each[0].method != FRONT])
        for axis in (axes.xaxis, axes.yaxis):
            plain_ticks(axis)
        axes.legend(loc="lower right", fontsize=7.5, framealpha=0.9)


def _draw_method(axes: Axes, method: str, found: list[Rated]) -> None:
    """Draw the front as a line, another method as dots, with the intervals of measurements."""
    is_front = method == FRONT
    place = -1 if is_front else list(METHODS).index(method)
    colour = _FRONT if is_front else COLOURS[place % len(COLOURS)]
    times = [point.time_s for _, point in found]
    levels = [point.effective_levels for _, point in found]
    axes.plot(
        times,
        levels,
        "o" if is_front else _MARKERS[place],
        color=colour,
        markersize=3.5 if is_front else 5.0,
        label="" if is_front else f"{method}: {LABELS[method]}",
        zorder=4 if is_front else 3,
    )
    for _, point in found:
        if each := point.deviations:
            ends = [point.effective_levels * (1 + end) for end in (min(each), max(each))]
            axes.plot([point.time_s] * 2, ends, "-_", color=colour, linewidth=1)


def _widen(axes: Axes) -> None:
    """Leave space for the texts on the left of the front, and for the legend below it."""
    low, high = axes.get_xlim()
    axes.set_xlim(low / 1.3, high)
    bottom, top = axes.get_ylim()
    axes.set_ylim(bottom, top * 1.2)


def _label_front(axes: Axes, points: list[Rated]) -> None:
    """Write shutter times above and to the left of points, where no set can be."""
    for run, point in points:
        times = sorted(setting.time_s for setting in point.settings)
        axes.annotate(
            f"{run.n} frames: {_times_text(times)}",
            (point.time_s, point.effective_levels),
            (-10, 8),
            textcoords="offset points",
            ha="right",
            fontsize=8,
            arrowprops={"arrowstyle": "-", "linewidth": 0.6, "shrinkA": 0, "shrinkB": 3},
        )


def _times_text(times: list[float]) -> str:
    """Return shutter times in two digits, equal ones once.

    >>> _times_text([0.0199, 0.0201, 0.0926, 1.23])
    '2 x 20, 93, 1200 ms'
    """
    rounded = groupby(f"{float(f'{1000 * time:.2g}'):g}" for time in times)
    counted = [(text, len(list(equal))) for text, equal in rounded]
    return ", ".join(f"{n} x {text}" if n > 1 else text for text, n in counted) + " ms"


def _label_counts(axes: Axes, dots: list[Rated]) -> None:
    """Write the number of exposures beside each dot, but not over that of another one."""
    low_x, high_x = (math.log(value) for value in axes.get_xlim())
    low_y, high_y = (math.log(value) for value in axes.get_ylim())
    taken: list[tuple[float, float]] = []
    for run, point in sorted(dots, key=lambda each: each[1].effective_levels):
        x, y = point.time_s, point.effective_levels
        place = ((math.log(x) - low_x) / (high_x - low_x), (math.log(y) - low_y) / (high_y - low_y))
        if any(abs(place[0] - a) < 0.02 and abs(place[1] - b) < 0.03 for a, b in taken):
            continue
        taken.append(place)
        axes.annotate(str(run.n), (x, y), (5, -3), textcoords="offset points", fontsize=7, va="top")
