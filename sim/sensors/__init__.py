"""What a simulated sensor is."""
