"""A control delay that is not the known one, recognised by the light of a capture's frames.

Each frame then has the exposure that was set some frames before, or after, its own.  What was set
is known: the settings of each sequence of the capture, and the setting in which the stream rests
after it.  What was in force before the first sequence is one unknown exposure.

Beside it stand the other explanations of a capture's frames: each has its own exposure, but for
frames that are wrong; or lamps flicker; or a frame was sent twice; or the camera clamps what is
set, and its longest or shortest exposures are one.  The most probable one counts.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, product

from camctl.evidence.explanation import Compare, Explanation, Explanations, Flicker, Had
from camctl.evidence.light_ratio import lamp_factor
from camctl.evidence.ratio_check import SIGNIFICANCE
from camctl.interface.controls import ExposureControls, ExposureSetting, resting_setting

#: The largest error of a control delay that is recognised, frames.
_MOST_LATE = 6
#: Writes before its own whose setting a frame may have, where the camera settles at each exposure.
_MOST_OLD = 2
#: Logarithm of the probability of each kind of error before there is a frame.
_UNLIKELY = math.log(SIGNIFICANCE)

#: Settings of shots, and None where a shot does not count.
_Asked = Sequence[ExposureSetting | None]
#: What shots had, by the frames that exposures come late; 0: how many has no number.
_Late = Mapping[int, Sequence[Explanation]]


@dataclass(frozen=True)
class DelayError:
    """The frames have the exposures that follow from another control delay than the known one.

    Attributes:
        shift: frames by which all exposures came late; negative: early; None: not known
        log_odds: logarithm of its probability over that of all other explanations
    """

    shift: int | None
    log_odds: float

    @property
    def is_probable(self) -> bool:
        """Whether nothing else explains the frames as well."""
        return self.log_odds > 0

    @property
    def is_certain(self) -> bool:
        """Whether all else has less than `SIGNIFICANCE` of its probability."""
        return self.log_odds >= -_UNLIKELY


class ShotLog:
    """Which settings were shot, in their order, to recognise a wrong control delay.

    Args:
        settings: of the frames of a capture
        controls: of the camera
        compare: two shots, which are numbered from 0 in the order of `begin`
        brightness: of a shot
        mains_hz: frequency of the mains that feeds lamps; None: unknown

    Attributes:
        has_delay: whether the camera is a stream, whose settings take effect late
    """

    def __init__(
        self,
        settings: Sequence[ExposureSetting],
        controls: ExposureControls,
        compare: Compare,
        brightness: Callable[[int], float],
        mains_hz: float | None = None,
    ) -> None:
        self._settings, self._controls, self._mains_hz = settings, controls, mains_hz
        settles = controls.timing is not None and controls.timing.old_frames > 0
        self.has_delay = controls.delay_frames is not None or settles
        self._sequences: list[tuple[int, ...]] = []
        self._written: list[list[float]] = []  # exposures in each sequence, and the one at rest
        self._settled_from: int | None = None  # the first sequence in which the camera settled
        self._scores = Explanations(controls, len(settings) - 1, compare, brightness)
        self._found: dict[tuple[int, int], DelayError | None] = {}

    @property
    def has_settled(self) -> bool:
        """Whether the camera has settled in some sequences."""
        return self._settled_from is not None

    def settle(self) -> None:
        """Record that the camera settles at each exposure from now on."""
        self._settled_from = len(self._sequences)

    def begin(self, positions: Sequence[int]) -> None:
        """Record that the frames at `positions` are shot now, in one sequence."""
        self._sequences.append(tuple(positions))
        settings = [self._settings[position] for position in positions]
        rest = resting_setting(self._controls, settings)
        written = (*settings, *([] if rest is None else [rest]))
        self._written.append([self._controls.exposure(each) for each in written])

    def find(self) -> DelayError | None:
        """Return the error of the control delay that the shots show, all of which are there.

        Where the camera has settled later, it is that of the sequences before.

        Returns:
            None where the frames may be right, or anything else that is wrong with them has all but
            `SIGNIFICANCE` of the probability.
        """
        return self._kept(0, self._late if self._controls.delay_frames is not None else self._old)

    def find_old(self) -> DelayError | None:
        """Return whether settled frames have exposures that were written before their own."""
        return self._kept(self._settled_from or 0, self._old)

    def _kept(self, first: int, late: Callable[[Sequence[int]], _Late]) -> DelayError | None:
        """Return what was found of the same shots before, or find it.

        Args:
            first: number of the first sequence that counts
            late: returns what the shots of some sequences had
        """
        key = first, len(self._sequences)
        if key not in self._found:
            last = (
                len(self._sequences) if first or self._settled_from is None else self._settled_from
            )
            self._found[key] = (
                self._find(first, late(range(first, last)))
                if self.has_delay and self._scores.has_others
                else None
            )
        return self._found[key]

    def _find(self, first: int, late: _Late) -> DelayError | None:
        asked = [
            self._settings[position] if number >= first else None
            for number, sequence in enumerate(self._sequences)
            for position in sequence
        ]
        as_set: Explanation = [
            [] if each is None else [Had(self._controls.exposure(each))] for each in asked
        ]
        right = self._scores.score_of_known(as_set)
        if self._scores.highest(as_set) + _UNLIKELY < right:
            return None
        others = [
            self._scores.score(as_set),
            *_of_kind([self._scores.score(as_set, flicker=self._flicker(asked))]),
            *_of_kind([self._scores.score(*each) for each in _clamped(asked)]),
            *_of_kind([self._scores.score(each) for each in _repeated(as_set)]),
        ]
        shares = {
            shift: _UNLIKELY - math.log(len(late)) + _log_mean(map(self._scores.score, each))
            for shift, each in late.items()
        }
        odds = _log_sum(shares.values()) - _log_sum(others)
        if odds < _UNLIKELY or _log_sum(shares.values()) < right:
            return None
        best = max(shares, key=lambda shift: shares[shift])
        rest = [share for shift, share in shares.items() if shift != best]
        is_one = bool(best) and shares[best] + _UNLIKELY >= _log_sum(rest)
        return DelayError(best if is_one else None, odds)

    def _flicker(self, asked: _Asked) -> Flicker:
        """Return by how much lamps that flicker change the ratio of two shots."""

        def spread(one: int, other: int) -> float:
            times_s = [each.time_s for each in (asked[one], asked[other]) if each is not None]
            return math.log(lamp_factor(times_s, self._mains_hz)) / math.sqrt(3)

        return spread

    def _late(self, numbers: Sequence[int]) -> _Late:
        """Return what shots had by the frames that exposures of some sequences come late."""
        delay = self._controls.delay_frames or 0
        return {
            shift: [
                [
                    [self._had(shift if number in numbers else 0, number, place, pause)]
                    for number, sequence in enumerate(self._sequences)
                    for place in range(len(sequence))
                ]
                for pause in range(max(shift, 0) + 1)
            ]
            for shift in range(-delay - 1, _MOST_LATE + 1)
            if shift
        }

    def _had(self, shift: int, number: int, place: int, pause: int) -> Had:
        """Return the exposure of a shot: a known one, or the one before the capture.

        Args:
            shift: frames by which exposures come late
            number: of the sequence
            place: of the shot in it
            pause: slots between two sequences beyond the least
        """
        delay = self._controls.delay_frames or 0
        wanted = place - shift
        while True:
            written = self._written[number]
            if wanted >= 0:
                return Had(written[min(wanted, len(written) - 1)])
            if number == 0:
                return Had(1.0, is_known=False)
            # The next sequence begins when the last frame of the one before it is here.
            number -= 1
            wanted += len(self._sequences[number]) + delay + pause

    def _old(self, numbers: Sequence[int]) -> _Late:
        """Return that shots of some sequences have their exposures or those written before them.

        Where the camera settles, each setting is written after the frame of the one before.
        """
        written: list[float] = []
        had: list[list[Had]] = []
        for number, sequence in enumerate(self._sequences):
            exposures = self._written[number]
            oldest = _MOST_OLD if number in numbers else 0
            for place in range(len(sequence)):
                known = [*written, *exposures[: place + 1]][-1 - oldest :]
                had.append([Had(each) for each in dict.fromkeys(known)])
            written += exposures
        shots = [number for number, sequence in enumerate(self._sequences) for _ in sequence]
        first = numbers[0] if numbers else 0
        return {0: [[each if n >= first else [] for each, n in zip(had, shots, strict=True)]]}


def _clamped(settings: _Asked) -> Iterator[tuple[Explanation, tuple[float, float]]]:
    """Yield that the longest of the times, or the shortest, all are one time, and its limits."""
    times = sorted({setting.time_s for setting in settings if setting is not None})
    for limits, is_longest in product(pairwise(times), (True, False)):
        had: list[list[Had]] = []
        for each in settings:
            if each is None:
                had.append([])
            elif (each.time_s >= limits[1]) is is_longest:
                had.append([Had(each.exposure / each.time_s, is_known=False)])
            else:
                had.append([Had(each.exposure)])
        yield had, limits


def _repeated(as_set: Explanation) -> list[Explanation]:
    """Return that a frame was sent again in place of the one after it."""
    return [
        [*as_set[:shot], as_set[shot - 1], *as_set[shot + 1 :]]
        for shot in range(1, len(as_set))
        if as_set[shot] and as_set[shot - 1]
    ]


def _of_kind(scores: Sequence[float]) -> list[float]:
    """Return the scores of all explanations of a kind, with their probability beforehand."""
    return [score + _UNLIKELY - math.log(len(scores)) for score in scores]


def _log_sum(values: Iterable[float]) -> float:
    """Return the logarithm of the sum of what has these logarithms."""
    found = [*values, -math.inf]
    most = max(found)
    if most == -math.inf:
        return most
    return most + math.log(sum(math.exp(each - most) for each in found))


def _log_mean(values: Iterable[float]) -> float:
    found = list(values)
    return _log_sum(found) - math.log(len(found))
