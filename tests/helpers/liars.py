"""Cameras that change what another one returns, and state that nothing has changed."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from small_cameras import WrappedCamera

from camctl.interface.camera import Frame, FrameStream
from camctl.interface.controls import ExposureSetting


class Liar(WrappedCamera):
    """Passes changed settings on, and states the requested ones; it previews by shooting."""

    count = 0

    def preview(self, setting: ExposureSetting) -> Frame:
        (frame,) = self.shoot([setting])
        return frame

    def shoot(self, settings: Sequence[ExposureSetting]) -> FrameStream:
        for setting in settings:
            self.controls.check(setting)
        changed = [self.possible(self.changed(setting)) for setting in settings]
        return self._frames(self.camera.shoot(changed), settings)

    def _frames(
        self, frames: FrameStream, settings: Sequence[ExposureSetting]
    ) -> Generator[Frame, None, None]:
        for frame, setting in zip(frames, settings, strict=True):
            type(self).count += 1
            yield self.returned(replace(frame, requested=setting, applied=setting))

    def possible(self, setting: ExposureSetting) -> ExposureSetting:
        return replace(setting, time_s=self.controls.time_s.nearest(setting.time_s))

    def changed(self, setting: ExposureSetting) -> ExposureSetting:
        return setting

    def returned(self, frame: Frame) -> Frame:
        return frame


class _Bends(Liar):
    """Its linear response is another one than it states, in a part of the range."""

    def returned(self, frame: Frame) -> Frame:
        span = float(frame.white - frame.black)
        share = (frame.pixels.astype(float) - frame.black) / span
        pixels: Any = np.rint(self.bent(share) * span + frame.black)
        return replace(frame, pixels=np.minimum(pixels, frame.white).astype(frame.pixels.dtype))

    def bent(self, share: NDArray[np.float64]) -> NDArray[np.float64]:
        raise NotImplementedError


class HasAGammaNearBlack(_Bends):
    limit = 0.01

    def bent(self, share: NDArray[np.float64]) -> NDArray[np.float64]:
        dark = np.sqrt(np.maximum(share, 0) / self.limit) * self.limit
        return np.where((share > 0) & (share < self.limit), dark, share)


class HasAGammaBelow3Percent(HasAGammaNearBlack):
    limit = 0.03


class HasAKneeNearWhite(_Bends):
    def bent(self, share: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.where(share > 0.9, 0.9 + (share - 0.9) / 2, share)


class AddsToLongExposures(_Bends):
    """Half a per cent of white."""

    def returned(self, frame: Frame) -> Frame:
        return super().returned(frame) if frame.applied.time_s > 0.018 else frame

    def bent(self, share: NDArray[np.float64]) -> NDArray[np.float64]:
        return share + 0.005
