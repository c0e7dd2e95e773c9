"""Taking the exposures: metering, planning, shooting, summing, handing over."""

from camctl.capture.plan import plan_capture
from camctl.capture.report import CaptureReport, read_report
from camctl.capture.request import CapturePlan, CaptureRequest, Metering
from camctl.capture.sequencer import Progress, capture, resume

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
