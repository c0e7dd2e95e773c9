"""What a capture leaves behind: request, plan, frames, report, folder and journal."""

REPORT, SERIES = "report.json", "series.json"
"""Names of a report in the folder of a capture, and of a journal in the folder of a series."""
