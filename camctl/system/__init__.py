"""Files, threads, memory, signals and text: what the controller needs of the system."""
