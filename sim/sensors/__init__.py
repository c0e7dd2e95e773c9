"""Simulated sensors: see `sim.sensors.sensor`.  The JSON files here are the built-in ones."""
