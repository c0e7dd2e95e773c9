"""Taking the exposures: metering, planning, shooting, summing, handing over."""

from camctl.captures.plan import plan_capture
from camctl.captures.report import CaptureReport, read_report
from camctl.captures.request import CapturePlan, CaptureRequest, Metering
from camctl.captures.sequencer import Progress, capture, resume

__all__ = [
    "CapturePlan",
    "CaptureReport",
    "CaptureRequest",
    "Metering",
    "Progress",
    "capture",
    "plan_capture",
    "read_report",
    "resume",
]
