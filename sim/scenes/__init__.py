"""Scenes for simulated sensors (`camctl.sim.scenes.scene`).  The JSON files are built in."""
