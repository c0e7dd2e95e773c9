"""What cameras that stream have in common."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Generic, TypeVar

from camctl.interface.camera import CameraBase, Frame, MeasuredDelay
from camctl.interface.controls import ExposureSetting
from camctl.interface.cycle import FrameCycle
from camctl.streaming import (
    ControlDelay,
    ExposureCycle,
    ExposurePipeline,
    Shot,
    StreamCycle,
    resting_setting,
    with_delay,
)

DataT = TypeVar("DataT")


class PreviewedCamera(CameraBase):
    """A `PreviewingCamera` whose frame for metering is a sequence of one."""

    def preview(self, setting: ExposureSetting) -> Frame:
        """Return one frame at `setting`, for metering; raises as `shoot` does."""
        frames = self.shoot((setting,))
        try:
            return next(frames)
        finally:
            frames.close()


class StreamCamera(PreviewedCamera, Generic[DataT]):
    """A `PreviewingCamera` and a `CyclingCamera`: `_open` starts a stream and sets `_pipeline`.

    An `ExposurePipeline` takes the frames; `DataT` is what the stream delivers as one.
    """

    _pipeline: ExposurePipeline[DataT]

    def cycle(self, settings: Sequence[ExposureSetting]) -> FrameCycle:
        """Return frames without end; see `camctl.interface.cycle.CyclingCamera`."""
        endless = ExposureCycle.of(self._pipeline, self._checked(settings))
        self._is_shooting = True
        return StreamCycle(endless, self.controls, self._check_open, self._frame, self._end_cycle)

    def _end_cycle(self) -> None:
        self._is_shooting = False

    def step(
        self, before: ExposureSetting, after: ExposureSetting, frames: int, *, early: int = 0
    ) -> list[Frame]:
        """Return the frames after a change of exposure; see `StreamingCamera.step`."""
        self._check_ready()
        for setting in (before, after):
            self.controls.check(setting)
        shots = self._pipeline.step(before, after, frames, early=early)
        return [self._frame(shot, after) for shot in shots]

    def use_delay(self, delay: MeasuredDelay | None) -> None:
        """Use a measured control delay from now on; see `camctl.interface.camera.use_delay`."""
        self._check_open()
        used = self._delay(delay)
        self._pipeline.delay = used
        self._controls = with_delay(self.controls, used, self.info.id)

    def _delay(self, measured: MeasuredDelay | None) -> ControlDelay:
        """Return the delay to use with a measured one; None: none was measured."""
        return ControlDelay.of(measured)

    def _frames(self, settings: tuple[ExposureSetting, ...]) -> Iterator[Frame]:
        rest = resting_setting(self.controls, settings)
        for shot in self._pipeline.shoot(settings, rest):
            yield self._frame(shot, settings[shot.index])
            self._check_open()

    def _frame(self, shot: Shot[DataT], requested: ExposureSetting) -> Frame:
        """Return the frame of a shot.

        Raises:
            CameraProtocolError: the stream has changed
        """
        raise NotImplementedError
