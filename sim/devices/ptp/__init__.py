"""A virtual PTP still camera with three makers' extensions."""
