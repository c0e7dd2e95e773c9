"""Simulated sensors (`camctl.sim.sensors.sensor`).  The JSON files are built in."""
