"""The result of `camctl tradeoff capture`: rows, the Pareto front, and its knee."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

from camctl.exposure.tradeoff import gain_in_words
from camctl.studies.capture_study import CapturePoint, CaptureRun

SAME = 0.005
"""Relative difference in effective levels up to which two brackets are equally good."""


def pareto_front(points: Sequence[CapturePoint]) -> list[bool]:
    """Return for each point whether no other has more levels in no more time.

    Differences up to `SAME` do not count: of several such points the quickest is on the front.
    """
    ranked = sorted(
        (index for index, point in enumerate(points) if math.isfinite(point.time_s)),
        key=lambda index: (points[index].time_s, -points[index].levels),
    )
    front, best = set(), 0.0
    for index in ranked:
        if points[index].levels > best * (1 + SAME):
            front.add(index)
            best = points[index].levels
    return [index in front for index in range(len(points))]


def knee(points: Sequence[CapturePoint]) -> int | None:
    """Return the point of a front from which on more time brings least; None of fewer than three.

    It is the one farthest above the line between the ends, with both axes logarithmic: before it
    each per cent of time brings more accuracy than on average, after it less.
    """
    ranked = sorted(range(len(points)), key=lambda index: points[index].time_s)
    if len(ranked) < 3:
        return None
    times = [math.log(points[index].time_s) for index in ranked]
    levels = [math.log(points[index].levels) for index in ranked]
    slope = (levels[-1] - levels[0]) / (times[-1] - times[0])
    above = [y - levels[0] - slope * (x - times[0]) for x, y in zip(times, levels, strict=True)]
    place = max(range(len(above)), key=above.__getitem__)
    return ranked[place]


@dataclass(frozen=True)
class CaptureStudy:
    """Runs and their points, in the same order."""

    runs: tuple[CaptureRun, ...]
    points: tuple[CapturePoint, ...]

    @cached_property
    def pareto(self) -> list[bool]:
        """Whether each point is on the front."""
        return pareto_front(self.points)

    @cached_property
    def knee(self) -> int | None:
        """The place of the front's knee."""
        places = [place for place, is_on in enumerate(self.pareto) if is_on]
        found = knee([self.points[place] for place in places])
        return None if found is None else places[found]

    @property
    def methods(self) -> list[str]:
        """The methods that have results, in the order of the runs."""
        pairs = zip(self.runs, self.points, strict=True)
        return list(dict.fromkeys(run.method for run, point in pairs if not point.note))

    @property
    def noise_counted(self) -> str:
        """What the effective levels count, in words."""
        return next(point.noise_counted for point in self.points if not point.note)

    @property
    def common_count(self) -> int:
        """The number of exposures that most methods have; of several, the one nearest to 3."""
        counts = [
            run.n for run, point in zip(self.runs, self.points, strict=True) if not point.note
        ]
        return min(set(counts), key=lambda count: (-counts.count(count), abs(count - 3)))

    def of_method(self, method: str) -> list[tuple[int, CaptureRun, CapturePoint]]:
        """Return (place, run, point) of the results of one method, by number of exposures."""
        everything = zip(self.runs, self.points, strict=True)
        found = [
            (place, run, point)
            for place, (run, point) in enumerate(everything)
            if run.method == method and not point.note
        ]
        return sorted(found, key=lambda each: each[1].n)

    def steps_in_words(self, method: str, duration: Callable[[float], str]) -> list[str]:
        """Return what each further exposure costs and brings with one method."""
        found = []
        for (_, before, cheaper), (_, run, point) in pairwise(self.of_method(method)):
            if run.n == before.n + 1:
                cost = duration(max(point.time_s - cheaper.time_s, 0.0))
                found.append(gain_in_words(run.n, cost, point.levels, cheaper.levels))
        return found

    def rows(self) -> list[dict[str, Any]]:
        """Return one object for each run, ready for JSON: its fields and its results."""
        rows = []
        for run, point, is_on_front in zip(self.runs, self.points, self.pareto, strict=True):
            each = point.effective_levels_each
            rows.append(
                {
                    **asdict(run),
                    "exposures": point.exposures,
                    "times_s": [setting.time_s for setting in point.settings],
                    "gains": [setting.gain for setting in point.settings],
                    "shutter_s": point.shutter_s,
                    "time_s": point.time_s,
                    "time_measured_s": point.time_measured_s,
                    "effective_levels_predicted": point.effective_levels_predicted,
                    "effective_levels_noise_free": point.effective_levels_noise_free,
                    "effective_levels_measured": point.effective_levels_measured,
                    "spread": [min(each), max(each)] if each else None,
                    "effective_levels_each": each,
                    "noise_known": point.noise_known,
                    "coverage": point.coverage,
                    "pareto": is_on_front,
                    "decades": [asdict(decade) for decade in point.decades],
                    "note": point.note,
                }
            )
        return rows
