"""A finding of each code: for the page of the documentation and the snapshot of their words."""

from typing import Final

from camctl.findings import Finding

_FINDINGS = (
    Finding(code="note", details={"text": "the sentence of a note is its text"}),
    Finding(
        code="response_assumed",
        details={"response": "srgb 8 bit"},
        remedies={"calibrate_response": None},
    ),
    Finding(code="delay_unknown", remedies={"calibrate_delay": "v4l2:/dev/video0"}),
    Finding(code="delay_varies", value=3, details={"smallest": 2}),
    Finding(code="setting_differs", value=0.02, details={"field": "base_s", "requested": 0.0213}),
    Finding(code="flicker", value=0.004, details={"period_s": 0.01}),
    Finding(code="steps_cost_levels", value=61.0, details={"possible": 75.0}),
    Finding(code="time_differs", value=1.9, details={"planned_s": 1.2}),
    Finding(code="highlights_cut", value=0.012),
    Finding(
        code="light_above_range",
        value=0.081,
        details={"photographs": False},
        remedies={"compensation_stops": 0.0},
    ),
    Finding(
        code="light_below_range",
        value=0.34,
        details={"dynamic_range": 1000.0, "response": "log", "photographs": False, "left": 0.06},
        remedies={"dynamic_range": "auto", "count": 6},
    ),
    Finding(
        code="light_changed",
        value=0.09,
        details={"metered": 0.001},
        remedies={"compensation_stops": -0.5},
    ),
    Finding(code="picture_black", remedies={"base_s": None}),
    Finding(code="picture_white", value=0.999, remedies={"base_s": None}),
    Finding(
        code="light_spread",
        value=0.023,
        details={"photographs": False},
        remedies={"dynamic_range": 256.0, "compensation_stops": -2.0},
    ),
    Finding(code="noise_differs", value=41.2, details={"predicted": 63.5}),
)
EXAMPLES: Final = {finding.code: finding for finding in _FINDINGS}
"""One finding of each code of `camctl.findings.CODES`."""
