"""What a driver's author needs: the conformance suite for cameras (wants pytest)."""

from camctl.testing.conformance import CameraConformance

__all__ = ["CameraConformance"]
