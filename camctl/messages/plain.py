"""Findings as plain sentences: for Python, and for ``warnings`` in a report.

They name no option of a command line and no key of a panel.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from camctl.findings import Finding

SENTENCES: Final[dict[str, Callable[[Finding], str]]] = {
    "note": lambda finding: str(finding.details["text"]),
    # Cameras.
    "response_assumed": lambda finding: (
        f"the response {finding.details['response']} is assumed until it is measured"
    ),
    "delay_unknown": lambda _: "control delay not measured: the stream settles after each exposure",
    "delay_varies": lambda finding: (
        f"the control delay is not constant ({finding.details['smallest']} to {finding.value:g} "
        "frames): the stream settles after each exposure"
    ),
}
"""The sentence of each code of `camctl.findings.CODES`."""


def sentence(finding: Finding) -> str:
    """Return the finding as one line, without a full stop at its end."""
    return SENTENCES[finding.code](finding)
