"""A virtual PTP still camera."""
