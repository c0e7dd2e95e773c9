"""A camera that takes each preview once, so that several plans come from the same light."""

from __future__ import annotations

from collections.abc import Sequence
from types import TracebackType
from typing import Self

from camctl.interface.camera import CameraInfo, Frame, FrameStream, PreviewingCamera
from camctl.interface.clock import Clock
from camctl.interface.controls import ExposureControls, ExposureSetting


class RememberedPreviews:
    """A `camctl.PreviewingCamera` that keeps the previews of an open camera by setting.

    It does not close that camera.
    """

    def __init__(self, camera: PreviewingCamera) -> None:
        self._camera = camera
        self._frames: dict[ExposureSetting, Frame] = {}

    @property
    def info(self) -> CameraInfo:
        """The identity of the camera."""
        return self._camera.info

    @property
    def controls(self) -> ExposureControls:
        """What can be set."""
        return self._camera.controls

    @property
    def clock(self) -> Clock:
        """The clock of the timestamps."""
        return self._camera.clock

    def preview(self, setting: ExposureSetting) -> Frame:
        """Return the preview at this setting, taken before or now."""
        if setting not in self._frames:
            self._frames[setting] = self._camera.preview(setting)
        return self._frames[setting]

    def shoot(self, settings: Sequence[ExposureSetting]) -> FrameStream:
        """Shoot the settings in their order."""
        return self._camera.shoot(settings)

    def close(self) -> None:
        """Forget the previews."""
        self._frames.clear()

    def __enter__(self) -> Self:
        """Return the camera."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Forget the previews."""
        self.close()
