"""Simulated cameras: scenes, sensors, and a camera that looks at them."""
