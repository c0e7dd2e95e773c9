"""What to say where light that spread from saturated samples makes a picture wrong."""

from __future__ import annotations

from camctl.exposure.goal import CURVE
from camctl.records.capture_plan import CapturePlan
from camctl.records.request import CaptureRequest

MUCH_SPREAD = 0.01
"""Share of the samples that are too bright by spread light from which a capture gets a warning."""

#: Range and stops of a bracket whose longest exposure is some hundred times shorter than that of
#: the whole light.  A range only a little smaller can have more spread light: another exposure of
#: the bracket is then in the middle.
_SMALL_RANGE, _STOPS = 256, 2.0


def spread_warnings(
    request: CaptureRequest, plan: CapturePlan, spread: float, *, repeatable: bool = True
) -> list[str]:
    """Return a warning if at least `MUCH_SPREAD` of the samples are too bright by spread light.

    Args:
        request: what was asked for
        plan: of the capture
        spread: share of the samples, see `FoundMovement`
        repeatable: frames can be shot at other settings
    """
    if spread < MUCH_SPREAD:
        return []
    # A bright thing beside saturated samples looks the same.
    return [
        f"light that spread from saturated samples, or a thing beside them that moved: "
        f"{spread:.1%} of the picture is too bright (mask bit 4, marked in the contact sheet): "
        f"{_advice(request, plan, repeatable)}"
    ]


def _advice(request: CaptureRequest, plan: CapturePlan, repeatable: bool) -> str:
    """Return how to make the longest exposure shorter."""
    if not repeatable:
        return "leave out the photographs with the longest exposures"
    is_free = request.ratios is None and request.response != CURVE
    options = []
    if is_free and plan.dynamic_range > _SMALL_RANGE:
        options.append(f"--range {_SMALL_RANGE}")
    if request.base_s is not None:
        options.append(f"--base {request.base_s / 2**_STOPS:.3g}")
    else:
        options.append(f"--compensation {request.compensation_stops - _STOPS:g}")
    return (
        f"a shorter longest exposure spreads less, and leaves more of the picture dark "
        f"({' '.join(options)}); better keep the light that saturates out of the picture"
    )
