"""What the checks of a capture's frames mean: which to shoot again, and whether to trust them."""

from __future__ import annotations

import math
from collections.abc import Sequence

from camctl.camera import PHOTOGRAPHS
from camctl.captures.frame_record import RatioCheck
from camctl.captures.report import UnfinishedCapture
from camctl.controls import ExposureSetting

#: Errors of a control delay that are recognised, frames.
_SHIFTS = (1, 2, 3, -1, -2)
#: A frame contradicts the metered light if this share of its samples is saturated, beyond those
#: that were expected to be: less may be noise or blooming near saturation, or a lamp.
_BEYOND_METERED = 0.6
#: Exposures up to this factor count as the same.
_SAME = 1.02


class ShotLog:
    """Which settings were shot, in their order, to recognise a wrong control delay.

    Args:
        settings: of the frames of a capture
    """

    def __init__(self, settings: Sequence[ExposureSetting]) -> None:
        self._settings = settings
        self._shift: int | None = None
        # Positions of the frames, and the index of the last frame of the same sequence.
        self._shots: list[tuple[int, int]] = []

    def begin(self, positions: Sequence[int]) -> None:
        """Record that the frames at `positions` are shot now, in one sequence."""
        last = len(self._shots) + len(positions) - 1
        self._shots += [(position, last) for position in positions]

    def shift(self, checks: Sequence[RatioCheck | None]) -> int | None:
        """Return by how many frames the exposures came late, as the pixels show; negative: early.

        `checks[k]` compares frame k with frame k - 1.  None: no such shift explains all ratios, or
        all agree without one, and nor did those of an earlier call.
        """
        self._shift = self._shift or self._find_shift(checks)
        return self._shift

    def _find_shift(self, checks: Sequence[RatioCheck | None]) -> int | None:
        latest = {position: index for index, (position, _) in enumerate(self._shots)}
        pairs = [
            (latest[k - 1], latest[k], check)
            for k, check in enumerate(checks)
            if check and check.is_certain and {k - 1, k} <= latest.keys()
        ]
        for shift in _SHIFTS:
            explained = []
            for first, second, check in pairs:
                before, after = self._exposure(first, shift), self._exposure(second, shift)
                if before and after and check.measured:
                    error = abs(math.log(check.measured * before / after))
                    explained.append((error <= math.log1p(check.tolerance), check.agrees))
            if all(fits for fits, _ in explained) and not all(agrees for _, agrees in explained):
                return shift
        return None

    def _exposure(self, index: int, shift: int) -> float | None:
        """Return the exposure of a frame if settings come `shift` frames late; None: unknown."""
        index = min(index - shift, self._shots[index][1])  # the last setting stays
        return self._settings[self._shots[index][0]].exposure if index >= 0 else None


def judge(
    capture: UnfinishedCapture,
    checks: Sequence[RatioCheck | None],
    shift: int | None,
    delay_of: str | None,
) -> None:
    """Write into the report of a capture what its frames say of their exposures.

    Args:
        capture: all its frames were shot, those that were wrong twice
        checks: `checks[k]` compares frame k with frame k - 1
        shift: see `ShotLog.shift`
        delay_of: id of the camera where it has a known control delay
    """
    again = f"camctl calibrate delay --camera {delay_of}"
    wrong = [(k, check) for k, check in enumerate(checks, start=1) if check and not check.agrees]
    reasons = [difference_text(number, check) for number, check in wrong if check.contradicts]
    if not reasons and delay_of and (brighter := _brighter_than_metered(capture)):
        reasons.append(brighter)
    if reasons and delay_of:
        reasons.append(f"if this happens again, measure the control delay again with {again}")
    if shift and delay_of:
        count = f"{abs(shift)} frame{'s' if abs(shift) > 1 else ''}"
        stale = (
            f"every exposure took effect {count} {'later' if shift > 0 else 'earlier'} than the "
            f"known control delay of the camera; measure it again with {again}"
        )
        if wrong:
            reasons, wrong = [stale], []
        else:
            capture.warnings.append(stale)
    if reasons:
        capture.trustworthy, capture.untrustworthy_because = False, "; ".join(reasons)
    if capture.camera.driver == PHOTOGRAPHS:
        return  # their exposures are not exact, and were compared before
    capture.warnings += [
        f"{difference_text(number, check)}: do not trust the parts that moved or whose light "
        "changed (if lamps flicker, see --mains)"
        for number, check in wrong
        if not check.contradicts
    ]


def _brighter_than_metered(capture: UnfinishedCapture) -> str | None:
    """Return which frame is white although the metered light is not; None: none is.

    Of frames that are white altogether no ratio can be measured.
    """
    metering = capture.plan.metering
    if metering is None:
        return None
    expected = max(metering.clipped, capture.request.clip or 0.0)
    limit = metering.limit_s * metering.setting.gain
    for number, frame in enumerate(capture.frames, start=1):
        if (
            frame is not None
            and frame.applied.exposure <= _SAME * limit
            and frame.saturated_fraction > expected + _BEYOND_METERED
        ):
            return (
                f"{frame.saturated_fraction:.0%} of frame {number} is white, and by the metered "
                f"light it would be {expected:.0%}: it had a longer exposure, or the light changed"
            )
    return None


def difference_text(number: int, check: RatioCheck) -> str:
    """Return how frame `number`, from 1, differs from the one before it."""
    if check.measured is None:
        return (
            f"the light in frame {number} does not fit its exposure, {check.expected:.4g} times "
            f"that of the frame before"
        )
    return (
        f"frame {number} is {check.measured:.4g} times as bright as the frame before, and its "
        f"exposure is {check.expected:.4g} times as long"
    )


def suspects(checks: Sequence[RatioCheck | None]) -> list[int]:
    """Return the positions of the frames whose exposure is probably wrong, ascending.

    `checks[k]` compares frame k with frame k - 1.  A frame that disagrees with both neighbours is
    the wrong one; where only one pair disagrees, both frames of it are suspect.  Where only parts
    of the picture disagree, something moved, and another frame would not be better.
    """
    wrong = [k for k, check in enumerate(checks) if check and check.is_of_whole_picture]
    between = {later for later in wrong if later + 1 in wrong}
    pairs = [
        (later - 1, later) for later in wrong if later not in between and later - 1 not in between
    ]
    return sorted(between | {position for pair in pairs for position in pair})
