"""What the checks of a capture's frames mean: which to shoot again, and whether to trust them."""

from __future__ import annotations

from collections.abc import Sequence

from camctl.evidence.delay import DelayError
from camctl.evidence.ratio_check import LAMP_DEPTH, RatioCheck
from camctl.findings import note
from camctl.records.report import UnfinishedCapture

#: A frame contradicts the metered light if this share of its samples is saturated, beyond those
#: that were expected to be: less may be noise or blooming near saturation, or a lamp.
_BEYOND_METERED = 0.6
#: Share of a picture that is most of it.
_MOST = 0.5
#: Largest factor between two frames that lamps may explain.
_LAMPS = (1 + LAMP_DEPTH) / (1 - LAMP_DEPTH)
#: What helps where the light of the whole picture changes.
_MENDS = "--estimate-ratios computes the pictures with the light that the frames show"
#: Exposures up to this factor count as the same.
_SAME = 1.02


def judge(
    capture: UnfinishedCapture,
    checks: Sequence[RatioCheck | None],
    error: DelayError | None,
    delay_of: str | None,
    *,
    exposures_exact: bool = True,
) -> None:
    """Write into the report of a capture what its frames say of their exposures.

    Args:
        capture: all its frames were shot, those that were wrong twice
        checks: `checks[k]` compares frame k with frame k - 1
        error: see `ShotLog.find`
        delay_of: id of the camera where its settings take effect late
        exposures_exact: see `ExposureControls`
    """
    measure = f"measure the control delay with camctl calibrate delay --camera {delay_of}"
    wrong = [(k, check) for k, check in enumerate(checks) if check and not check.agrees]
    certain = [
        (k, check)
        for k, check in wrong
        if check.contradicts and (exposures_exact or _is_no_movement(check))
    ]
    reasons = [_difference_text(capture, k, check) for k, check in certain]
    if not reasons and delay_of and (brighter := _brighter_than_metered(capture)):
        reasons.append(brighter)
    if error and error.shift:
        count = f"{abs(error.shift)} frame{'s' if abs(error.shift) > 1 else ''}"
        stale = (
            f"every exposure took effect {count} {'later' if error.shift > 0 else 'earlier'} than "
            f"the known control delay of the camera; {measure}"
        )
        if wrong:
            reasons, wrong = [stale], []
        else:
            capture.findings.append(note(stale))
    elif reasons and error:
        reasons.append(
            "the frames fit exposures that were set for other frames: probably the control delay "
            f"of the camera is not the known one; {measure}"
        )
    elif reasons:
        is_of_lamps = all(
            check.is_of_whole_picture and check.factor <= _LAMPS for _, check in certain
        )
        if is_of_lamps and exposures_exact and not capture.request.estimate_ratios:
            reasons.append(f"if lamps flicker, {_MENDS}")
        if delay_of:
            reasons.append(f"if this happens again, {measure}")
    if reasons:
        capture.trustworthy, capture.untrustworthy_because = False, "; ".join(reasons)
    if not exposures_exact:
        return  # they were compared before
    estimated = capture.request.estimate_ratios
    capture.findings += [
        note(_change_text(capture, k, check, is_estimated=estimated))
        for k, check in wrong
        if not check.contradicts
    ]


def _is_no_movement(check: RatioCheck) -> bool:
    """Return whether frames contradict each other by one ratio, or in most of the picture.

    Exposures that are not exact were compared before, so that the rest is things that moved.
    """
    if check.measured is not None and check.is_of_whole_picture:
        return True
    return check.compared * check.contradicting > _MOST


def _change_text(
    capture: UnfinishedCapture, position: int, check: RatioCheck, *, is_estimated: bool
) -> str:
    """Return a warning of frames that differ, without most of many samples being wrong."""
    if not check.is_of_whole_picture:
        return (
            f"frames {position} and {position + 1} can be compared in {check.compared:.2%} of the "
            f"picture only, and {check.contradicting:.0%} of that does not fit their exposures: "
            f"something moved there or its light changed, and only that part is wrong, or one of "
            f"the frames has another exposure"
        )
    advice = "" if is_estimated else f"; {_MENDS}"
    return (
        f"{_difference_text(capture, position, check)}: do not trust the light of the picture to "
        f"less than that (lamps that flicker, stray light, or a shutter that is not exact{advice})"
    )


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


def _names(capture: UnfinishedCapture, position: int) -> tuple[str, str]:
    """Return what to call a frame and the one before it: by their files where they have some."""
    frames = [capture.frames[k] for k in (position, position - 1)]
    one, before = ("" if each is None else str(each.details.get("file", "")) for each in frames)
    if one and before:
        return one, before
    return f"frame {position + 1}", "the frame before"


def _difference_text(capture: UnfinishedCapture, position: int, check: RatioCheck) -> str:
    """Return how a frame differs from the one before it."""
    name, before = _names(capture, position)
    if check.measured is None:
        return (
            f"the light in {name} does not fit its exposure, {check.expected:.4g} times "
            f"that of {before}"
        )
    return (
        f"{name} is {check.measured:.4g} times as bright as {before}, and its "
        f"exposure is {check.expected:.4g} times as long, a factor of {check.factor:.3g} apart"
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
