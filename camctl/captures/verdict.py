"""What the checks of a capture's frames mean: which to shoot again, and whether to trust them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from camctl.captures.plan import NOTABLE_DIFFERENCE
from camctl.evidence.delay import DelayError
from camctl.evidence.ratio_check import MOST, RatioCheck
from camctl.findings import Finding
from camctl.records.report import UnfinishedCapture


def judge(
    capture: UnfinishedCapture,
    checks: Sequence[RatioCheck | None],
    error: DelayError | None,
    delay_of: str | None,
    *,
    exposures_exact: bool = True,
) -> tuple[list[Finding], list[Finding]]:
    """Return what the frames of a capture say of their exposures.

    Args:
        capture: all its frames were shot, those that were wrong twice
        checks: `checks[k]` compares frame k with frame k - 1
        error: see `ShotLog.find`
        delay_of: id of the camera where its settings take effect late
        exposures_exact: see `ExposureControls`

    Returns:
        why the pictures are not trustworthy, and what else there is to know
    """
    wrong = [(k, check) for k, check in enumerate(checks) if check and not check.agrees]
    certain = [
        (k, check)
        for k, check in wrong
        if check.shows_another_exposure(exposures_exact=exposures_exact)
    ]
    mends: dict[str, Any] = {}
    if not capture.request.estimate_ratios:
        mends = {"estimate_ratios": True}
    measure = {"calibrate_delay": delay_of}
    late = Finding(code="delay_contradicts", value=error.shift if error else None, remedies=measure)
    reasons = [_exposure_differs(capture, k, check, {}, certain=True) for k, check in certain]
    if not reasons and delay_of:
        reasons = _brighter_than_metered(capture)
    if error and error.shift:
        return ([late], []) if wrong else (reasons, [late])
    if reasons and error:
        reasons.append(late)
    elif reasons:
        lamps = all(check.may_be_lamps for _, check in certain)
        remedies = (mends if lamps and exposures_exact else {}) | (measure if delay_of else {})
        reasons[-1] = reasons[-1].model_copy(update={"remedies": remedies})
    if not exposures_exact:
        return reasons, []  # they were compared before
    return reasons, [
        _exposure_differs(capture, k, check, mends)
        if check.is_of_whole_picture
        else Finding(
            code="part_contradicts",
            frames=(k - 1, k),
            value=check.contradicting,
            details={"compared": check.compared},
        )
        for k, check in wrong
        if not check.contradicts
    ]


def _brighter_than_metered(capture: UnfinishedCapture) -> list[Finding]:
    """Return which frame is white although the metered light is not; the first one, or none.

    Most of its samples are saturated beyond those that were expected to be: fewer may be noise or
    blooming near saturation, or a lamp.

    Of frames that are white altogether no ratio can be measured.
    """
    metering = capture.plan.metering
    if metering is None:
        return []
    expected = max(metering.clipped, capture.request.clip or 0.0)
    limit = metering.limit_s * metering.setting.gain
    for place, frame in enumerate(capture.frames):
        if (
            frame is not None
            and frame.applied.exposure <= (1 + NOTABLE_DIFFERENCE) * limit
            and frame.saturated_fraction > expected + MOST
        ):
            return [
                Finding(
                    code="frame_white",
                    frames=(place,),
                    value=frame.saturated_fraction,
                    details={"metered": expected},
                )
            ]
    return []


def _exposure_differs(
    capture: UnfinishedCapture,
    position: int,
    check: RatioCheck,
    remedies: dict[str, Any],
    *,
    certain: bool = False,
) -> Finding:
    """Return by how much a frame differs from the one before it."""
    frames = [capture.frames[k] for k in (position, position - 1)]
    name, before = (None if each is None else each.details.get("file") for each in frames)
    ratio = None if check.measured is None else check.measured / check.expected
    return Finding(
        code="exposure_differs",
        frames=(position - 1, position),
        value=ratio,
        details={"expected": check.expected, "certain": certain, "name": name, "before": before},
        remedies=remedies,
    )


def suspects(checks: Sequence[RatioCheck | None]) -> list[int]:
    """Return the positions of the frames whose exposure is probably wrong, ascending.

    `checks[k]` compares frame k with frame k - 1.  A frame that disagrees with both neighbours is
    the wrong one; where only one pair disagrees, both frames of it are suspect, however little of
    them can be compared.  Where parts of that disagree, something moved, and another frame would
    not be better.
    """
    return suspected(
        k for k, check in enumerate(checks) if check and not check.agrees and check.is_one_ratio
    )


def suspected(disagreeing: Iterable[int]) -> list[int]:
    """Return the suspects as `suspects` does; `disagreeing` are the later frames of pairs."""
    wrong = list(disagreeing)
    between = {later for later in wrong if later + 1 in wrong}
    pairs = [
        (later - 1, later) for later in wrong if later not in between and later - 1 not in between
    ]
    return sorted(between | {position for pair in pairs for position in pair})
