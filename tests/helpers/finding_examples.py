"""A finding of each code: for the page of the documentation and the snapshot of their words."""

from camctl.findings import Finding

_FINDINGS = (Finding(code="note", details={"text": "the sentence of a note is its text"}),)
EXAMPLES = {finding.code: finding for finding in _FINDINGS}
"""One finding of each code of `camctl.findings.CODES`."""
