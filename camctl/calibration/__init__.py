"""Measuring what a camera does not say of itself."""

from camctl.calibration.delay import measure_delay

__all__ = ["measure_delay"]
