"""A control delay that is not the known one, recognised by the light of a capture's frames.

Each frame then has the exposure that was set some frames before, or after, its own.  What was set
is known: the settings of each sequence of the capture, and the setting in which the stream rests
after it.  What was in force before the first sequence is one unknown exposure.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import product

from camctl.evidence.ratio_check import RatioCheck
from camctl.interface.controls import ExposureControls, ExposureSetting, resting_setting

#: The largest error of a control delay that is recognised, frames.
_MOST_LATE = 6
#: Slots beyond the least that may pass between two sequences; the last is a long pause.
_PAUSES = (0, 1, 1000)
#: Comparisons of known exposures that show the number of frames; fewer may fit by chance.
_FEWEST_PAIRS = 2
#: Writes before its own whose setting a frame may have, where the camera settles at each exposure.
_MOST_OLD = 2
#: In place of the unknown exposure before the capture.
_BEFORE = 0.0

#: Number of a sequence, and place in it.
_Place = tuple[int, int]
_Pair = tuple[_Place, _Place, RatioCheck]


@dataclass(frozen=True)
class DelayError:
    """The frames have the exposures that follow from another control delay than the known one.

    Attributes:
        shift: frames by which all exposures came late; negative: early; None: not known
    """

    shift: int | None = None


@dataclass
class _Hypothesis:
    """An error of the control delay that contradicts no ratio yet.

    Attributes:
        shift: frames by which exposures come late; negative: early
        pause: slots between two sequences beyond the least
        before: exposure in force before the capture, as the ratios show it
        explained: pairs of shots whose light has the ratio of the exposures set before them
        is_needed: whether one of these ratios does not fit the shots' own exposures
        measured: pairs whose ratio has given `before`
    """

    shift: int
    pause: int
    before: float | None = None
    explained: set[tuple[_Place, _Place]] = field(default_factory=set)
    is_needed: bool = False
    measured: set[tuple[_Place, _Place]] = field(default_factory=set)


class ShotLog:
    """Which settings were shot, in their order, to recognise a wrong control delay.

    Args:
        settings: of the frames of a capture
        controls: of the camera
        settles: the camera settles at each exposure, whatever its controls say

    Attributes:
        has_delay: whether the camera is a stream, whose settings take effect late
    """

    def __init__(
        self,
        settings: Sequence[ExposureSetting],
        controls: ExposureControls,
        *,
        settles: bool = False,
    ) -> None:
        if settles:
            controls = replace(controls, delay_frames=None)
        self._settings, self._controls = settings, controls
        settles |= controls.timing is not None and controls.timing.old_frames > 0
        self.has_delay = controls.delay_frames is not None or settles
        self._sequences: list[tuple[int, ...]] = []
        delay = controls.delay_frames or 0
        self._possible = [
            _Hypothesis(shift, pause)
            for shift, pause in product(range(-delay - 1, _MOST_LATE + 1), _PAUSES)
            if shift
        ]

    def begin(self, positions: Sequence[int]) -> None:
        """Record that the frames at `positions` are shot now, in one sequence."""
        self._sequences.append(tuple(positions))

    def find(self, checks: Sequence[RatioCheck | None]) -> DelayError | None:
        """Return the error of the control delay that the pixels show; None: none explains them.

        `checks[k]` compares frame k with frame k - 1.  An error has to explain the ratios of each
        call, which is made after each sequence, and some ratio must not fit without it.
        """
        places = {
            position: (number, place)
            for number, sequence in enumerate(self._sequences)
            for place, position in enumerate(sequence)
        }
        pairs = [
            (places[k - 1], places[k], check)
            for k, check in enumerate(checks)
            if check and check.is_certain and {k - 1, k} <= places.keys()
        ]
        if not self.has_delay or all(check.agrees for _, _, check in pairs):
            return None
        if self._controls.delay_frames is None:
            return DelayError() if self._some_are_old(pairs) else None
        self._possible = [each for each in self._possible if self._is_possible(each, pairs)]
        shown = [each for each in self._possible if each.is_needed]
        if not shown:
            return None
        shifts = {each.shift for each in shown}
        is_sure = len(shifts) == 1 and any(len(each.explained) >= _FEWEST_PAIRS for each in shown)
        return DelayError(shifts.pop() if is_sure else None)

    def _is_possible(self, hypothesis: _Hypothesis, pairs: Sequence[_Pair]) -> bool:
        """Return whether no ratio contradicts it; record what it explains."""
        for first, second, check in pairs:
            if (first, second) in hypothesis.measured:
                continue
            one, other = (self._had(hypothesis, place) for place in (first, second))
            if one is None or other is None or check.measured is None:
                continue
            if one != other and _BEFORE in (one, other):
                if one == _BEFORE:
                    before, one = other / check.measured, hypothesis.before
                else:
                    before, other = one * check.measured, hypothesis.before
                if one is None or other is None:
                    hypothesis.before = before
                    hypothesis.measured.add((first, second))
                    continue
            if not _fits(check, 1.0 if one == other else other / one):
                return False
            hypothesis.explained.add((first, second))
            hypothesis.is_needed |= not check.agrees
        return True

    def _had(self, hypothesis: _Hypothesis, place: _Place) -> float | None:
        """Return the exposure of a shot; `_BEFORE`: the one before the capture; None: unknown."""
        delay = self._controls.delay_frames or 0
        number, index = place
        wanted = index - hypothesis.shift
        while True:
            written = self._written(number)
            if wanted >= 0:
                return written[min(wanted, len(written) - 1)]
            if number == 0:
                return _BEFORE if wanted >= -delay else None
            # The next sequence begins when the last frame of the one before it is here.
            number -= 1
            wanted += len(self._sequences[number]) + delay + hypothesis.pause

    def _written(self, number: int) -> list[float]:
        """Return the exposures that were written in a sequence, the one at rest included."""
        settings = [self._settings[position] for position in self._sequences[number]]
        rest = resting_setting(self._controls, settings)
        return [each.exposure for each in (*settings, *([] if rest is None else [rest]))]

    def _some_are_old(self, pairs: Sequence[_Pair]) -> bool:
        """Return whether the frames have their own exposures or those written before them.

        Where the delay is not constant, each setting is written after the frame of the one before.
        """
        written: list[float] = []
        had: dict[_Place, list[float | None]] = {}
        for number, sequence in enumerate(self._sequences):
            exposures = self._written(number)
            for place in range(len(sequence)):
                known = [*written, *exposures[: place + 1]][-1 - _MOST_OLD :]
                had[number, place] = [*known, *[None] * (1 + _MOST_OLD - len(known))]
            written += exposures
        # Exposures that the last frame may have, and whether known ones explain a disagreement.
        states: set[tuple[float | None, bool]] = set()
        for k, (first, second, check) in enumerate(pairs):
            if k == 0 or pairs[k - 1][1] != first:
                is_explained = any(needed for _, needed in states)
                states = {(each, is_explained) for each in had[first]}
            states = {
                (other, needed or not (check.agrees or one is None or other is None))
                for one, needed in states
                for other in had[second]
                if one is None or other is None or _fits(check, other / one)
            }
            if not states:
                return False
        return any(needed for _, needed in states)


def _fits(check: RatioCheck, ratio: float) -> bool:
    """Return whether the frames may have this ratio of exposures."""
    return check.measured is not None and abs(math.log(check.measured / ratio)) <= math.log1p(
        check.tolerance
    )
