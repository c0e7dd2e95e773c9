"""What was measured of each camera, kept for the next time."""
