"""Measuring properties that a camera does not report."""

from camctl.calibration.delay import measure_delay

__all__ = ["measure_delay"]
