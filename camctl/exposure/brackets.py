"""Brackets of fixed steps, which cameras offer, as settings of one camera."""

from __future__ import annotations

from collections.abc import Sequence

from camctl.errors import UnreachableExposureError
from camctl.interface.controls import ExposureControls, ExposureSetting

OFFERED = tuple((count, stops) for stops in (1, 2, 3) for count in (3, 5, 7))
"""Numbers of frames and the stops between them that the bracketing of many cameras offers."""


def near_gain_1(
    controls: ExposureControls, base_s: float, exposures: Sequence[float]
) -> tuple[ExposureSetting, ...]:
    """Return the camera's settings at gain 1 for exposures; gain extends the longest time.

    Args:
        controls: of the camera
        base_s: shutter time of an exposure of 1, s
        exposures: relative to it

    Raises:
        CaptureError: one is beyond the longest time and the largest gain
    """
    time, gain = controls.time_s, controls.gain
    lowest, longest = gain.nearest(1.0), time.maximum / base_s
    settings = []
    for exposure in exposures:
        more = max(1.0, exposure / longest)
        if lowest * more > gain.maximum * (1 + 1e-6):
            raise UnreachableExposureError(
                f"an exposure of {exposure:.4g} x {base_s:.4g} s is beyond the camera's "
                "longest time and largest gain",
                hint="take fewer exposures or a smaller range",
            )
        applied_gain = gain.nearest(lowest * more)
        time_s = time.nearest(exposure * base_s * lowest / applied_gain)
        settings.append(ExposureSetting(time_s, applied_gain))
    return tuple(settings)


def bracket(
    controls: ExposureControls, base_s: float, count: int, stops: float
) -> tuple[ExposureSetting, ...]:
    """Return the settings of `count` frames, `stops` apart; raises as `near_gain_1` does."""
    return near_gain_1(controls, base_s, [2.0 ** (stops * place) for place in range(count)])
