"""Errors that several calibrations raise: light, movement, and size of the frames."""

from __future__ import annotations

from collections.abc import Sequence

from camctl.errors import CaptureError, DataError
from camctl.system.number_text import time_text


def too_bright(shortest_s: float) -> CaptureError:
    """Return the error for a scene that is white even at the shortest time."""
    return CaptureError(
        f"the scene is too bright: it is white even at {time_text(shortest_s)}",
        hint="close the aperture, or put a filter in front of the lens",
    )


def too_dark(what: str) -> CaptureError:
    """Return the error for a scene of too little light; `what` says what it does not reach."""
    return CaptureError(
        f"the scene is too dark: {what}",
        hint="take the lens cap off, light the scene, or allow longer times",
        remedies={"longest_s": None},
    )


def all_saturated() -> DataError:
    """Return the error for frames that show nothing but white."""
    return DataError(
        "all frames are saturated everywhere", hint="expose shorter, or close the aperture"
    )


def moved(what: str) -> DataError:
    """Return the error for a scene that did not stand still; `what` says how it shows."""
    return DataError(
        f"{what}: the camera or the scene moved",
        hint="put the camera on a tripod before a scene that does not move",
    )


def check_size(shape: Sequence[int], first: Sequence[int], name: str, name_of_first: str) -> None:
    """Raise `DataError` unless a frame has the size of the first one."""
    if tuple(shape) != tuple(first):
        sizes = [f"{each[1]} x {each[0]}" for each in (shape, first)]
        raise DataError(
            f"{name} has {sizes[0]} pixels and {name_of_first} has {sizes[1]}",
            hint="give frames of one size and format",
        )
