"""What a capture leaves behind: request, plan, frames, report, folder and journal."""

REPORT = "report.json"
"""Name of a report in the folder of a capture."""
