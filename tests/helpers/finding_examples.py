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
)
EXAMPLES: Final = {finding.code: finding for finding in _FINDINGS}
"""One finding of each code of `camctl.findings.CODES`."""
