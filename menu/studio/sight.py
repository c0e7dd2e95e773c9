"""What the camera sees, for browsers that look: nothing is computed while none does."""

from __future__ import annotations

from typing import TYPE_CHECKING

from camctl.exposure.light import Metering
from camctl.interface.camera import Frame
from camctl.interface.controls import ExposureControls

if TYPE_CHECKING:
    from camctl.livestream.result import LiveResult


class Sight:
    """Keeps the last picture of the camera."""

    def show_frame(self, frame: Frame, controls: ExposureControls, metered: Metering) -> None:
        """Take a metering frame."""

    def show_result(self, result: LiveResult, controls: ExposureControls) -> None:
        """Take a picture of the effective camera."""

    def end(self) -> None:
        """Answer those who wait."""
