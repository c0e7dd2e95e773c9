"""Pictures computed from the sum: rendering, previews, sheets and files."""
