"""Shutter times that are tried to find those that suit the light, and light that suits none."""

from __future__ import annotations

import numpy as np

from camctl.errors import CaptureError
from camctl.interface.controls import Control


def spread_times(control: Control, shortest_s: float, longest_s: float, count: int) -> list[float]:
    """Return up to `count` times at about equal factors that a camera can do, ascending, s."""
    requested = np.geomspace(shortest_s, longest_s, count)
    return sorted({control.nearest(float(each)) for each in requested})


def too_bright(shortest_s: float) -> CaptureError:
    """Return the error for a scene that is white even at the shortest time."""
    return CaptureError(
        f"the scene is too bright: it is white even at {shortest_s:.4g} s",
        hint="close the aperture, or put a filter in front of the lens",
    )


def too_dark(what: str) -> CaptureError:
    """Return the error for a scene of too little light; `what` says what it does not reach."""
    return CaptureError(
        f"the scene is too dark: {what}",
        hint="take the lens cap off, light the scene, or allow longer times",
        remedies={"longest_s": None},
    )
