"""Scenes for simulated sensors: see `sim.scenes.scene`.  The JSON files are the built-in ones."""
