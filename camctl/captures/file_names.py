"""Names of the files of a capture that other packages look for."""

from __future__ import annotations

REPORT = "report.json"
