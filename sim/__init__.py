"""Simulation: scenes, sensors and their effects, a simulated camera, and virtual devices."""
