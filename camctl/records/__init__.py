"""What a capture leaves behind: request, plan, frames, report, folder and journal."""
