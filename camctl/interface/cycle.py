"""Endless streams of frames: a camera that repeats a list of exposures until it is stopped.

Any n consecutive frames of a list of n settings hold each of them once, so that each new frame
completes a picture: see `camctl.live`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from enum import StrEnum
from typing import Protocol, runtime_checkable

from camctl.errors import UsageError
from camctl.interface.camera import Camera, Frame
from camctl.interface.controls import ExposureSetting


class CycleMethod(StrEnum):
    """How the exposures of a cycle are set."""

    AHEAD = "ahead"  # by the computer, one in each slot, ahead of the control delay
    REQUEST = "request"  # with the request of each frame (libcamera, V4L2 requests)
    SEQUENCER = "sequencer"  # by the camera itself, to which the list was uploaded


class FrameCycle(Iterator[Frame], Protocol):
    """Frames without end; see `CyclingCamera.cycle`."""

    @property
    def method(self) -> CycleMethod:
        """How the exposures are set."""

    def exchange(self, settings: Sequence[ExposureSetting]) -> int:
        """Go on with another list, from the end of the present one; any thread may call this.

        No frame is lost by it: the last frames of the old list are followed by the first one of the
        new list.

        Returns:
            `CyclePlace.plan` of the frames of the new list

        Raises:
            UsageError, RefusedSettingError: as `cycle` does; the old list goes on
        """

    def close(self) -> None:
        """End the stream; the camera can shoot again.  A second call does nothing."""


@runtime_checkable
class CyclingCamera(Camera, Protocol):
    """A camera that repeats a list of exposures without a pause."""

    def cycle(self, settings: Sequence[ExposureSetting]) -> FrameCycle:
        """Return an endless stream of frames over a list of settings, again and again.

        Each frame has the exposure that `applied` states, and `index` is the place of that setting
        in the list.  Frames come in the order of the list, with two exceptions: a frame that was
        lost or damaged is left out, and not taken again; and one whose setting came too late for
        its slot follows after a repetition of the one before it.  `Frame.place` has the number of
        the slot, by which both show.  The whole list is checked by this call.  The camera is busy
        until the stream is closed.

        Raises:
            UsageError: the list is empty
            RefusedSettingError, CameraError: as `shoot` does
        """


@runtime_checkable
class ComposingCamera(CyclingCamera, Protocol):
    """A camera whose cycle has one frame for each frame of a camera below it.

    Rates are those of that one: a frame of `shoot` takes several of its frames.
    """

    @property
    def camera(self) -> Camera:
        """The camera below."""

    def settings_below(self, settings: Sequence[ExposureSetting]) -> list[ExposureSetting]:
        """Return the list that the camera below repeats for a list of settings."""


def check_not_empty(settings: Sequence[ExposureSetting]) -> None:
    """Raise `UsageError` unless there is something to repeat."""
    if not settings:
        raise UsageError("a cycle without exposures", hint="give at least one setting")
