"""The result of `camctl tradeoff capture`: the front, the other methods beside it, and rows."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np

from camctl.studies.bracket_methods import FRONT
from camctl.studies.capture_study import CapturePoint, CaptureRun

Rated = tuple[CaptureRun, CapturePoint]


@dataclass(frozen=True)
class CaptureStudy:
    """Runs and their points, in the same order."""

    runs: tuple[CaptureRun, ...]
    points: tuple[CapturePoint, ...]

    @cached_property
    def results(self) -> list[Rated]:
        """The runs that have a result, with it."""
        pairs = zip(self.runs, self.points, strict=True)
        return [(run, point) for run, point in pairs if not point.note]

    @cached_property
    def front(self) -> list[Rated]:
        """The front; empty where rows of it were not run again."""
        return self.of_method(FRONT)

    @property
    def methods(self) -> list[str]:
        """The methods that have results, in the order of the runs."""
        return list(dict.fromkeys(run.method for run, _ in self.results))

    def of_method(self, method: str) -> list[Rated]:
        """Return the results of one method, by ascending time."""
        found = [(run, point) for run, point in self.results if run.method == method]
        return sorted(found, key=lambda each: each[1].time_s)

    @property
    def noise_counted(self) -> str:
        """What the effective levels count, in words."""
        return self.results[0][1].noise_counted

    @property
    def recommended(self) -> Rated | None:
        """The point of the front beyond which more time brings no more than averaging does."""
        return next((each for each in self.front if each[0].is_recommended), None)

    @property
    def around(self) -> list[Rated]:
        """Points of the front near half the recommended time, there, and near its double."""
        if self.recommended is None:
            return []
        middle = math.log(self.recommended[1].time_s)
        found = {
            min(
                range(len(self.front)),
                key=lambda place: abs(math.log(self.front[place][1].time_s) - goal),
            )
            for goal in (middle - math.log(2), middle, middle + math.log(2))
        }
        return [self.front[place] for place in sorted(found)]

    @cached_property
    def line(self) -> list[tuple[float, float]]:
        """Times and the most effective levels in them, ascending, as far as they are known."""
        line: list[tuple[float, float]] = []
        for _, point in sorted(self.results, key=lambda each: each[1].time_s):
            most = max(point.front_levels, line[-1][1] if line else 0.0)
            line.append((point.time_s, most))
        return line

    def slower_by(self, point: CapturePoint) -> float | None:
        """Return a point's time over the least time of the same levels; None without a result.

        Between the known points the line is straight on logarithmic axes.
        """
        if point.note:
            return None
        times, levels = np.log(self.line).T
        # Of points with the same levels, the first.
        levels, first = np.unique(levels, return_index=True)
        least = np.interp(math.log(point.effective_levels), levels, times[first])
        return float(point.time_s / np.exp(least))

    def in_words(self, duration: Callable[[float], str]) -> list[str]:
        """Return what accuracy costs in three sentences."""
        if self.recommended is None:
            return []
        costs = [(f"{p.effective_levels:.0f}", duration(p.time_s)) for _, p in self.around]
        first, *rest = (f"{levels}{{}} take {time}" for levels, time in costs)
        end = duration(self.recommended[1].time_s)
        found = [
            ", ".join([first.format(" effective levels"), *(each.format("") for each in rest)]),
            f"Beyond {end} time pays at most as averaging does: four times for twice the levels",
        ]
        times = [point.time_s for _, point in self.around]
        others = sorted(
            (self.slower_by(point) or math.nan, run.method, run.n)
            for run, point in self.results
            if run.method != FRONT and min(times) <= point.time_s <= max(times)
        )
        if others:
            least, most = (
                f"{method} with {n} exposure{'s' * (n > 1)} is {100 * (slower - 1):.0f} % slower"
                for slower, method, n in (others[0], others[-1])
            )
            ends = least if len(others) == 1 else f"{least}, {most}"
            found.append(f"At equal accuracy, of the other methods in these times, {ends}")
        return [f"{sentence}." for sentence in found]

    def rows(self) -> list[dict[str, Any]]:
        """Return one object for each run, ready for JSON: its fields and its results."""
        return [
            asdict(run) | _results(point) | {"slower_by": self.slower_by(point)}
            for run, point in zip(self.runs, self.points, strict=True)
        ]


def _results(point: CapturePoint) -> dict[str, Any]:
    found = asdict(point)
    each: Sequence[float] = point.effective_levels_each
    del found["settings"], found["noise_counted"]
    return {
        **found,
        "times_s": [setting.time_s for setting in point.settings],
        "gains": [setting.gain for setting in point.settings],
        "effective_levels_measured": point.effective_levels_measured,
        "less_accurate_by": None if point.note else point.less_accurate_by,
        "spread": [min(each), max(each)] if each else None,
    }
