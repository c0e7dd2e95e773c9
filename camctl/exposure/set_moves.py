"""Changes of a set of exposures, tried one after the other to improve it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from itertools import product
from typing import TypeAlias

import numpy as np

from camctl.exposure.exposure_choices import AccuracyProblem, Shot, ShotChoices, Shots
from camctl.exposure.random_sets import interleave_step

SAME_GROUP = 4
"""Exposures nearer to each other than so many gaps below the last level are interleaved."""

INTERLEAVES = (0.5, 1.0, 1.5, 0.0, 0.25)
"""Distances tried between equal exposures, in units of the gap below the last level."""

FACTORS = (0.94, 1.06, 0.97, 1.03, 0.985, 1.015, 0.993, 1.007, 0.997, 1.003, 0.999, 1.001)
"""Factors tried on one exposure after the other."""

Move: TypeAlias = Callable[[Shots], Shots | None]
"""Returns a changed set, or None where the change is not possible."""


class SetMoves:
    """Changes of sets of exposures for one problem."""

    def __init__(self, problem: AccuracyProblem) -> None:
        self.problem = problem
        self._gap = interleave_step(problem.response)

    def of(self, choices: ShotChoices, n: int) -> Iterator[Move]:
        """Yield changes of a set: one exposure longer or shorter, levels interleaved."""
        if choices.is_list:
            for place, step in product(range(1, n), (-1, 1, -2, 2)):
                yield partial(self._neighbour, choices, place, step)
            return
        for factor, place in product(FACTORS, range(n - 1, 0, -1)):
            yield partial(self._scaled, place, factor)
        for distance in INTERLEAVES:
            yield partial(self.interleaved, distance)
        if len(self.problem.available.gains) > 1:
            for factor in (2.0, 0.5):
                yield partial(self._all_gains, factor)
                for place in range(n - 1, 0, -1):
                    yield partial(self._gain, place, factor)

    def filled(self, shots: Shots, total: float) -> Shots | None:
        """Return the set with its longest time changed so that the sum is `total`, if possible."""
        place = max(range(len(shots)), key=lambda index: shots[index].time)
        available = self.problem.available
        others = available.costs.total([s.time for s in (*shots[:place], *shots[place + 1 :])])
        longest = available.costs.shutter(total - others)
        exposure = longest * shots[place].gain / min(available.gains)
        if place == 0 or exposure < 1:
            return None
        changed = self._exposed(shots[place], exposure)
        return tuple(sorted((*shots[:place], *shots[place + 1 :], changed)))

    def _neighbour(self, choices: ShotChoices, place: int, step: int, shots: Shots) -> Shots | None:
        """Return the set with the setting `step` places further on the list."""
        table = choices.choices
        same = (choices.times == shots[place].time) & (choices.gains == shots[place].gain)
        index = int(np.flatnonzero(same)[0]) + step
        if not 0 <= index < table.exposures.size:
            return None
        return tuple(sorted((*shots[:place], *shots[place + 1 :], *choices.shots((index,)))))

    def interleaved(self, distance: float, shots: Shots) -> Shots:
        """Return the set with nearly equal exposures `distance` gaps apart."""
        step, changed = self._gap * distance, [shots[0]]
        first, count = shots[0], 0
        for shot in shots[1:]:
            count += 1
            if shot.exposure > first.exposure * (1 + SAME_GROUP * self._gap * count):
                first, count = shot, 0
            changed.append(self._exposed(shot, first.exposure * (1 + step * count)))
        return tuple(sorted(changed))

    def _scaled(self, place: int, factor: float, shots: Shots) -> Shots:
        """Return the set with one exposure multiplied by `factor`."""
        scaled = self._exposed(shots[place], shots[place].exposure * factor)
        return tuple(sorted((*shots[:place], scaled, *shots[place + 1 :])))

    def _exposed(self, shot: Shot, exposure: float) -> Shot:
        """Return the shot with its time changed to another exposure from 1 on."""
        available = self.problem.available
        gain = shot.gain / min(available.gains)
        exposure = max(1.0, available.shortest * gain, min(exposure, available.longest * gain))
        return Shot(exposure, exposure / gain, shot.gain)

    def _gain(self, place: int, factor: float, shots: Shots) -> Shots | None:
        """Return the set with one gain changed and the time with it: the exposure stays."""
        changed = self._regained(shots[place], factor)
        if changed is None:
            return None
        return tuple(sorted((*shots[:place], *shots[place + 1 :], changed)))

    def _all_gains(self, factor: float, shots: Shots) -> Shots | None:
        """Return the set with all gains that can be changed."""
        changed = [self._regained(shot, factor) or shot for shot in shots]
        return tuple(sorted(changed))

    def _regained(self, shot: Shot, factor: float) -> Shot | None:
        """Return the shot at the same exposure with another of the gains, if it can be set."""
        available = self.problem.available
        gain = min(available.gains, key=lambda each: abs(math.log(each / shot.gain / factor)))
        time = shot.time * shot.gain / gain
        if gain == shot.gain or not available.shortest <= time <= available.longest:
            return None
        return Shot(shot.exposure, time, gain)
