"""Places where things moved, each from a single frame: which one, and what is put there."""
